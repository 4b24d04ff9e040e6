"""Lists of poses: as measurements, but readings need not be there."""

from pathlib import Path

import numpy as np
import pytest

import hexopt as hx
from hexopt.readers.listing import read_poses

ROBOT = hx.robots.left_hand()
HEAD = "position_x,position_y,position_z,orientation_x,orientation_y,orientation_z,orientation_w"


@pytest.fixture
def path(tmp_path):
    return tmp_path / "poses.csv"


def test_poses_alone(path):
    path.write_text(f"{HEAD}\n1,2,190,0,0,0,1\n3,4,200,0,0,1,0\n")
    (found,) = read_poses(path, ROBOT, length_unit="mm")
    assert (found.lock, found.leg) == (None, None)
    np.testing.assert_allclose(found.position, [[0.1, 0.2, 19], [0.3, 0.4, 20]])
    np.testing.assert_allclose(found.rotation, [np.eye(3), np.diag([-1, -1, 1])])


@pytest.mark.parametrize("single", [False, True])
def test_a_file_of_measurements_is_such_a_list_too(path, single):
    sets = [hx.simulate(ROBOT, "leg", 4, leg=k, rng=k) for k in (2, 5)]
    hx.write_measurements([one.leg(one.locked_leg) for one in sets] if single else sets, path)
    found = read_poses(path, ROBOT, length_unit="cm")
    assert [(part.lock, part.leg) for part in found] == [(hx.Lock.LEG, 2), (hx.Lock.LEG, 5)]
    for part, one in zip(found, sets, strict=True):
        np.testing.assert_array_equal(part.position, one.position)
        np.testing.assert_allclose(part.rotation, one.rotation, atol=1e-14)


def test_other_orientations_and_names(path):
    path.write_text("X,position_y,position_z,orientation_1,orientation_2,orientation_3\n1,2,19,10,20,30\n")
    settings = {"length_unit": "cm", "orientation": "ZXZ", "angle_unit": "deg", "columns": {"position_x": "X"}}
    (found,) = read_poses(path, ROBOT, **settings)
    np.testing.assert_allclose(found.position, [[1, 2, 19]])
    expected = hx.rotations.euler_to_matrix(np.deg2rad([10, 20, 30]), "ZXZ")
    np.testing.assert_allclose(found.rotation[0], expected)


@pytest.mark.parametrize(
    ("text", "fragment"),
    [
        (f"{HEAD}\n1,2,3,0,0,0,2\n", "line 2"),
        (f"{HEAD}\n1,nan,3,0,0,0,1\n", "line 2, column 'position_y': got 'nan'"),
        (HEAD.replace("position_z", "z") + "\n1,2,3,0,0,0,1\n", "misses position_z"),
        (f"lock,{HEAD}\nleg,1,2,3,0,0,0,1\n", "the lock is 'leg', but of which leg"),
        ("", "is empty"),
    ],
)
def test_faults_have_a_place(path, text, fragment):
    path.write_text(text)
    with pytest.raises(hx.InputError, match=fragment):
        read_poses(path, ROBOT, length_unit="cm")


def test_a_missing_file():
    with pytest.raises(hx.InputError, match=r"none\.csv: cannot be read"):
        read_poses(Path("none.csv"), ROBOT, length_unit="cm")
