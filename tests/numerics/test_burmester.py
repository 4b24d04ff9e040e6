"""All twenty solutions of the spatial Burmester problem: that there are as many, that they solve it, and when not."""

from itertools import combinations_with_replacement

import numpy as np
import pytest

import hexopt as hx
from hexopt.numerics.burmester import COUNT, burmester_solutions
from hexopt.rotations import euler_to_matrix, rotation_vector_to_matrix

PRIME = 1_000_003


def poses(n_sets, rng=0, lock="length", robot=None, **changes):
    data = hx.simulate_leg(robot or hx.robots.left_hand(), 3, lock, 7, n_sets, rng=rng, **changes)
    return np.array(data.position), np.array(data.rotation)


def gathered(found):
    """b and a side by side, (..., 20, 6)."""
    return np.concatenate([found.platform_points, found.base_points], axis=-1)


def unequal(position, rotation, found):
    """By how much the squared distances of the poses differ, relative to their size, for every solution."""
    b, a = found.platform_points[..., :, None, :], found.base_points[..., :, None, :]
    vector = position[..., None, :, :] + (rotation[..., None, :, :, :] @ b[..., None])[..., 0] - a
    square = (vector**2).sum(axis=-1)
    size = (np.abs(vector) ** 2).sum(axis=-1).max(axis=-1)
    return np.abs(square - square[..., :1]).max(axis=-1) / size


@pytest.fixture(scope="module")
def thousand():
    position, rotation = poses(1000)
    return position, rotation, burmester_solutions(position, rotation)


class TestTwenty:
    def test_on_a_thousand_random_problems(self, thousand):
        """All found, all different, all solve it, the true one among them."""
        position, rotation, found = thousand
        assert found.regular.all()
        assert found.complete.all()
        assert found.platform_points.shape == found.base_points.shape == (1000, COUNT, 3)
        assert unequal(position, rotation, found).max() < 1e-9
        points = gathered(found)
        apart = np.linalg.norm(points[:, :, None] - points[:, None], axis=-1) + 1e9 * np.eye(COUNT)
        assert (apart.min(axis=-1) > 1e-6 * np.linalg.norm(points, axis=-1)).all()
        leg = hx.robots.left_hand().leg(3)
        truth = np.concatenate([leg.platform_point, leg.base_point])
        assert np.linalg.norm(points - truth, axis=-1).min(axis=-1).max() < 1e-8

    def test_real_ones_and_conjugate_pairs(self, thousand):
        """From two up an even number is real; the others come in conjugate pairs."""
        *_, found = thousand
        count = found.real.sum(axis=-1)
        assert {2, 4, 6, 8, 10} <= set(count.tolist()) <= {2, 4, 6, 8, 10, 12, 14, 16}
        points = gathered(found)
        assert (points.imag[found.real] == 0).all()
        conjugate = np.linalg.norm(points.conj()[:, :, None] - points[:, None], axis=-1)
        assert (conjugate.min(axis=-1) <= 1e-7 * (1 + np.linalg.norm(points, axis=-1))).all()
        assert (np.linalg.norm(points.imag[~found.real], axis=-1) > 1e-6).all()

    @pytest.mark.parametrize("seed", range(3))
    def test_over_a_finite_field(self, seed):
        """The same count by exact ranks, of rational poses modulo a prime: nullities 10, 16, 20, 20, 20."""
        forms = forms_modulo(np.random.default_rng(seed))
        nullity = []
        for degree in range(1, 6):
            matrix = macaulay_modulo(forms, degree)
            nullity.append(matrix.shape[1] - rank_modulo(matrix))
        assert nullity == [10, 16, COUNT, COUNT, COUNT]

    def test_they_do_not_all_move_with_one_solution(self):
        """Poses made for a given point have 19 others, which differ from problem to problem."""
        position, rotation = poses(2)
        points = gathered(burmester_solutions(position, rotation))
        apart = np.linalg.norm(points[0][:, None] - points[1], axis=-1)
        assert (apart < 1e-6).sum() == 1


def forms_modulo(rng):
    """The bilinear forms of six differences to the first of seven random rational poses."""
    forms = []
    for _ in range(7):
        w, x, y, z = (int(v) for v in rng.integers(1, PRIME, 4))
        scale = pow(w * w + x * x + y * y + z * z, -1, PRIME)
        rotation = [
            [w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z],
        ]
        rotation = [[entry * scale % PRIME for entry in row] for row in rotation]
        p = [int(v) for v in rng.integers(0, PRIME, 3)]
        form = np.zeros((4, 4), dtype=np.int64)
        form[0, 0] = sum(v * v for v in p) * pow(2, -1, PRIME) % PRIME
        for i in range(3):
            form[1 + i, 0] = sum(rotation[j][i] * p[j] for j in range(3)) % PRIME
            form[0, 1 + i] = -p[i] % PRIME
            for j in range(3):
                form[1 + i, 1 + j] = -rotation[j][i] % PRIME
        forms.append(form)
    return [(form - forms[0]) % PRIME for form in forms[1:]]


def macaulay_modulo(forms, degree):
    """Each form times each monomial of degree − 1 in (1, b); columns are monomials of the degree times (1, a)."""
    columns = {m: i for i, m in enumerate(combinations_with_replacement(range(4), degree))}
    rows = []
    for form in forms:
        for monomial in combinations_with_replacement(range(4), degree - 1):
            row = np.zeros((len(columns), 4), dtype=np.int64)
            for j in range(4):
                row[columns[tuple(sorted((*monomial, j)))]] = form[j]
            rows.append(row.ravel())
    return np.array(rows)


def rank_modulo(matrix):
    matrix, rank = matrix.copy(), 0
    for column in range(matrix.shape[1]):
        below = np.flatnonzero(matrix[rank:, column])
        if not below.size:
            continue
        pivot = rank + below[0]
        matrix[[rank, pivot]] = matrix[[pivot, rank]]
        matrix[rank] = matrix[rank] * pow(int(matrix[rank, column]), -1, PRIME) % PRIME
        others = np.flatnonzero(matrix[rank + 1 :, column]) + rank + 1
        matrix[others] = (matrix[others] - matrix[others, column, None] * matrix[rank]) % PRIME
        rank += 1
        if rank == len(matrix):
            break
    return rank


class TestBatch:
    def test_it_equals_its_members(self):
        position, rotation = poses(6)
        together = burmester_solutions(position.reshape(2, 3, 7, 3), rotation.reshape(2, 3, 7, 3, 3))
        assert together.regular.shape == (2, 3)
        for i in range(6):
            alone = burmester_solutions(position[i], rotation[i])
            whole = gathered(together)[divmod(i, 3)]
            apart = np.linalg.norm(whole[:, None] - gathered(alone), axis=-1)
            assert (apart.min(axis=-1) < 1e-8 * (1 + np.linalg.norm(whole, axis=-1))).all()
            assert alone.real.sum() == together.real[divmod(i, 3)].sum()

    def test_an_empty_one(self):
        position, rotation = poses(2)
        assert burmester_solutions(position[:0], rotation[:0]).base_points.shape == (0, COUNT, 3)

    def test_the_same_bits_again_and_read_only(self):
        position, rotation = poses(3)
        one, two = burmester_solutions(position, rotation), burmester_solutions(position, rotation)
        assert gathered(one).tobytes() == gathered(two).tobytes()
        with pytest.raises(ValueError, match="read-only"):
            one.base_points[0] = 0


def matched(first, second, tolerance):
    """Whether two lists of solutions are the same, in any order."""
    apart = np.linalg.norm(first[..., :, None, :] - second[..., None, :, :], axis=-1)
    size = 1 + np.linalg.norm(first, axis=-1)
    return (apart.min(axis=-1) < tolerance * size).all()


class TestFrames:
    def test_order_frames_and_units(self):
        """Solutions move with the frames and units, and do not see the order of the poses."""
        position, rotation = poses(20)
        reference = gathered(burmester_solutions(position, rotation))
        order = np.random.default_rng(0).permutation(7)
        assert matched(reference, gathered(burmester_solutions(position[:, order], rotation[:, order])), 1e-7)
        turn, shift = euler_to_matrix([0.4, -1.1, 2.0]), np.array([30.0, -70.0, 20.0])
        lever, unit = np.array([10.0, 5.0, -20.0]), 1e4
        found = burmester_solutions(unit * ((position + rotation @ lever) @ turn.T + shift), turn @ rotation)
        back = np.concatenate(
            [found.platform_points / unit + lever, (found.base_points / unit - shift) @ turn], axis=-1
        )
        assert matched(reference, back, 1e-6)

    @pytest.mark.parametrize("far", [1e2, 1e3])
    def test_far_origins_cost_digits_only(self, far):
        robot = hx.robots.left_hand()
        position, rotation = poses(50)
        shift = far * np.array([1.0, 0.5, -0.3])
        found = burmester_solutions(position + shift, rotation)
        truth = np.concatenate([robot.leg(3).platform_point, robot.leg(3).base_point + shift])
        assert found.complete.all()
        assert np.linalg.norm(gathered(found) - truth, axis=-1).min(axis=-1).max() < 1e-7


def about_one_axis(n_sets=5, tilt=0.0, axis=(0.0, 0.0, 1.0), seed=0):
    """Poses of one leg length, turned about one axis, or nearly so."""
    rng = np.random.default_rng(seed)
    leg = hx.robots.left_hand().leg(3)
    turns = rng.uniform(-0.6, 0.6, (n_sets, 7, 1)) * np.array(axis) + tilt * rng.standard_normal((n_sets, 7, 3))
    rotation = rotation_vector_to_matrix(turns)
    direction = rng.standard_normal((n_sets, 7, 3))
    direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
    return leg.base_point + 19 * direction - rotation @ leg.platform_point, rotation


def spoilt(kind):
    """Problems without exactly twenty solutions."""
    position, rotation = poses(5)
    if kind == "repeated pose":
        position[:, 3], rotation[:, 3] = position[:, 5], rotation[:, 5]
    elif kind == "standing still":
        position[:], rotation[:] = position[:, :1], rotation[:, :1]
    elif kind == "no turn":
        rotation[:] = np.eye(3)
    elif kind == "no shift":
        position[:] = 0.0
    elif kind == "fixed leg":
        position, rotation = poses(5, lock="leg")
    elif kind == "one axis":
        position, rotation = about_one_axis()
    else:
        position, rotation = about_one_axis(axis=(0.48, -0.6, 0.64))
    return position, rotation


KINDS = ["repeated pose", "standing still", "no turn", "no shift", "fixed leg", "one axis", "one tilted axis"]


class TestDegenerate:
    @pytest.mark.parametrize("kind", KINDS)
    def test_it_is_not_regular_and_fails_alone(self, kind):
        position, rotation = poses(5)
        clean = burmester_solutions(position, rotation)
        bad_position, bad_rotation = spoilt(kind)
        position[2], rotation[2] = bad_position[2], bad_rotation[2]
        found = burmester_solutions(position, rotation)
        np.testing.assert_array_equal(found.regular, [True, True, False, True, True])
        np.testing.assert_array_equal(found.complete, found.regular)
        assert np.isnan(found.base_points[2]).all()
        assert not found.real[2].any()
        others = [0, 1, 3, 4]
        assert matched(gathered(clean)[others], gathered(found)[others], 1e-9)

    @pytest.mark.parametrize("tilt", [0.0, *10.0 ** np.arange(-16.0, -3.0)])
    def test_nearly_one_axis_never_crashes(self, tilt):
        """What is complete solves the equations; the nearer to one axis, the less is."""
        position, rotation = about_one_axis(30, tilt)
        found = burmester_solutions(position, rotation)
        assert not (found.complete & ~found.regular).any()
        if tilt <= 1e-14:
            assert not found.regular.any()
        assert (found.residual[found.complete] < 1e-12).all()

    def test_a_double_solution_is_not_complete(self):
        """Legs across what a step of (b, a) moves: the true solution is a double one, which rounding splits."""
        rng = np.random.default_rng(0)
        leg = hx.robots.left_hand().leg(3)
        rotation = rotation_vector_to_matrix(rng.uniform(-0.6, 0.6, (20, 7, 3)))
        moved = rotation @ np.array([1.0, -0.4, 0.3]) - np.array([0.2, 0.9, -0.7])
        direction = np.cross(moved, rng.standard_normal((20, 7, 3)))
        direction /= np.linalg.norm(direction, axis=-1, keepdims=True)
        position = leg.base_point + 19 * direction - rotation @ leg.platform_point
        found = burmester_solutions(position, rotation)
        assert found.regular.all()
        assert not found.complete.any()
        truth = np.concatenate([leg.platform_point, leg.base_point])
        near = np.sort(np.linalg.norm(gathered(found) - truth, axis=-1), axis=-1)
        assert (near[:, 1] < 1e-4).all()
        assert (near[:, 2] > 1e-3).all()
