"""No row is swallowed and no fault is guessed away: each is one line with its place and the remedy."""

import re

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import FileFormatError, InputError

HEADER = "set,leg,lock," + ",".join(
    [f"leg_length_{k}" for k in range(1, 7)]
    + [f"position_{axis}" for axis in "xyz"]
    + [f"orientation_{axis}" for axis in "xyzw"]
)
ROW = "1,3,direction,4.1,4.2,4.3,4.4,4.5,4.6,1.5,2.5,3.5,0,0,0,1"
FILE = "\n".join([HEADER, ROW, ROW, ROW.replace("1,3,direction", "2,,none"), ""])


def edited(old, new, count=1):
    assert old in FILE
    return FILE.replace(old, new, count)


def with_line(number, line):
    lines = FILE.split("\n")
    lines[number - 1] = line
    return "\n".join(lines)


CASES = {
    "empty": ("", "poses.csv: is empty; expected a header"),
    "blank": (" \n\n", "poses.csv: is empty"),
    "header-only": (HEADER + "\n", "poses.csv: there are no rows under the header"),
    "no-header": (FILE.split("\n", 1)[1], "the first row holds numbers (1, …), expected column names"),
    "truncated": (FILE[:-4], "line 4: 15 fields, the header has 16; the row is cut short"),
    "too-many": (with_line(3, ROW + ",7"), "line 3: 17 fields, the header has 16; is there a decimal comma"),
    "blank-lines-count": (with_line(3, "\n" + ROW + ",7"), "line 4: 17 fields"),
    "empty-row": (with_line(3, "," * 15), "line 3, column 'set': the label is missing"),
    "missing-value": (edited(",4.3,", ",,"), "line 2, column 'leg_length_3': the value is missing"),
    "text": (edited(",2.5,", ",abc,"), "line 2, column 'position_y': got 'abc', expected a finite number"),
    "nan": (edited(",2.5,", ",NaN,"), "line 2, column 'position_y': got 'NaN', expected a finite number"),
    "infinity": (edited(",2.5,", ",-inf,"), "got '-inf', expected a finite number"),
    "overflow": (edited(",2.5,", ",1e999,"), "got '1e999', expected a finite number"),
    "underscore": (edited(",2.5,", ",2_5,"), "got '2_5', expected a finite number"),
    "other-digits": (edited(",2.5,", ",٢.٥,"), "expected a finite number"),
    "long-cell": (edited(",2.5,", f",{'z' * 500},"), "zzz…', expected a finite number"),
    "two-lines-in-a-cell": (edited(",2.5,", ',"2\n5",'), r"line 2, column 'position_y': got '2\n5'"),
    "after-two-lines": (edited(ROW, ROW.replace("4.1", '"4.1\n"') + "\n" + ROW + ",9"), "line 4: 17 fields"),
    "decimal-comma": (FILE.replace(",", ";").replace("2.5", "2,5"), "got '2,5', expected a decimal point; write 2.5"),
    "decimal-comma-among-commas": (edited(",2.5,", ",2,5,"), "line 2: 17 fields"),
    "open-quote": (edited(",2.5,", ',"2.5,'), "line 2: is not CSV (unexpected end of data); check the quotes"),
    "quote-inside": (edited(",2.5,", ',"2".5,'), "line 2: is not CSV"),
    "duplicate-column": (edited("position_y", "position_x"), "the header names 'position_x' more than once"),
    "missing-column": (edited("position_y", "y"), "misses position_y. It has set, leg, lock, leg_length_1"),
    "missing-orientation": (edited("orientation_w", "w"), "misses orientation_w."),
    "missing-leg": (edited("leg_length_6", "l6"), "misses leg_length_6. It has"),
    "no-lengths": (FILE.replace("leg_length_", "l"), "misses leg_length_1, leg_length_2, leg_length_3, leg_length_4"),
    "both-lengths": (edited("set,", "leg_length,"), "has both leg_length and leg_length_1"),
    "seventh-leg": (edited("set,", "leg_length_7,"), "'leg_length_7' is not read: a hexapod has legs 1…6"),
    "other-case": (edited("lock,", "Lock,"), "the column 'Lock' is not read; rename it to 'lock'"),
    "other-separator": (FILE.replace(",", "|"), "misses leg_length_1"),
    "two-locks": (
        with_line(3, ROW.replace("direction", "leg")),
        "line 3, column 'lock': got 'leg', but the set began with 'direction' in line 2; a set has one lock",
    ),
    "two-legs": (with_line(3, ROW.replace("1,3", "1,4")), "line 3, column 'leg': got '4', but the set began with '3'"),
    "set-in-pieces": (
        FILE + ROW + "\n",
        "line 5, column 'set': the set '1', begun in line 2, had ended; the poses of a set stand together",
    ),
    "unlabelled": (with_line(3, ROW[1:]), "line 3, column 'set': the label is missing"),
    "unknown-lock": (
        edited("direction", "Type I"),
        "column 'lock': got 'Type I', expected one of none, direction",
    ),
    "no-lock": (edited("direction", ""), "line 2, column 'lock': got '', expected one of none, direction, leg, length"),
    "unknown-leg": (FILE.replace("1,3,", "1,7,"), "line 2, column 'leg': got '7', expected a leg number from 1 to 6"),
    "leg-0": (FILE.replace("1,3,", "1,0,"), "got '0', expected a leg number from 1 to 6"),
    "leg-in-words": (FILE.replace("1,3,", "1,three,"), "got 'three', expected a leg number from 1 to 6"),
    "lock-of-no-leg": (FILE.replace("1,3,", "1,,"), "line 2: the lock is 'direction', but of which leg?"),
    "leg-without-lock": (edited("2,,none", "2,5,none"), "line 4: leg 5 is named, but no lock"),
    "no-quaternion": (with_line(3, ROW[:-1] + "2"), "line 3: quaternion: its norm is 2, expected 1"),
    "zero-quaternion": (with_line(3, ROW[:-1] + "0"), "line 3: quaternion: its norm is 0, expected 1"),
}


def check(path, message, **settings):
    """One line, which names the file, says what is the matter, and is a FileFormatError."""
    with pytest.raises(FileFormatError) as caught:
        hx.read_measurements(path, **{"length_unit": "cm", **settings})
    text = str(caught.value)
    assert message in text
    assert text.startswith(str(path))
    assert len(text.splitlines()) == 1


@pytest.fixture
def path(tmp_path):
    return tmp_path / "poses.csv"


def test_the_file_without_a_fault_is_read(path):
    path.write_text(FILE)
    assert [data.n_poses for data in hx.read_measurements(path, length_unit="cm")] == [2, 1]


@pytest.mark.parametrize(("text", "message"), CASES.values(), ids=CASES)
def test_fault(path, text, message):
    path.write_text(text, encoding="utf-8", newline="")
    check(path, message)


@pytest.mark.parametrize(("text", "message"), CASES.values(), ids=CASES)
def test_lines_count_the_same_with_windows_line_ends(path, text, message):
    path.write_bytes(b"\xef\xbb\xbf" + text.replace("\n", "\r\n").encode())
    check(path, message.replace(r"\n", r"\r\n"))


def test_missing_file(path):
    check(path, "poses.csv: cannot be read (No such file or directory)")


def test_folder(tmp_path):
    check(tmp_path, "cannot be read (Is a directory)")


@pytest.mark.parametrize("encoding", ["utf-16", "latin-1"])
def test_other_encodings(path, encoding):
    path.write_bytes(FILE.replace("set", "séance").encode(encoding))
    check(path, "line 1: is not UTF-8 text; save the file as CSV in UTF-8")


def test_binary_file(path):
    path.write_bytes(bytes(range(256)) * 40)
    with pytest.raises(FileFormatError):
        hx.read_measurements(path, length_unit="cm")


MATRIX = [f"orientation_{i}{j}" for i in "123" for j in "123"]
TURN = np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])


@pytest.mark.parametrize(
    ("matrix", "message"),
    [
        (np.diag([1.0, 1.0, -1.0]), "line 3: orientation: the matrix is left-handed"),
        (1.01 * TURN, "line 3: orientation: the matrix is not orthonormal"),
        (TURN.round(2) + 0.01, "line 3: orientation: the matrix is not orthonormal"),
        (np.zeros((3, 3)), "line 3: orientation: the matrix is not orthonormal"),
    ],
)
def test_matrices_that_are_no_rotations(path, matrix, message):
    values = [",".join(map(str, turn.ravel().tolist())) for turn in (TURN, matrix)]
    start = ROW.removesuffix(",0,0,0,1")
    header = HEADER.partition(",orientation")[0] + "," + ",".join(MATRIX)
    path.write_text("\n".join([header, f"{start},{values[0]}", f"{start},{values[1]}"]))
    check(path, message, orientation="matrix")


@pytest.mark.parametrize(
    ("orientation", "unit", "value", "message"),
    [
        (
            "ZXZ",
            "rad",
            90,
            "line 2, column 'orientation_2': an angle of 90 rad is more than a turn; is the unit wrong?",
        ),
        ("xyz", "deg", -361, "an angle of -361 deg is more than a turn"),
    ],
)
def test_angles_beyond_a_turn(path, orientation, unit, value, message):
    header = HEADER.partition(",orientation")[0] + ",orientation_1,orientation_2,orientation_3"
    path.write_text(f"{header}\n{ROW.removesuffix(',0,0,0,1')},0,{value},0")
    check(path, message, orientation=orientation, angle_unit=unit)


def test_a_quaternion_is_not_read_as_a_rotation_vector(path):
    path.write_text(FILE)
    check(path, "'orientation_w' makes this a quaternion", orientation="rotation_vector", angle_unit="rad")


# --- files with one reading a pose

LEG_HEADER = re.sub(r"leg_length_1.*leg_length_6", "leg_length", HEADER)
LEG_ROW = ROW.replace("4.1,4.2,4.3,4.4,4.5,4.6", "4.1")


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([LEG_ROW, LEG_ROW.replace("4.1", "")], "line 3, column 'leg_length': the value is missing"),
        ([LEG_ROW.replace("1,3,", "1,,")], "line 2: which leg was measured? Beside 'leg_length', 'leg' has to say it"),
        ([LEG_ROW.replace("1,3,direction", "1,,none")], "line 2: which leg was measured?"),
    ],
)
def test_faults_in_files_of_single_legs(path, rows, message):
    path.write_text("\n".join([LEG_HEADER, *rows]))
    check(path, message, nominal=hx.robots.left_hand())


def test_files_of_single_legs_need_the_robot(path):
    path.write_text("\n".join([LEG_HEADER, LEG_ROW]))
    with pytest.raises(InputError, match=r"nominal: .* has the readings of single legs; give nominal="):
        hx.read_measurements(path, length_unit="cm")
