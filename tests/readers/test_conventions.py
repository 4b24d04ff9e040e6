"""Units, orientations, column names and dialects: each is what it says, with SciPy as the reference."""

import subprocess
import sys

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal
from scipy.spatial.transform import Rotation

import hexopt as hx
from hexopt.errors import FileFormatError, InputError, UnitError

TURNS = Rotation.random(5, rng=np.random.default_rng(1))
POSITION = np.arange(15.0).reshape(5, 3)
READINGS = np.arange(30.0).reshape(5, 6) + 1
NAMES = [f"leg_length_{k}" for k in range(1, 7)] + [f"position_{axis}" for axis in "xyz"]


@pytest.fixture
def write(tmp_path):
    """Write a file of the readings, the positions and an orientation; more columns by name."""

    def write_file(suffixes="xyzw", values=None, *, separator=",", names=NAMES, newline="\n", bom=False, **more):
        values = TURNS.as_quat() if values is None else values
        header = [*names, *(f"orientation_{suffix}" for suffix in suffixes), *more]
        rows = np.hstack([READINGS, POSITION, values]).tolist()
        extra = [list(column) for column in zip(*more.values(), strict=True)] or [[]] * len(rows)
        lines = [separator.join(map(str, [*row, *cells])) for row, cells in zip(rows, extra, strict=True)]
        path = tmp_path / "poses.csv"
        text = newline.join([separator.join(header), *lines]) + newline
        path.write_bytes(text.encode("utf-8-sig" if bom else "utf-8"))
        return path

    return write_file


@pytest.mark.parametrize(
    ("orientation", "angle_unit", "suffixes", "values"),
    [
        ("quaternion", None, "xyzw", TURNS.as_quat()),
        ("quaternion", None, "wxyz", TURNS.as_quat(scalar_first=True)),
        ("matrix", None, ["11", "12", "13", "21", "22", "23", "31", "32", "33"], TURNS.as_matrix().reshape(5, 9)),
        ("matrix", None, ["11", "21", "31", "12", "22", "32", "13", "23", "33"], TURNS.inv().as_matrix().reshape(5, 9)),
        ("rotation_vector", "rad", "xyz", TURNS.as_rotvec()),
        ("rotation_vector", "deg", "xyz", TURNS.as_rotvec(degrees=True)),
        ("ZXZ", "deg", "123", TURNS.as_euler("ZXZ", degrees=True)),
        ("zyx", "rad", "123", TURNS.as_euler("zyx")),
        ("XYZ", "rad", "123", TURNS.as_euler("XYZ")),
    ],
)
def test_orientations_are_those_of_scipy(write, orientation, angle_unit, suffixes, values):
    path = write(suffixes, values)
    (data,) = hx.read_measurements(path, length_unit="mm", orientation=orientation, angle_unit=angle_unit)
    assert_allclose(data.rotation, TURNS.as_matrix(), atol=1e-14)
    assert_array_equal(data.position, POSITION)
    assert_array_equal(data.length, READINGS)
    assert (data.lock, data.locked_leg, data.length_unit) == ("none", None, "mm")


@pytest.mark.parametrize("separator", [",", ";", "\t", ", "])
@pytest.mark.parametrize("newline", ["\n", "\r\n", "\r", "\n\n"])
@pytest.mark.parametrize("bom", [False, True])
def test_dialects_give_the_same(write, separator, newline, bom):
    (data,) = hx.read_measurements(write(separator=separator, newline=newline, bom=bom), length_unit="mm")
    assert_array_equal(data.length, READINGS)


def test_quotes_and_other_columns_are_left_alone(write):
    path = write(time=range(5), **{"": range(5), "note": ['"two\nlines, quoted"', *"bcde"]})
    (data,) = hx.read_measurements(path, length_unit="mm")
    assert_array_equal(data.position, POSITION)


def test_columns_by_other_names(write):
    names = ["rho1", *NAMES[1:6], "X [mm]", "position_x", "position_y"]
    columns = {
        "leg_length_1": "rho1",
        "position_x": "X [mm]",
        "position_y": "position_x",
        "position_z": "position_y",
        "orientation_w": "orientation_q0",
    }
    path = write(["x", "y", "z", "q0"], names=names)
    (data,) = hx.read_measurements(path, length_unit="mm", columns=columns)
    assert_array_equal(data.position, POSITION)
    assert_array_equal(data.length, READINGS)


def test_lengths_come_in_the_unit_of_the_nominal(write):
    robot = hx.robots.left_hand()
    (data,) = hx.read_measurements(write(), length_unit="mm", nominal=robot)
    assert data.length_unit == "cm"
    assert_allclose(data.position, POSITION / 10)
    assert_allclose(data.length, READINGS / 10)


def test_readings_of_a_sensor_with_a_unit_of_its_own_stay(write):
    (data,) = hx.read_measurements(write(), length_unit="cm", nominal=hx.robots.jugglebot())
    assert_allclose(data.position, POSITION * 10)
    assert_array_equal(data.length, READINGS)


def test_sets_locks_and_legs(write):
    path = write(
        set=["a", "a", "b", "c", "c"], lock=["leg", "leg", "none", "length", "length"], leg=[2, 2, "", 6.0, 6.0]
    )
    sets = hx.read_measurements(path, length_unit="mm")
    assert [(data.n_poses, str(data.lock), data.locked_leg) for data in sets] == [
        (2, "leg", 2),
        (1, "none", None),
        (2, "length", 6),
    ]
    assert_array_equal(np.vstack([data.position for data in sets]), POSITION)


@pytest.mark.parametrize(
    ("settings", "error", "message"),
    [
        ({"length_unit": "furlong"}, UnitError, "length_unit: unknown length unit 'furlong'"),
        ({"length_unit": None}, UnitError, "length_unit: unknown length unit None"),
        ({"orientation": "ZZX"}, InputError, "orientation: expected quaternion, matrix, rotation_vector, or an Euler"),
        ({"orientation": "euler"}, InputError, "orientation: expected quaternion, matrix"),
        ({"orientation": 3}, InputError, "orientation: input should be a valid string, got 3"),
        ({"orientation": "ZXZ"}, InputError, "angle_unit: 'ZXZ' has angles; say whether they are 'deg' or 'rad'"),
        ({"orientation": "rotation_vector"}, InputError, "angle_unit: 'rotation_vector' has angles"),
        ({"angle_unit": "deg"}, InputError, "angle_unit: 'quaternion' has no angles; leave the unit out"),
        ({"orientation": "ZXZ", "angle_unit": "grad"}, InputError, "angle_unit: input should be 'deg' or 'rad'"),
        ({"columns": {"x": "X"}}, InputError, "columns: 'x' is not a column of hexopt's; expected set, leg, lock"),
        ({"columns": {"set": "A", "leg": "A"}}, InputError, "set and leg would both be read from 'A'"),
        ({"columns": [1]}, InputError, "columns: input should be a valid dictionary"),
        ({"columns": {"set": "A"}}, FileFormatError, "has no column 'A', from which set is to be read. It has leg_len"),
        ({"columns": {"position_x": "position_y"}}, FileFormatError, "misses position_y. It has"),
        ({"nominal": "left-hand"}, InputError, "nominal: input should be an instance of Hexapod"),
        ({"noise": 0.01}, InputError, "noise: input should be an instance of Noise"),
        ({"nominal": hx.robots.linuxcnc()}, UnitError, "cannot convert 'mm' to 'unstated'"),
    ],
)
def test_wrong_settings_are_one_line(write, settings, error, message):
    with pytest.raises(error) as caught:
        hx.read_measurements(write(), **{"length_unit": "mm", **settings})
    assert message in str(caught.value)
    assert len(str(caught.value).splitlines()) == 1


def test_the_length_unit_has_no_default(write):
    with pytest.raises(TypeError, match="length_unit"):
        hx.read_measurements(write())


def test_reading_loads_no_heavy_library():
    code = (
        "import sys, hexopt.readers, hexopt.cli\n"
        "print({'pandas', 'scipy', 'cvxpy', 'casadi', 'filterpy', 'matplotlib'} & set(sys.modules))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"
