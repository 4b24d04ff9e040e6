"""What is written is read again: to the bit where it can be, to rounding elsewhere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import hexopt as hx

ROBOT = hx.robots.left_hand()
KINDS = [("quaternion", None), ("matrix", None), ("rotation_vector", "deg"), ("ZXZ", "rad"), ("xyz", "deg")]
FINITE = st.floats(allow_nan=False, allow_infinity=False)


def rotations(count, seed=0):
    return Rotation.random(count, rng=np.random.default_rng(seed)).as_matrix()


@pytest.fixture(scope="session")
def path(tmp_path_factory):
    return tmp_path_factory.mktemp("round-trip") / "poses.csv"


@settings(deadline=None, max_examples=50)
@given(values=hnp.arrays(float, hnp.array_shapes(min_dims=2, max_dims=2, min_side=9, max_side=9), elements=FINITE))
def test_every_finite_number_survives_to_the_bit(path, values):
    data = hx.Measurements(values[:, :3], rotations(9), values[:, 3:])
    hx.write_measurements(data, path, orientation="matrix")
    (back,) = hx.read_measurements(path, length_unit="cm", orientation="matrix")
    for name in ("position", "rotation", "length"):
        assert getattr(back, name).tobytes() == getattr(data, name).tobytes()


@pytest.mark.parametrize(("orientation", "angle_unit"), KINDS)
def test_orientations_survive_to_rounding(path, orientation, angle_unit):
    data = hx.Measurements(np.zeros((500, 3)), rotations(500), np.ones((500, 6)))
    hx.write_measurements(data, path, orientation=orientation, angle_unit=angle_unit)
    (back,) = hx.read_measurements(path, length_unit="cm", orientation=orientation, angle_unit=angle_unit)
    assert_allclose(back.rotation, data.rotation, rtol=0, atol=4e-15)


def test_sets_keep_their_order_lock_and_leg(path):
    locks = [("length", 6), ("none", None), ("direction", 1), ("leg", 3)]
    sets = [hx.simulate(ROBOT, lock, n_poses=3 + i, leg=leg, rng=i) for i, (lock, leg) in enumerate(locks)]
    hx.write_measurements(sets, path)
    back = hx.read_measurements(path, length_unit="cm", nominal=ROBOT)
    assert [(data.lock, data.locked_leg, data.n_poses) for data in back] == [
        (lock, leg, 3 + i) for i, (lock, leg) in enumerate(locks)
    ]
    for data, written in zip(back, sets, strict=True):
        assert_array_equal(data.length, written.length)
        assert data.nominal is ROBOT


def test_one_leg_a_set(path):
    noise = hx.UniformNoise(0.01, 0.001, 0.01)
    sets = [hx.simulate_leg(ROBOT, leg, lock, 4, rng=leg) for leg, lock in ((2, "none"), (5, "length"))]
    hx.write_measurements(sets, path, orientation="matrix")
    back = hx.read_measurements(path, length_unit="cm", orientation="matrix", nominal=ROBOT, noise=noise)
    for data, written in zip(back, sets, strict=True):
        assert isinstance(data, hx.LegMeasurements)
        assert (data.leg, data.lock, data.noise) == (written.leg, written.lock, noise)
        assert_array_equal(data.length, written.length)
        assert_array_equal(data.nominal.base_point, ROBOT.leg(data.leg).base_point)


def test_readings_that_were_not_taken_stay_so(path):
    taken = hx.simulate_leg(ROBOT, 3, "length", 5, rng=0)
    without = hx.LegMeasurements(taken.position, taken.rotation, None, "leg", nominal=ROBOT.leg(3))
    hx.write_measurements([without, taken], path)
    first, second = hx.read_measurements(path, length_unit="cm", nominal=ROBOT)
    assert first.length is None
    assert_array_equal(second.length, taken.length)


def test_a_batch_is_a_set_a_member(path):
    batch = hx.simulate(ROBOT, "direction", n_poses=3, n_sets=4, leg=2, rng=0)
    hx.write_measurements(batch, path)
    back = hx.read_measurements(path, length_unit="cm")
    assert_array_equal([data.length for data in back], batch.length)


def test_a_covariance_of_all_readings_becomes_that_of_the_leg(path):
    noise = hx.NormalNoise(pose_covariance=np.diag(np.arange(1.0, 13.0)))
    hx.write_measurements(hx.simulate_leg(ROBOT, 4, "none", 3, rng=0), path)
    (data,) = hx.read_measurements(path, length_unit="cm", nominal=ROBOT, noise=noise)
    assert data.noise.pose_covariance[6, 6] == 10.0


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (list, "no poses to write"),
        (lambda: hx.simulate(ROBOT, n_poses=3, n_sets=2, rng=0)[:0], "no poses to write"),
        (lambda: [1], "expected Measurements or LegMeasurements, got int"),
        (
            lambda: [hx.simulate(ROBOT, n_poses=3, rng=0), hx.simulate_leg(ROBOT, 1, "none", 3, rng=0)],
            "write two files",
        ),
        (
            lambda: [hx.simulate(robot, n_poses=3, rng=0) for robot in (ROBOT, hx.robots.jugglebot())],
            "in cm and mm; a file has one",
        ),
        (
            lambda: hx.LegMeasurements(np.zeros((2, 3)), rotations(2), np.ones(2), "none"),
            "which leg was measured",
        ),
    ],
)
def test_what_cannot_be_written_leaves_no_file(tmp_path, make, message):
    with pytest.raises(hx.errors.InputError, match=message):
        hx.write_measurements(make(), tmp_path / "poses.csv")
    assert list(tmp_path.iterdir()) == []


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(hx.errors.InputError, match=r"nowhere/poses\.csv: cannot be written"):
        hx.write_measurements(hx.simulate(ROBOT, n_poses=3, rng=0), tmp_path / "nowhere" / "poses.csv")
