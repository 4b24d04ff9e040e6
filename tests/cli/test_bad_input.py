"""Bad input: one line on stderr that says what to do, exit code 2, and no new file."""

from pathlib import Path

import numpy as np
import pytest

import hexopt as hx

SIMULATE = "simulate --robot left-hand --lock direction --poses 5 --out new.csv"
CALIBRATE = "calibrate left-hand run.csv --method one-step --length-unit cm --out new.toml --report new.txt"
ROBOT = hx.robots.left_hand()


def direction_set(n_poses=6, leg=3):
    return hx.simulate(ROBOT, "direction", n_poses, leg=leg, rng=0)


@pytest.fixture
def refused(hexopt, tmp_path):
    """Run a command line that has to fail as it should."""

    def run(command, *fragments):
        before = sorted(tmp_path.rglob("*"))
        answer = hexopt(command) if isinstance(command, str) else hexopt(*command)
        assert answer.code == 2
        assert answer.out == ""
        assert answer.err.startswith("hexopt: error: ")
        assert answer.err.endswith("\n")
        assert answer.err.count("\n") == 1
        for fragment in fragments:
            assert fragment in answer.err
        assert sorted(tmp_path.rglob("*")) == before

    return run


@pytest.mark.parametrize(
    ("command", "fragment"),
    [
        ("frobnicate", "No such command 'frobnicate'; see hexopt --help"),
        ("--frobnicate", "No such option: --frobnicate; see hexopt --help"),
        ("robots nobody", "'nobody' is neither a TOML file nor built in; built in are left-hand, rubin"),
        ("robots --toml new.toml", "--toml: which robot?"),
        ("robots nobody.toml", "nobody.toml: cannot be read"),
        ("robots left-hand --toml no/new.toml", "the folder no does not exist; make it first"),
        ("robots left-hand --toml .", "is a folder; give the name of a file"),
        ("simulate", "Missing option '--robot'; see hexopt simulate --help"),
        (
            "simulate --robot left-hand --out new.csv",
            "Missing option '--lock'. Choose from: none, direction, leg, length",
        ),
        ("simulate --robot left-hand --lock none", "Missing option '--out'"),
        (f"{SIMULATE} --lock sideways", "'--lock': 'sideways' is not one of 'none', 'direction', 'leg', 'length'"),
        (f"{SIMULATE} --leg 7", "--leg: expected a number from 1 to 6, or all; got '7'"),
        (f"{SIMULATE} --leg three", "--leg: expected a number from 1 to 6, or all; got 'three'"),
        (f"{SIMULATE} --lock none --leg 3", "--leg: '3' is named, but --lock none locks no leg"),
        (f"{SIMULATE} --poses 0", "'--poses': Input should be greater than or equal to 1"),
        (f"{SIMULATE} --poses seven", "'--poses': Input should be a valid integer"),
        (f"{SIMULATE} --seed -1", "'--seed': Input should be greater than or equal to 0"),
        (f"{SIMULATE} --noise-kind odd", "'odd' is not one of 'uniform', 'normal'"),
        (f"{SIMULATE} --position-noise 0.01", "--position-noise: '0.01' has no unit; write it behind the number"),
        (f"{SIMULATE} --position-noise cm", "--position-noise: expected a number with its unit, e.g. 0.5cm"),
        (f"{SIMULATE} --position-noise nancm", "expected a number with its unit"),
        (f"{SIMULATE} --position-noise=-1cm", "--position-noise: expected an amount >= 0, got '-1cm'"),
        (f"{SIMULATE} --position-noise 1e999cm", "--position-noise: expected an amount >= 0"),
        (
            f"{SIMULATE} --position-noise 1parsec",
            "--position-noise: unknown length unit 'parsec'; expected one of m, dm",
        ),
        (f"{SIMULATE} --position-noise 1deg", "--position-noise: unknown length unit 'deg'"),
        (f"{SIMULATE} --angle-noise 1cm", "--angle-noise: unknown unit of angle 'cm'; expected deg or rad"),
        (f"{SIMULATE} --angle-noise 90deg", "--angle-noise: expected an error of at most 1 rad"),
        (f"{SIMULATE} --length-noise 1rev", "--length-noise: unknown length unit 'rev'"),
        (f"{SIMULATE} --robot jugglebot --length-noise 1mm", "the legs of Jugglebot read in 'rev', got 'mm'"),
        (f"{SIMULATE} --robot linuxcnc --position-noise 1mm", "--position-noise: cannot convert 'mm' to 'unstated'"),
        (f"{SIMULATE} --noise-angles XXX", "--noise-angles: Euler sequence: expected three axes"),
        (f"{SIMULATE} --nominal-error much", "--nominal-error: expected a number with its unit"),
        (f"{SIMULATE} --offset-error 1", "--offset-error: '1' has no unit"),
        (f"{SIMULATE} --orientation XXX", "--orientation: expected quaternion, matrix, rotation_vector, or an Euler"),
        (f"{SIMULATE} --orientation ZXZ", "--angle-unit: 'ZXZ' has angles; say whether they are 'deg' or 'rad'"),
        (f"{SIMULATE} --out new.txt", "--out: expected a name that ends in .csv, got 'new.txt'"),
        (f"{SIMULATE} --out no/new.csv", "no/new.csv: the folder no does not exist"),
        (f"{SIMULATE} --robot five.toml", "five.toml: cannot be read (No such file or directory)"),
    ],
)
def test_flags(refused, command, fragment):
    refused(command, fragment)


@pytest.mark.parametrize(
    ("command", "fragment"),
    [
        ("calibrate left-hand", "Missing argument 'DATA'"),
        (
            "calibrate left-hand run.csv --length-unit cm",
            "Missing option '--method'. Choose from: one-step, three-step",
        ),
        ("calibrate left-hand run.csv --method one-step", "Missing option '--length-unit'"),
        (
            f"{CALIBRATE} --method free",
            "--method free takes sets with the lock none, the data has direction; use --meth",
        ),
        (f"{CALIBRATE} --method three-step", "lock leg and length, the data has direction; use --method one-step"),
        (
            f"{CALIBRATE} --model 42",
            "--model: --method one-step has the 36 parameters of its model, got 42; leave it out",
        ),
        (f"{CALIBRATE} --model 40", "'40' is not one of '36', '42', '48'"),
        (f"{CALIBRATE} --form centred", "--form: --method one-step has consecutive and direct, got centred"),
        (f"{CALIBRATE} --method free --form direct", "--form: --method free has no linear equations; leave it out"),
        (f"{CALIBRATE} --weighted", "--weighted: by which noise? Give --position-noise"),
        (f"{CALIBRATE} --length-unit parsec", "--length-unit: unknown length unit 'parsec'; expected one of m, dm"),
        (f"{CALIBRATE} --length-unit unstated", "cannot convert 'unstated' to 'cm'"),
        (f"{CALIBRATE} --angle-unit deg", "--angle-unit: 'quaternion' has no angles; leave the unit out"),
        (f"{CALIBRATE} --angle-unit grad", "'grad' is not one of 'deg', 'rad'"),
        (
            f"{CALIBRATE} --orientation zyx --angle-unit deg",
            "run.csv: misses orientation_1, orientation_2, orientation_3",
        ),
        (f"{CALIBRATE} --column position_x", "--column: expected NAME=IN_FILE, each name once"),
        (f"{CALIBRATE} --column position_x=X", "run.csv: has no column 'X', from which position_x is to be read"),
        (f"{CALIBRATE} --column X=position_x", "--column: 'X' is not a column of hexopt's; expected set, leg, lock"),
        (f"{CALIBRATE} --out run.csv --force", "run.csv: is already an input or another output"),
        (f"{CALIBRATE} --out new.txt", "new.txt: is already an input or another output"),
        (f"{CALIBRATE} --out old.toml", "old.toml: exists already; give another name, or --force to replace it"),
        (f"{CALIBRATE} --report old.toml/x", "the folder old.toml does not exist"),
        ("calibrate left-hand run.csv run.csv --method one-step --length-unit cm", "leg 3 has two sets with the lock"),
        ("calibrate left-hand none.csv --method one-step --length-unit cm", "none.csv: cannot be read (No such file"),
        ("calibrate run.csv run.csv --method one-step --length-unit cm", "run.csv: is not a TOML file"),
    ],
)
def test_flags_of_calibrate(refused, hexopt, command, fragment):
    hx.write_measurements(direction_set(), "run.csv")
    Path("old.toml").write_text("")
    refused(command, fragment)


# --- measurements that cannot be used


def leave(poses):
    return lambda: direction_set().poses(poses)


def equal_lengths():
    data = hx.simulate(ROBOT, "leg", 6, leg=3, rng=0)
    return hx.Measurements(data.position, data.rotation, data.length, "direction", 3)


@pytest.mark.parametrize(
    ("make", "fragments"),
    [
        (leave([0, 1]), ("leg 3: too few poses", "FixedDirection needs at least 3 poses")),
        (leave([0, 0, 0, 0, 0]), ("leg 3", "do not determine", "platform_point.x", "Add poses that differ")),
        (equal_lengths, ("leg 3", "do not determine", "base_point.x")),
    ],
    ids=["too-few-poses", "identical-poses", "equal-lengths"],
)
def test_measurements_that_do_not_determine_the_leg(refused, make, fragments):
    hx.write_measurements(make(), "run.csv")
    refused(CALIBRATE, *fragments)


def test_too_few_unlocked_poses(refused):
    hx.write_measurements(hx.simulate(ROBOT, n_poses=6, rng=0), "run.csv")
    refused(f"{CALIBRATE} --method free", "leg 1: too few poses: 6 equations for 7 unknowns", "at least 7 poses")


def test_a_leg_without_its_second_set(refused):
    hx.write_measurements(hx.simulate(ROBOT, "leg", 6, leg=2, rng=0), "run.csv")
    refused(f"{CALIBRATE} --method three-step", "leg 2", "also needs a set with the lock length")


def text_of_run():
    return hx.write_measurements(direction_set(), "run.csv").read_text()


@pytest.mark.parametrize(
    ("spoil", "fragment"),
    [
        (lambda text: "", "run.csv: is empty"),
        (lambda text: text[:-40], "run.csv, line 7: "),
        (
            lambda text: text.replace("1,3,", "1,9,"),
            "run.csv, line 2, column 'leg': got '9', expected a leg number from",
        ),
        (lambda text: text.replace("direction", "Type II"), "column 'lock': got 'Type II', expected one of none"),
        (lambda text: text.replace("0.", "nan", 1), "expected a finite number"),
        (lambda text: text.replace("0.", "x.", 1), "expected a finite number; mend the value, or remove the row"),
        (lambda text: text.replace(",", ";").replace(".", ","), "expected a decimal point; write"),
        (lambda text: text.replace("leg_length_6", "leg_length_5"), "names 'leg_length_5' more than once"),
    ],
)
def test_spoilt_measurements(refused, spoil, fragment):
    Path("run.csv").write_text(spoil(text_of_run()))
    refused(CALIBRATE, fragment)


@pytest.mark.parametrize(
    ("matrix", "fragment"),
    [(np.diag([1, 1, -1]), "the matrix is left-handed"), (1.1 * np.eye(3), "the matrix is not orthonormal")],
    ids=["left-handed", "scaled"],
)
def test_matrices_that_are_no_rotations(refused, matrix, fragment):
    lines = hx.write_measurements(direction_set(), "run.csv", orientation="matrix").read_text().splitlines()
    lines[4] = ",".join([*lines[4].split(",")[:-9], *map(str, np.ravel(matrix))])
    Path("run.csv").write_text("\n".join(lines))
    refused(f"{CALIBRATE} --orientation matrix", "run.csv, line 5", fragment)


# --- robots that cannot be used


@pytest.mark.parametrize(
    ("old", "new", "fragment"),
    [
        ("length_unit", "unit", "misses length_unit"),
        ('"cm"', '"parsec"', "unknown length unit 'parsec'"),
        ("[", "", "is not a TOML file"),
        ("9.1", '"nine"', "base_points: expected numbers"),
        ("9.7", "nan", "NaN or infinite"),
        ("name = ", "nome = 1\nname = ", "unknown key(s) nome"),
    ],
)
def test_spoilt_robots(refused, old, new, fragment):
    hx.write_measurements(direction_set(), "run.csv")
    text = ROBOT.to_toml("my.toml").read_text()
    assert old in text
    Path("my.toml").write_text(text.replace(old, new, 1))
    refused(CALIBRATE.replace("left-hand", "my.toml"), "my.toml: ", fragment)
    refused(SIMULATE.replace("left-hand", "my.toml"), "my.toml: ", fragment)


def test_a_robot_with_five_legs(refused):
    hx.write_measurements(direction_set(), "run.csv")
    points = ROBOT.base_points[:5].tolist()
    Path("my.toml").write_text(
        f'name = "five"\nlength_unit = "cm"\nbase_points = {points}\nplatform_points = {points}\n'
    )
    for command in (CALIBRATE, SIMULATE):
        refused(command.replace("left-hand", "my.toml"), "my.toml: base_points: a hexapod has 6 legs, got 5")


def test_paths_with_odd_characters_stay_on_one_line(refused):
    refused(["robots", "no\nbody.toml"], "cannot be read")


def test_an_unwritable_folder(refused, tmp_path, monkeypatch):
    monkeypatch.setattr("os.access", lambda path, mode: False)
    refused(SIMULATE, "new.csv: the folder", "cannot be written to")
