"""The symbolic misclosures and their derivatives against NumPy's, on every robot, for every set of unknowns."""

import casadi as ca
import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError
from hexopt.rotations import rotation_vector_jacobian, rotation_vector_to_matrix

symbolic = hx.symbolic


def same(found, expected, scale=None):
    """Whether two arrays agree to 1e-12 of the largest entry, or of the terms that made them."""
    expected = np.broadcast_to(expected, found.shape)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12 * (scale or np.abs(expected).max()))


class TestLoops:
    def test_the_misclosure_is_numpys(self, name, unknown, robot, made):
        loop, x = made(name, unknown, robot)
        found = symbolic.residual(loop, x)
        assert found.shape == (5, loop.rows)
        same(found, loop.residual(x), robot.size**2 if name == "FixedLength" else robot.size)

    def test_the_derivatives_are_numpys(self, name, unknown, robot, made):
        loop, x = made(name, unknown, robot)
        found = symbolic.jacobian(loop, x)
        assert found.shape == (5, loop.rows, loop.parameters.size)
        for block in loop.parameters.names:
            same(found[..., loop.parameters[block]], loop.jacobian(x)[..., loop.parameters[block]])
        noise = symbolic.noise_jacobian(loop, x)
        assert noise.shape == (5, loop.rows, 7)
        for part in (slice(0, 3), slice(3, 6), slice(6, 7)):
            same(noise[..., part], loop.noise_jacobian(x)[..., part])
        for block in set(loop.involved) - set(unknown):
            same(symbolic.known_jacobian(loop, x, block), loop.known_jacobian(x, block))

    def test_batches_broadcast(self, name, unknown, left_hand, made):
        loop, x = made(name, unknown, left_hand, n_sets=3)
        many = x + np.linspace(0, 1, 2)[:, None, None]
        for ask in ("residual", "jacobian", "noise_jacobian"):
            found = getattr(symbolic, ask)(loop, many)
            expected = np.asarray(getattr(loop, ask)(many))
            assert found.shape[:3] == (2, 3, 5)
            same(found, expected, left_hand.size**2)


class Sphere(hx.loops.Loop):
    """A loop of one's own, without its symbolic equation."""

    locks = tuple(hx.Lock)
    involved = default_unknown = ("platform_point",)
    linear_in = ()
    rows = 1
    minimum_poses = 3

    def _misclosure(self, blocks):
        return (np.square(self.data.position + self._arm(blocks)).sum(axis=-1) - 1.0)[..., None]

    def _columns(self, blocks):
        point = self.data.position + self._arm(blocks)
        return {"platform_point": 2 * np.einsum("...ni,...nij->...nj", point, self.data.rotation)[..., None, :]}

    def _noise_columns(self, blocks):
        raise NotImplementedError


class SymbolicSphere(Sphere):
    """The same with it."""

    def symbolic_misclosure(self, blocks, position, rotation, reading):
        return ca.sumsqr(position + rotation @ blocks["platform_point"]) - 1.0


class Heir(hx.loops.FixedLeg):
    """A loop whose equation is its parent's."""


class OtherHeir(hx.loops.FixedLeg):
    """A loop with an equation that its parent's is not."""

    def _misclosure(self, blocks):
        return 2 * super()._misclosure(blocks)


class TestLoopsOfOnesOwn:
    def test_a_method_gives_the_equation(self, left_hand):
        loop = SymbolicSphere(hx.simulate_leg(left_hand, 3, "none", 4, rng=0))
        same(symbolic.residual(loop, [1.0, 2.0, 3.0]), loop.residual([1.0, 2.0, 3.0]))
        same(symbolic.jacobian(loop, [1.0, 2.0, 3.0]), loop.jacobian([1.0, 2.0, 3.0]))

    def test_an_heir_keeps_it(self, left_hand):
        loop = Heir(hx.simulate_leg(left_hand, 3, "leg", 4, rng=0))
        x = np.arange(6.0)
        same(symbolic.residual(loop, x), loop.residual(x))

    @pytest.mark.parametrize("kind", [Sphere, OtherHeir])
    def test_without_one_the_error_says_what_to_write(self, kind, left_hand):
        loop = kind(hx.simulate_leg(left_hand, 3, "leg", 4, rng=0))
        with pytest.raises(InputError, match=f"{kind.__name__} has no symbolic equation; give it a method "):
            symbolic.loop_function(loop)


class TestTheWholePose:
    def pose(self, robot):
        data = hx.simulate(robot, n_poses=4, rng=0)
        given = {
            "platform_point": robot.platform_points.ravel(),
            "base_point": robot.base_points.ravel(),
            "offset": robot.offsets + 0.03 * robot.size,
            "gain": robot.gains,
        }
        return data, given

    def test_closure_and_derivatives_are_those_of_six_legs(self, robot):
        data, given = self.pose(robot)
        function = symbolic.pose_function()
        wanted = ["closure", "jac:closure:error", *(f"jac:closure:{name}" for name in given)]
        derived = function.factory("derived", function.name_in(), wanted)
        for i in range(4):
            closure, by_error, *by_blocks = (
                part.full()
                for part in derived(*given.values(), data.position[i], data.rotation[i], data.length[i], np.zeros(12))
            )
            for k in range(6):
                loop = hx.loops.LegLength(data.leg(k + 1), unknown=tuple(given))
                leg = robot.leg(k + 1)
                x = leg.replaced(offset=leg.offset + 0.03 * robot.size)
                same(closure[k], loop.residual(x)[i], robot.size)
                own = by_error[k, [0, 1, 2, 3, 4, 5, 6 + k]]
                same(own[:3], loop.noise_jacobian(x)[i, 0, :3])
                same(own[3:6], loop.noise_jacobian(x)[i, 0, 3:6])
                same(own[6:], loop.noise_jacobian(x)[i, 0, 6:])
                assert not np.delete(by_error[k, 6:], k).any()
                for block, part in zip(given, by_blocks, strict=True):  # columns leg by leg
                    size = loop.parameters[block]
                    columns = part[k].reshape(6, -1)
                    same(columns[k], loop.jacobian(x)[i, 0, size])
                    assert not np.delete(columns, k, axis=0).any()

    def test_readings_are_those_of_inverse_kinematics(self, robot):
        data, _ = self.pose(robot)
        found = symbolic.inverse_kinematics(robot, data.position[None], data.rotation)
        assert found.shape == (1, 4, 6)
        expected = hx.inverse_kinematics(robot, data.position, data.rotation)
        same(found, expected, robot.size / np.abs(robot.gains).min())


class TestRotations:
    @pytest.mark.parametrize("angle", [0.0, 1e-9, 1e-3, 0.0999, 0.1001, 1.0, 3.0])
    def test_the_exponential_and_its_derivatives(self, angle):
        """NumPy's matrix and left Jacobian; the second derivative by differences of the first, on both branches."""
        v = ca.SX.sym("v", 3)
        turned = symbolic.rotation_matrix(v) @ ca.DM([1.0, -2.0, 0.5])
        first = ca.jacobian(turned, v)
        functions = ca.Function("turned", [v], [turned, first, ca.jacobian(ca.vec(first), v)])
        at = angle * np.array([2.0, -1.0, 2.0]) / 3
        point, slope, curvature = (part.full() for part in functions(at))
        np.testing.assert_allclose(point[:, 0], rotation_vector_to_matrix(at) @ [1.0, -2.0, 0.5], rtol=0, atol=1e-15)
        expected = -hx.rotations.skew(point[:, 0]) @ rotation_vector_jacobian(at)
        np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-14)
        step = 1e-5
        moved = [
            (functions(at + step * e)[1] - functions(at - step * e)[1]).full().T.reshape(-1) / (2 * step)
            for e in np.eye(3)
        ]
        np.testing.assert_allclose(curvature, np.array(moved).T, rtol=0, atol=1e-8)
