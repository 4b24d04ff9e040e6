"""All sets and all readings of a robot as one model: derivatives, names, the bound, where it starts, mistakes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag

import hexopt as hx
from hexopt.errors import InputError, RankDeficientError, UnitError
from hexopt.loops import FixedDirection, PlatformPose, WholeRobot
from hexopt.loops.known import square_root
from hexopt.loops.robot_set import RobotSet
from hexopt.rotations import euler_to_matrix

NOISE = hx.NormalNoise(0.01, np.deg2rad(0.01), 0.01)
TWELVE = np.random.default_rng(1).standard_normal((12, 12)) * [*[0.01] * 3, *[2e-4] * 3, *[0.01] * 6]
NOISES = {
    "plain": NOISE,
    "correlated": hx.NormalNoise(pose_covariance=TWELVE.T @ TWELVE),
    "common": hx.NormalNoise(0.005, 1e-4, 0.008, common_covariance=0.3 * TWELVE.T @ TWELVE),
}
LOCKS = ("none", "direction", "leg", "length")
MODELS = {36: 2, 42: 3, 48: 4}
NAMES = ("platform_point", "base_point", "offset", "gain")
N = 3
#: A robot of the same joints without limits, whose locked directions differ by as much as needed.
FREE = replace(
    hx.robots.left_hand(),
    limits=hx.Limits(),
    ranges=replace(hx.robots.left_hand().ranges, lock_cone=np.deg2rad(40)),
)


def simulated(lock, leg=None, *, robot=FREE, n=7, n_sets=None, noise=NOISE, nominal=None, seed=0, exact=False):
    """All six readings; exact ones know the noise all the same."""
    leg = None if lock == "none" else leg
    drawn = None if exact else noise
    data = hx.simulate(robot, lock, n, n_sets, drawn, robot.ranges, nominal, leg=leg, rng=seed)
    return replace(data, noise=noise)


def six_directions(**settings):
    return [simulated("direction", k, seed=10 + k, **settings) for k in range(1, 7)]


def random_set(lock, *, six=True, readings=True, batch=(), seed=0):
    """Poses that satisfy no lock, of a robot whose gains differ from 1."""
    rng = np.random.default_rng(seed)
    position = rng.uniform(-3, 3, (*batch, N, 3)) + np.array([0, 0, 19])
    rotation = euler_to_matrix(rng.uniform(-1, 1, (*batch, N, 3)))
    robot = replace(FREE, gains=rng.uniform(0.8, 1.2, 6))
    if six:
        locked = None if lock == "none" else 3
        return hx.Measurements(position, rotation, rng.uniform(2, 4, (*batch, N, 6)), lock, locked, NOISE, robot)
    length = rng.uniform(2, 4, (*batch, N)) if readings else None
    return hx.LegMeasurements(position, rotation, length, lock, NOISE, robot.leg(3))


SETS = {
    **{f"six, {lock}": {"lock": lock} for lock in LOCKS},
    **{f"one, {lock}": {"lock": lock, "six": False} for lock in LOCKS},
    **{f"unread, {lock}": {"lock": lock, "six": False, "readings": False} for lock in ("leg", "length")},
}


def set_of(name, model=48, **settings):
    """The equations of one set, and values at which nothing is degenerate."""
    data = random_set(**SETS[name], **settings)
    loop = WholeRobot(data, unknown=NAMES[: MODELS[model]])
    x = np.random.default_rng(2).uniform(1, 2, (*settings.get("batch", ()), loop.parameters.size))
    for place in ("fixed_point", "locked_length", "sphere"):
        if place in loop.parameters:
            x[..., loop.parameters[place]] += 5.0
    return loop, loop.parts[0][0], x


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("name", SETS)
class TestDerivatives:
    def test_by_the_parameters(self, name, model, central_difference):
        _, part, x = set_of(name, model)
        assert isinstance(part, RobotSet)
        assert part.jacobian(x).shape == (N, part.rows, part.parameters.size)
        np.testing.assert_allclose(part.jacobian(x), central_difference(part.residual, x), atol=1e-8)

    def test_by_the_errors_of_a_pose(self, name, model, central_difference):
        """The legs of a pose share its error; every reading is its own leg's."""
        _, part, x = set_of(name, model)
        count = 6 + len(part.legs)
        found = part.noise_jacobian(x)
        assert found.shape == (N, part.rows, count)
        moved = central_difference(lambda e: part.shifted(e).residual(x), np.zeros((N, count)))
        moved = moved.reshape(N, part.rows, N, count)
        for i in range(N):
            np.testing.assert_allclose(moved[i, :, i], found[i], atol=1e-8)
            assert not np.delete(moved[i], i, axis=1).any()

    def test_a_batch_equals_its_members(self, name, model):
        loop, part, x = set_of(name, model, batch=(2, 3))
        data = loop.sets[0]
        single = data[1, 2]
        alone = WholeRobot(single, unknown=loop.unknown).parts[0][0]
        for ask in ("residual", "jacobian", "noise_jacobian"):
            np.testing.assert_allclose(getattr(part, ask)(x)[1, 2], getattr(alone, ask)(x[1, 2]), atol=1e-13)

    def test_many_values_on_one_set(self, name, model):
        _, part, x = set_of(name, model)
        many = x + np.linspace(0, 0.1, 5)[:, None]
        for ask in ("residual", "jacobian", "noise_jacobian"):
            np.testing.assert_allclose(getattr(part, ask)(many)[3], getattr(part, ask)(many[3]), atol=1e-13)


class TestModel:
    def test_names_and_their_order(self):
        loop = WholeRobot(*six_directions(), simulated("length", 2, seed=1))
        main = [f"leg{k}.{name}" for k in range(1, 7) for name in NAMES[:3]]
        nuisance = [*(f"direction.{k}" for k in range(1, 7)), "locked_length"]
        assert loop.parameters.names == (*main, *nuisance)
        assert loop.parameters.main.names == tuple(main)
        assert loop.unit_vectors == tuple(nuisance[:6])
        assert loop.parameters.size == 42 + 18 + 1
        assert loop.chart().free == 42 + 12 + 1

    def test_legs_that_were_not_measured_are_not_there(self):
        one = hx.simulate_leg(FREE, 5, "direction", 7, noise=NOISE, rng=0)
        two = hx.simulate_leg(FREE, 2, "leg", 7, noise=NOISE, rng=0)
        assert WholeRobot(one, two).parameters.names == (
            *(f"leg2.{name}" for name in NAMES[:3]),
            *(f"leg5.{name}" for name in NAMES[:3]),
            "direction",
            "fixed_point",
        )

    @pytest.mark.parametrize("lock", LOCKS)
    def test_the_true_robot_closes_every_loop(self, lock, robot):
        data = hx.simulate(robot, lock, 5, 4, leg=None if lock == "none" else 4, rng=0)
        loop = WholeRobot(data)
        (residual,) = loop.residual(robot)
        assert residual.shape[:2] == (4, 5)
        assert np.abs(residual).max() < 200 * np.finfo(float).eps * robot.size

    def test_values_of_a_robot_a_vector_and_an_estimate(self):
        loop = WholeRobot(*six_directions(exact=True))
        x = loop.values(FREE)
        np.testing.assert_array_equal(loop.values(x), x)
        np.testing.assert_allclose(loop.values(x[:42]), x, atol=1e-13)
        main = hx.Estimate(x[:42], loop.parameters.main, np.array(0), None, "none", *(np.array(0.0),) * 3, 0)
        np.testing.assert_allclose(loop.values(main), x, atol=1e-13)
        whole = replace(main, values=x + 1, parameters=loop.parameters)
        np.testing.assert_array_equal(loop.values(whole), x + 1)

    def test_the_rows_of_a_pose_are_coupled_by_its_error(self):
        """S of six free legs is full: B Σ B' with one pose error, by hand for two legs."""
        loop = WholeRobot(simulated("none", exact=True))
        part, x = loop.parts[0][0], loop.values(FREE)
        root = part.whitened(x).root[0]
        s = np.linalg.inv(root.T @ root)
        data = loop.sets[0]
        units, turns = [], []
        for k in (2, 5):
            arm = data.rotation[0] @ FREE.leg(k).platform_point
            vector = data.position[0] + arm - FREE.leg(k).base_point
            units.append(vector / np.linalg.norm(vector))
            turns.append(np.cross(arm, units[-1]))
        angles = hx.rotations.matrix_to_euler(data.rotation[0], "ZXZ")
        euler = hx.rotations.euler_jacobian(angles, "ZXZ")
        expected = NOISE.position**2 * units[0] @ units[1] + NOISE.angle**2 * turns[0] @ euler @ euler.T @ turns[1]
        np.testing.assert_allclose(s[1, 4], expected, rtol=1e-8)


def dense_bound(loop, robot, derivative):
    """The inverse of the dense information G'S⁻¹G by values, S with what poses share; all by differences."""
    x = loop.values(robot)
    total = 0.0
    for part, place in loop.parts:
        n, e = part.data.n_poses, part.error_covariance.shape[-1]
        rows = part.rows
        g = np.zeros((n * rows, loop.parameters.size))
        g[:, place] = derivative(part.residual, x[place]).reshape(n * rows, -1)
        b = derivative(
            lambda z, part=part, place=place: part.shifted(np.tile(z, (part.data.n_poses, 1))).residual(x[place]),
            np.zeros(e),
        )
        s = block_diag(*(b[i] @ part.error_covariance[i] @ b[i].T for i in range(n)))
        common = part.data.noise.common(e - 6)
        if common is not None:
            shared = (b @ square_root(common)).reshape(n * rows, -1)
            s = s + shared @ shared.T
        total = total + g.T @ np.linalg.solve(s, g)
    basis = loop.chart().basis(x)
    reduced = basis.T @ total @ basis
    scale = np.sqrt(np.diag(reduced))
    inverse = np.linalg.inv(reduced / np.outer(scale, scale)) / np.outer(scale, scale)
    m = loop.parameters.main.size
    return (basis @ inverse @ basis.T)[:m, :m]


def assert_same_bound(found, expected, atol=1e-6):
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    np.testing.assert_allclose(found / scale, expected / scale, atol=atol)


class TestBound:
    @pytest.mark.parametrize("noise", NOISES)
    def test_it_is_the_dense_one(self, noise, central_difference):
        settings = {"exact": True, "noise": NOISES[noise]}
        loop = WholeRobot(
            simulated("direction", 1, **settings),
            simulated("length", 4, **settings),
            simulated("none", n=8, **settings),
        )
        assert_same_bound(loop.crlb(FREE), dense_bound(loop, FREE, central_difference), atol=1e-5)

    @pytest.mark.parametrize("model", MODELS)
    @pytest.mark.parametrize("noise", NOISES)
    def test_unlocked_poses_are_those_of_forward_kinematics(self, model, noise):
        """The computed pose against the measured one, and six loops side by side, are one likelihood."""
        robot = hx.robots.left_hand()
        data = hx.simulate(robot, "none", 16, rng=3)
        data = replace(data, noise=NOISES[noise])
        unknown = NAMES[: MODELS[model]]
        expected = PlatformPose(data, unknown=unknown).crlb(robot)
        assert_same_bound(WholeRobot(data, unknown=unknown).crlb(robot), expected, atol=1e-8)

    def test_one_leg_is_its_loop(self):
        data = hx.simulate_leg(FREE, 3, "direction", 8, noise=NOISE, rng=0)
        joined = WholeRobot(data, unknown=NAMES[:2])
        np.testing.assert_allclose(joined.crlb(FREE), FixedDirection(data).crlb(FREE.leg(3)), rtol=1e-9)

    def test_what_the_other_legs_bring(self):
        """Six locked directions, 7 poses each, offsets unknown: the ratios of METHODS 3, as bounds."""
        gains = {name: [] for name in NAMES[:2]}
        for draw in range(10):
            sets = [simulated("direction", k, seed=100 * draw + k, exact=True) for k in range(1, 7)]
            together = np.diag(WholeRobot(*sets).crlb(FREE)).reshape(6, 7)
            alone = np.stack([np.diag(FixedDirection(d.leg(k)).crlb(FREE.leg(k))) for k, d in enumerate(sets, 1)])
            for name, part in zip(NAMES[:2], (slice(0, 3), slice(3, 6)), strict=True):
                gains[name].append((together[:, part].sum(), alone[:, part].sum()))
        ratio = {name: np.sqrt(np.divide(*np.mean(pairs, axis=0)[::-1])) for name, pairs in gains.items()}
        assert ratio["base_point"] >= 4
        assert ratio["platform_point"] >= 1.5

    def test_few_poses_of_one_set_bring_nothing_to_its_leg(self):
        """With as many unknowns as poses the other legs say nothing; with more poses they begin to help."""
        gains = []
        for n in (6, 14):
            data = simulated("direction", 3, n=n, exact=True, seed=4)
            bound = WholeRobot(data, unknown=NAMES[:2]).crlb(FREE)[12:18, 12:18]
            alone = FixedDirection(data.leg(3)).crlb(FREE.leg(3))
            gains.append(np.sqrt(np.trace(alone) / np.trace(bound)))
        np.testing.assert_allclose(gains[0], 1.0, atol=1e-6)
        assert gains[1] > 1.02


class TestStart:
    def test_six_directions_need_no_guess(self):
        """Exact poses: a and b of every leg are found though the nominal is 5 cm off; the offset is the nominal's."""
        nominal = FREE.perturbed(5.0, rng=0)
        loop = WholeRobot(*six_directions(exact=True), nominal=nominal)
        np.testing.assert_allclose(loop.start(), loop.values(FREE), atol=1e-10)

    def test_two_steps_of_one_leg(self):
        """b by its LEG set, then a by its LENGTH set."""
        nominal = FREE.perturbed(3.0, rng=0)
        sets = [
            hx.simulate_leg(FREE, 3, lock, 8, nominal=nominal, rng=seed) for seed, lock in enumerate(("leg", "length"))
        ]
        loop = WholeRobot(*(replace(data, noise=NOISE) for data in sets))
        found = loop.parameters.split(loop.start())
        np.testing.assert_allclose(found["leg3.platform_point"], FREE.leg(3).platform_point, atol=1e-10)
        np.testing.assert_allclose(found["leg3.base_point"], FREE.leg(3).base_point, atol=1e-9)

    def test_unlocked_poses_start_at_the_nominal(self):
        nominal = FREE.perturbed(0.3, offsets=0.2, rng=0)
        loop = WholeRobot(simulated("none", nominal=nominal))
        np.testing.assert_array_equal(loop.start(), loop.values(nominal))

    def test_the_nominal_that_is_given_counts(self):
        """Not the one of the data, nor is one of the data needed."""
        nominal = FREE.perturbed(0.0, offsets=0.7, rng=0)
        sets = six_directions(exact=True)
        given = WholeRobot(*sets, nominal=nominal).start()
        without = WholeRobot(*(replace(data, nominal=None) for data in sets), nominal=nominal).start()
        theirs = WholeRobot(*(replace(data, nominal=nominal) for data in sets)).start()
        np.testing.assert_allclose(given, theirs, atol=1e-12)
        np.testing.assert_allclose(without, theirs, atol=1e-12)

    def test_too_few_poses_for_a_linear_start_leave_the_nominal(self):
        nominal = FREE.perturbed(0.3, rng=0)
        loop = WholeRobot(*(data.poses([0, 1]) for data in six_directions()), nominal=nominal)
        np.testing.assert_array_equal(loop.start()[:42], loop.values(nominal)[:42])

    def test_a_batch(self):
        many = six_directions(n_sets=3)
        found = WholeRobot(*many).start()
        assert found.shape == (3, 60)
        np.testing.assert_allclose(found[1], WholeRobot(*(data[1] for data in many)).start(), atol=1e-9)


class TestMistakes:
    def test_no_sets(self):
        with pytest.raises(InputError, match="no measurements"):
            WholeRobot()

    def test_a_list_of_sets(self):
        with pytest.raises(InputError, match=r"set 1: expected Measurements .* got list"):
            WholeRobot(six_directions())

    def test_no_poses(self):
        data = simulated("none")
        with pytest.raises(InputError, match="set 2 has no poses"):
            WholeRobot(data, simulated("none", seed=1).poses(slice(0, 0)))

    def test_no_nominal(self):
        with pytest.raises(InputError, match="nominal="):
            WholeRobot(replace(simulated("none"), nominal=None))

    def test_two_units(self):
        other = hx.simulate(hx.robots.rubin(), n_poses=4, noise=NOISE, rng=0)
        with pytest.raises(UnitError, match="cm and um"):
            WholeRobot(simulated("none"), other)
        with pytest.raises(UnitError, match="cm and um"):
            WholeRobot(simulated("none"), nominal=hx.robots.rubin())

    def test_a_pose_twice(self):
        data = simulated("none")
        with pytest.raises(InputError, match="sets 1 and 3 have a pose in common"):
            WholeRobot(data, simulated("none", seed=1), data.poses([4]))
        with pytest.raises(InputError, match="sets 1 and 2 have a pose in common"):
            WholeRobot(data.leg(1), data.leg(2))

    def test_batches_that_do_not_fit(self):
        with pytest.raises(InputError, match=r"batches \(3,\), \(4,\) do not fit"):
            WholeRobot(simulated("none", n_sets=3), simulated("none", n_sets=4, seed=1))

    @pytest.mark.parametrize("lock", ["none", "direction"])
    def test_no_readings(self, lock):
        data = hx.simulate_leg(FREE, 3, lock, 7, noise=NOISE, rng=0)
        with pytest.raises(InputError, match=r"leg 3: .* needs readings"):
            WholeRobot(replace(data, length=None))

    def test_no_noise_model(self):
        loop = WholeRobot(*six_directions(noise=None))
        with pytest.raises(InputError, match="no noise model"):
            loop.crlb(FREE)

    def test_a_strange_block(self):
        with pytest.raises(InputError, match="unknown"):
            WholeRobot(simulated("none"), unknown=("direction",))

    def test_another_leg(self):
        loop = WholeRobot(hx.simulate_leg(FREE, 3, "direction", 7, noise=NOISE, rng=0))
        with pytest.raises(InputError, match="leg 2 is given"):
            loop.values(FREE.leg(2))

    def test_one_direction_does_not_see_the_offset(self):
        data = hx.simulate_leg(FREE, 3, "direction", 9, noise=NOISE, rng=0)
        with pytest.raises(RankDeficientError) as caught:
            WholeRobot(data).crlb(FREE)
        (combination,) = caught.value.combinations
        assert "leg3.offset" in combination
        assert "leg3.base_point" in combination

    def test_two_directions_do(self):
        sets = [hx.simulate_leg(FREE, 3, "direction", 9, noise=NOISE, rng=seed) for seed in (0, 1)]
        assert np.isfinite(WholeRobot(*sets).crlb(FREE)).all()

    def test_sets_without_readings_do_not_see_the_offset(self):
        sets = [hx.simulate_leg(FREE, 3, lock, 9, noise=NOISE, rng=0) for lock in ("leg", "length")]
        sets = [replace(data, length=None) for data in sets]
        with pytest.raises(RankDeficientError) as caught:
            WholeRobot(*sets).crlb(FREE)
        assert caught.value.combinations == ("leg3.offset",)
        assert np.isfinite(WholeRobot(*sets, unknown=NAMES[:2]).crlb(FREE)).all()
