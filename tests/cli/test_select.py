"""``hexopt select``: a list for the controller, a promise that calibration keeps, and errors that say what to do."""

import re
import shlex
from pathlib import Path

import numpy as np
import pytest

import hexopt as hx
from hexopt.kinematics import leg_lengths
from hexopt.pools.clamp import Clamp

ROBOT = hx.robots.left_hand()
NOISE = "--position-noise 0.01cm --angle-noise 0.01deg --length-noise 0.01cm"
LEG = f"select left-hand --lock direction --leg 3 --poses 6 --candidates 150 {NOISE} --out poses.csv"
PAPER = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)


def written(path="poses.csv", **settings):
    return hx.read_measurements(path, length_unit="cm", nominal=ROBOT, **settings)


def errors(text):
    """The standard errors that a summary promises."""
    return np.array([float(line.split()[1]) for line in text.splitlines() if line.endswith("  cm")])


@pytest.fixture
def refused(hexopt, tmp_path):
    """Run a command line that has to fail as it should, leaving no file behind."""

    def run(command, *fragments):
        before = {path: path.read_bytes() for path in tmp_path.rglob("*")}
        answer = hexopt(*shlex.split(command))
        assert (answer.code, answer.out) == (2, "")
        assert answer.err.startswith("hexopt: error: ")
        assert answer.err.count("\n") == 1
        for fragment in fragments:
            assert fragment in answer.err
        assert {path: path.read_bytes() for path in tmp_path.rglob("*")} == before

    return run


# --- the chain: choose, measure, calibrate


def lab(truth, path, noise=None, rng=None):
    """What the sensors say when the controller has gone through a file of poses."""
    sets = []
    for data in written(path):
        length = hx.inverse_kinematics(truth, data.position, data.rotation)
        position, rotation = data.position, data.rotation
        if noise is not None:
            position, rotation, length = noise.apply(position, rotation, length, rng)
        sets.append(hx.Measurements(position, rotation, length, data.lock, data.locked_leg, length_unit="cm"))
    hx.write_measurements(sets, "measured.csv")


CHAINS = [
    (["direction"], "--poses 5", "--method one-step", 36),
    (["leg", "length"], "--poses 6", "--method three-step", 42),
    (["none"], "--poses 8 --model 36 --candidates 30", "--method free --model 36", 36),
]


@pytest.mark.parametrize(("locks", "flags", "method", "model"), CHAINS)
def test_the_file_calibrates_the_robot_that_it_was_made_for(done, locks, flags, method, model):
    files = []
    for lock in locks:
        done(f"select left-hand --lock {lock} {flags} --candidates 150 {NOISE} --out {lock}.csv")
        files.append(f"{lock}.csv")
    nominal = ROBOT.perturbed(0.2, offsets=0.1 if model > 36 else 0.0, rng=0)
    nominal.to_toml("nominal.toml")
    out = done(f"calibrate nominal.toml {' '.join(files)} {method} --length-unit cm --out found.toml")
    assert "6 of 6 legs calibrated" in out
    found = hx.Hexapod.from_toml("found.toml")
    for name in ("base_points", "platform_points", "offsets", "gains"):
        np.testing.assert_allclose(getattr(found, name), getattr(ROBOT, name), atol=1e-8)


def test_noisy_measurements_of_the_chosen_poses_are_as_good_as_promised(done):
    """Uniform noise, the best estimator: errors of 40 calibrations beside the predicted ones."""
    promised = errors(done(LEG))
    rng = np.random.default_rng(0)
    data = written()[0]
    shape = (40, *data.position.shape[:-1])
    exact = hx.Measurements(
        np.broadcast_to(data.position, (*shape, 3)),
        np.broadcast_to(data.rotation, (*shape, 3, 3)),
        np.broadcast_to(data.length, (*shape, 6)),
        "direction",
        3,
        PAPER,
        ROBOT,
    )
    noisy = exact.moved_to(*PAPER.apply(exact.position, exact.rotation, exact.length, rng))
    found = hx.estimate(hx.loops.FixedDirection(noisy.leg(3)), hx.MaximumLikelihood())
    truth = np.r_[ROBOT.leg(3).platform_point, ROBOT.leg(3).base_point]
    ratio = (found.values[:, :6] - truth) / promised
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1, abs=0.15)


def test_an_off_nominal_still_chooses_poses_that_find_the_truth(done):
    ROBOT.perturbed(0.3, rng=1).to_toml("nominal.toml")
    done(f"select nominal.toml --lock none --poses 10 --candidates 150 {NOISE} --out poses.csv")
    lab(ROBOT, "poses.csv")
    done("calibrate nominal.toml measured.csv --method free --length-unit cm --out found.toml")
    np.testing.assert_allclose(hx.Hexapod.from_toml("found.toml").base_points, ROBOT.base_points, atol=1e-8)


# --- what is written


@pytest.mark.parametrize("lock", ["direction", "leg", "length"])
def test_every_leg_has_its_set_on_its_clamp_within_the_limits(done, lock):
    out = done(f"select left-hand --lock {lock} --poses 5 --candidates 100 {NOISE} --out poses.csv")
    sets = written()
    assert [data.locked_leg for data in sets] == [1, 2, 3, 4, 5, 6]
    assert {str(data.lock) for data in sets} == {lock}
    assert "wrote poses.csv: 6 sets of 5 poses, lengths in cm, seed 0" in out
    for data in sets:
        clamp = Clamp.at_home(ROBOT, data.locked_leg, data.lock)
        assert clamp.distance(data.position, data.rotation).max() < 1e-9
        assert hx.reachable(ROBOT, data.position, data.rotation).all()
        exact = hx.inverse_kinematics(ROBOT, data.position, data.rotation)
        np.testing.assert_allclose(data.length, exact, atol=1e-12)


def test_one_leg_is_the_same_alone_and_among_all(done):
    done(f"select left-hand --lock leg --poses 5 --candidates 100 {NOISE} --out all.csv")
    done(f"select left-hand --lock leg --leg 4 --poses 5 --candidates 100 {NOISE} --out one.csv")
    np.testing.assert_array_equal(written("one.csv")[0].position, written("all.csv")[3].position)


def test_poses_stand_in_the_order_that_the_help_tells(done):
    done(LEG.replace("--poses 6", "--poses 15"))
    data = written()[0]
    lengths = leg_lengths(ROBOT, data.position, data.rotation)
    here = ROBOT.home_lengths
    for i in range(15):
        distance = np.linalg.norm(lengths[i:] - here, axis=1)
        assert distance[0] == distance.min()
        here = lengths[i]


def test_the_same_seed_gives_the_same_files(done):
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        done(f"{LEG} --seed {seed}".replace("poses.csv", f"{name}.csv"))
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()
    assert Path("a.csv").read_bytes() != Path("c.csv").read_bytes()


def test_a_report_says_what_was_asked(done):
    out = done(f"{LEG} --nominal-error 2mm --report report.html --seed 7")
    assert out.endswith("wrote report.html\n")
    page = Path("report.html").read_text()
    assert "Left Hand: 6 poses for leg 3 under the lock" in page
    assert "<dt>Seed</dt><dd>7</dd>" in page
    assert "joint coordinates off by up to 2mm; good for 8 such robots on average" in page
    done(f"{LEG} --nominal-error 2mm --worst --report report.html --force")
    assert "good for the worst of 8 such robots" in Path("report.html").read_text()


def test_other_orientations(done):
    done(f"{LEG} --orientation ZXZ --angle-unit deg")
    done(LEG.replace("poses.csv", "other.csv"))
    angles = written(orientation="ZXZ", angle_unit="deg")[0]
    np.testing.assert_allclose(angles.rotation, written("other.csv")[0].rotation, atol=1e-12)


def test_flags_narrow_the_limits(done):
    done(f"{LEG} --leg-length 18cm,24cm --tilt 15deg --base-tilt 40deg --leg-tilt 30deg")
    data = written()[0]
    lengths = leg_lengths(ROBOT, data.position, data.rotation)
    assert lengths.min() >= 18
    assert lengths.max() <= 24
    assert np.rad2deg(np.arccos(data.rotation[:, 2, 2])).max() <= 15


@pytest.mark.parametrize(
    ("lock", "given", "value"),
    [("direction", "-0.2,-0.2,1", [-0.2, -0.2, 1]), ("leg", "8cm,0mm,19cm", [8, 0, 19]), ("length", "0.2m", 20.0)],
)
def test_a_clamp_is_given(done, lock, given, value):
    out = done(LEG.replace("direction", lock) + f" --given={given}")
    data = written()[0]
    clamp = Clamp.given(ROBOT, 3, data.lock, value)
    assert clamp.distance(data.position, data.rotation).max() < 1e-9
    assert f"clamp: {clamp.describe()}" in out


# --- what is chosen


def test_it_is_what_python_chooses(done):
    out = done(LEG)
    pool = hx.candidates(ROBOT, 3, "direction", 150, PAPER, rng=np.random.default_rng([0, 3]))
    design = hx.select_poses(hx.loops.FixedDirection(pool.leg(3)), 6, rng=0)
    np.testing.assert_array_equal(errors(out), [float(f"{error:.3g}") for error in design.standard_errors])
    order = hx.measuring_order(ROBOT, design.poses)
    np.testing.assert_array_equal(written()[0].position, design.poses.position[order])
    share = float(re.search(r"at least ([\d.]+) % of the best choice", out)[1])
    assert 0 <= 100 * design.efficiency - share < 0.1


@pytest.mark.parametrize("criterion", ["A", "D", "E", "G", "kappa", "O1", "O2", "O3", "O4", "O5"])
def test_every_criterion(done, criterion):
    out = done(f"{LEG} --criterion {criterion}")
    assert f"criterion {criterion}\n" in out
    assert written()[0].n_poses == 6


def test_more_poses_promise_smaller_errors(done):
    few, many = (errors(done(LEG.replace("--poses 6", f"--poses {n}") + " --force")) for n in (5, 20))
    assert (many < few).all()


def test_poses_measured_before_count(done):
    alone = errors(done(LEG))
    out = done(f"{LEG.replace('poses.csv', 'next.csv')} --measured poses.csv --length-unit cm --seed 1")
    assert "with 6 poses measured before" in out
    assert (errors(out) < alone).all()
    first, second = written()[0], written("next.csv")[0]
    clamp = Clamp.of_poses(ROBOT, 3, first.lock, first.position, first.rotation)
    assert clamp.distance(second.position, second.rotation).max() < 1e-9


def test_unlocked_poses_measured_before_count(done):
    command = f"select left-hand --lock none --candidates 60 {NOISE}"
    done(f"{command} --poses 8 --out poses.csv")
    command += " --leg 5"
    alone = errors(done(f"{command} --poses 8 --out five.csv"))
    out = done(f"{command} --poses 2 --measured poses.csv --length-unit cm --seed 1 --out next.csv")
    assert (errors(out) < alone).all()


def test_refined_poses_are_better_and_stay_within_the_limits(done):
    before, out = errors(done(LEG)), done(f"{LEG} --refine --force")
    assert "poses moved inside the limits, which makes A better by" in out
    assert np.square(errors(out)).sum() < np.square(before).sum()
    data = written()[0]
    assert hx.reachable(ROBOT, data.position, data.rotation).all()


def test_a_proof(done):
    assert "the best choice, proven" in done(f"{LEG} --prove 30")


def test_repeated_poses(done):
    done(f"{LEG} --candidates 5 --repeat --poses 9")
    assert written()[0].n_poses == 9


@pytest.mark.parametrize("worst", ["", "--worst"])
def test_a_nominal_that_may_be_wrong(done, worst):
    plain = done(LEG)
    out = done(f"{LEG} --nominal-error 1cm {worst} --force")
    assert (errors(out) != errors(plain)).any()


# --- the user's own list


def pose_list():
    """Poses alone, without readings, as a planner may give them."""
    pool = hx.candidates(ROBOT, 3, "direction", 20, rng=0)
    path = hx.write_measurements(pool, "mine.csv")
    lines = [",".join(line.split(",")[9:]) for line in path.read_text().splitlines()]
    path.write_text("\n".join(lines) + "\n")
    return pool


LIST = f"{LEG.replace('--candidates 150', '--candidates mine.csv')} --length-unit cm"


def test_a_list_of_poses_without_readings(done):
    pool = pose_list()
    out = done(LIST)
    assert "6 of 20 candidates" in out
    chosen = written()[0].position
    assert all((abs(pool.position - one).max(axis=1) < 1e-12).any() for one in chosen)


def lines_said(out):
    """The lines of the list that the output names, as poses of the list counted from 0."""
    return [int(line) - 2 for line in re.search(r"come from lines ([\d, ]+) of mine.csv", out)[1].split(",")]


def test_poses_are_found_in_the_list_by_their_lines(done):
    pool = pose_list()
    chosen = lines_said(done(f"{LIST} --report report.html"))
    np.testing.assert_allclose(written()[0].position, pool.position[chosen], atol=1e-12)
    header, *rows = Path("mine.csv").read_text().splitlines()
    Path("mine.csv").write_text("\n".join([header, "0,0,40,0,0,0,1", "0,0,41,0,0,0,1", *rows]))
    assert lines_said(done(f"{LIST} --drop --force")) == [i + 2 for i in chosen]
    assert f"come from lines {chosen[0] + 2}, " in Path("report.html").read_text()


def test_a_list_with_sets_gives_each_leg_its_own(done):
    done(f"select left-hand --lock direction --poses 9 --candidates 100 {NOISE} --out pool.csv")
    done(f"select left-hand --lock direction --poses 5 --candidates pool.csv --length-unit cm {NOISE} --out poses.csv")
    for one, pool in zip(written(), written("pool.csv"), strict=True):
        assert all((abs(pool.position - position).max(axis=1) < 1e-12).any() for position in one.position)


def spoilt(*rows):
    pose_list()
    with Path("mine.csv").open("a") as file:
        file.writelines(f"{row}\n" for row in rows)


def test_poses_that_cannot_be_are_named_not_dropped(refused):
    spoilt("0,0,40,0,0,0,1")
    refused(LIST, "mine.csv: 1 of 21 poses cannot be candidates (leg_length: 1, off the clamp: 1)", "--drop leaves")


def test_poses_that_cannot_be_are_left_out_on_request(done):
    spoilt("0,0,40,0,0,0,1")
    out = done(f"{LIST} --drop")
    assert "left out: 1 of 21 poses cannot be candidates (leg_length: 1, off the clamp: 1)" in out
    assert "6 of 20 candidates" in out


def test_duplicates_in_a_list(refused):
    pose_list()
    lines = Path("mine.csv").read_text().splitlines()
    Path("mine.csv").write_text("\n".join([*lines, lines[3]]))
    refused(
        LIST, "1 of 21 poses cannot be candidates (duplicate: 1)", "the first is in line 22; --drop leaves them out"
    )


@pytest.mark.parametrize(
    ("row", "fragment"),
    [
        ("nan,0,19,0,0,0,1", "mine.csv, line 22, column 'position_x': got 'nan', expected a finite number"),
        ("0,0,19,0,0,0,2", "mine.csv, line 22: "),
        ("0,0,19", "mine.csv, line 22: 3 fields, the header has 7"),
    ],
)
def test_a_broken_list(refused, row, fragment):
    spoilt(row)
    refused(LIST, fragment)


def test_a_list_of_another_lock(refused, done):
    done("simulate --robot left-hand --lock leg --leg 3 --poses 9 --out mine.csv")
    refused(LIST, "--candidates: mine.csv has no set with the lock direction of leg 3; it has the lock leg of leg 3")


def test_a_list_in_the_wrong_unit(refused):
    pose_list()
    refused(f"{LIST} --drop --length-unit mm", "mine.csv: 20 of 20 poses cannot be candidates", "nothing is left")


# --- errors


@pytest.mark.parametrize(
    ("command", "fragment"),
    [
        ("select left-hand --lock direction --out new.csv", "Missing option '--poses'"),
        ("select left-hand --poses 7 --out new.csv", "Missing option '--lock'"),
        ("select left-hand --lock direction --poses 7 --out new.csv", "depends on the noise of the instruments: give"),
        (f"{LEG} --angle-noise 0deg", "e.g. --position-noise 0.01cm --angle-noise 0.01deg --length-noise 0.01cm"),
        (f"{LEG} --position-noise 0.01", "--position-noise: '0.01' has no unit"),
        (f"{LEG} --leg 7", "--leg: expected a number from 1 to 6, or all; got '7'"),
        (f"{LEG} --criterion B", "'--criterion': 'B' is not one of 'A', 'D', 'E', 'G', 'kappa', 'O1'"),
        (f"{LEG} --poses 2", "2 bring at most 6 equations for 8 unknowns"),
        (
            f"{LEG} --poses 200",
            "--poses: 200 poses asked for, and there are 150 candidates; give more candidates, or --r",
        ),
        (f"{LEG} --tilt 40", "--tilt: '40' has no unit; write it behind the number, e.g. 20deg"),
        (f"{LEG} --tilt 0deg", "--tilt: expected an angle in (0deg, 180deg], got '0deg'"),
        (f"{LEG} --base-tilt 50deg", "--base-tilt: '50deg' goes beyond the limits of Left Hand"),
        (f"{LEG} --leg-length 17cm", "--leg-length: expected 2 values with commas between, e.g. 17cm,20cm"),
        (f"{LEG} --leg-length 20cm,18cm", "--leg-length: expected 0 < shortest < longest"),
        (
            f"{LEG} --leg-length 10cm,20cm",
            "--leg-length: '10cm,20cm' goes beyond the limits of Left Hand (leg length 17.25",
        ),
        (f"{LEG} --given 1,2", "--given: expected 3 values with commas between, e.g. 0.1,-0.2,1; got '1,2'"),
        (f"{LEG} --given 1cm,2cm,3cm", "--given: expected a direction x,y,z as plain numbers, e.g. 0.1,-0.2,1"),
        (f"{LEG} --lock leg --given 1,2,3", "--given: '1' has no unit"),
        (f"{LEG} --lock none --given 1,2,3", "--given: '1,2,3' is named, but --lock none holds nothing"),
        (f"{LEG} --leg all --given 0,0,1", "--given: a clamp is that of one leg; name it by --leg"),
        (f"{LEG} --given 0,0,1 --measured no.csv", "--given: the clamp is that of the poses --measured; leave one of"),
        (
            f"{LEG} --position-noise 1e300cm",
            "--position-noise: expected an error smaller than Left Hand itself, got '1e3",
        ),
        (f"{LEG} --length-noise 50cm", "--length-noise: expected an error smaller than Left Hand itself, got '50cm'"),
        (f"{LEG} --model 42", "--model: --lock direction decides what it sees; leave --model out"),
        (f"{LEG} --candidates 0", "--candidates: expected at least 1"),
        (f"{LEG} --candidates many", "--candidates: expected a number such as 1000, or a CSV file; got 'many'"),
        (f"{LEG} --candidates no.csv", "--length-unit: in which unit are the lengths in no.csv?"),
        (f"{LEG} --candidates no.csv --length-unit cm", "no.csv: cannot be read (No such file"),
        (f"{LEG} --measured no.csv --length-unit cm", "no.csv: cannot be read (No such file"),
        (f"{LEG} --length-unit cm", "--length-unit: no file is read"),
        (f"{LEG} --column position_x=X", "--column: no file is read"),
        (f"{LEG} --drop", "--drop: random candidates are all within the limits; leave it out"),
        (f"{LEG} --worst", "--worst: of which robots? Give --nominal-error"),
        (f"{LEG} --nominal-error 1", "--nominal-error: '1' has no unit"),
        (f"{LEG} --criterion kappa --prove 1", "--prove: "),
        (f"{LEG} --prove 0", "--prove: expected seconds > 0"),
        (f"{LEG} --out poses.txt", "--out: expected a name that ends in .csv, got 'poses.txt'"),
        (f"{LEG} --report poses.txt", "--report: expected a name that ends in .html"),
        (f"{LEG} --report no/report.html", "no/report.html: the folder no does not exist"),
        (f"{LEG} --angle-unit deg", "--angle-unit: 'quaternion' has no angles"),
        (LEG.replace("left-hand", "jugglebot"), "--length-noise: the legs of Jugglebot read in 'rev', got 'cm'"),
        (LEG.replace("left-hand", "nobody"), "'nobody' is neither a TOML file nor built in"),
    ],
)
def test_flags(refused, command, fragment):
    refused(command, fragment)


@pytest.mark.parametrize(
    ("flags", "fragment"),
    [("--tilt 0.001deg", "tilt refuses 100.0%"), ("--given 1,0,0", "base_tilt refuses 100.0%")],
)
def test_no_feasible_candidate(refused, monkeypatch, flags, fragment):
    monkeypatch.setattr("hexopt.poses.FIRST_DRAWS", 20_000)
    refused(f"{LEG} {flags}", fragment, "widen the robot's limits, or give another direction (--given)")


@pytest.mark.parametrize("suffix", ["csv", "html"])
def test_files_are_not_replaced_without_force(refused, suffix):
    Path(f"poses.{suffix}").write_text("mine")
    refused(f"{LEG} --report poses.html", f"poses.{suffix}: exists already; give another name, or --force")


def test_too_few_unlocked_poses(refused):
    refused(LEG.replace("--lock direction --leg 3", "--lock none"), "36 equations for 42 unknowns", "takes 7 at least")


def test_measured_on_another_clamp(refused):
    other = hx.candidates(ROBOT, 3, "direction", 5, PAPER, given=[-0.5, -0.2, 1.0], rng=0)
    hx.write_measurements(other, "run.csv")
    pose_list()
    refused(f"{LIST} --measured run.csv", "mine.csv: 20 of 20 poses cannot be candidates (off the clamp: 20)")


def unlocked(**limits):
    """Poses that no clamp held, with a lock written beside them."""
    pool = hx.candidates(ROBOT, None, "none", 8, PAPER, rng=0)
    return hx.Measurements(pool.position, pool.rotation, pool.length, **limits, length_unit="cm")


def test_measured_on_no_clamp(refused):
    hx.write_measurements(unlocked(lock="direction", locked_leg=3), "run.csv")
    words = "--measured: run.csv: expected the lock direction of leg 3, but these poses share no clamp: directions "
    refused(f"{LEG} --measured run.csv --length-unit cm", words)


@pytest.mark.parametrize("unit", ["mm", "m", "in"])
@pytest.mark.parametrize("lock", ["direction", "none"])
def test_measured_in_another_unit(refused, lock, unit):
    hx.write_measurements(hx.simulate(ROBOT, lock, 6, leg=None if lock == "none" else 3, rng=0), "run.csv")
    words = "--measured: run.csv: 6 of 6 poses are far beyond the limits of Left Hand (leg_length: 6", "--length-unit,"
    refused(f"{LEG} --lock {lock} --measured run.csv --length-unit {unit}", *words)


def test_measured_within_wider_limits_than_now(done):
    """The limits that count are the robot's own, and those that a nominal sees a little off."""
    hx.write_measurements(hx.simulate(ROBOT, "none", 9, rng=0), "run.csv")
    ROBOT.perturbed(0.5, rng=0).to_toml("nominal.toml")
    command = LEG.replace("left-hand", "nominal.toml").replace("direction", "none")
    out = done(f"{command} --leg-length 19cm,22cm --tilt 5deg --measured run.csv --length-unit cm")
    assert "with 9 poses measured before" in out


@pytest.mark.parametrize("which", [f"{LEG} --leg 4", f"{LEG} --lock leg", f"{LEG} --leg all"])
def test_measured_under_another_lock(refused, which):
    hx.write_measurements(hx.candidates(ROBOT, 3, "direction", 5, PAPER, rng=0), "run.csv")
    refused(f"{which} --measured run.csv --length-unit cm", "it has the lock direction of leg 3")


def test_measured_on_two_clamps(refused):
    hx.write_measurements([hx.simulate(ROBOT, "direction", 5, leg=3, rng=seed) for seed in (0, 1)], "run.csv")
    refused(f"{LEG} --measured run.csv --length-unit cm", "run.csv has 2 sets with the lock direction of leg 3")


def test_an_output_that_is_an_input(refused):
    pose_list()
    refused(f"{LIST} --force".replace("poses.csv", "mine.csv"), "mine.csv: is already an input or another output")


# --- robots that say little


def unlimited(name="free.toml"):
    free = hx.Hexapod("free", ROBOT.base_points, ROBOT.platform_points, home_position=[0, 0, 19], length_unit="cm")
    free.to_toml(name)


def test_a_robot_without_limits(done, refused):
    unlimited()
    command = LEG.replace("left-hand", "free.toml")
    refused(f"{command} --refine", "no limits on leg lengths and angles", "give it [limits] in its TOML file")
    assert "\n  the robot has no limits: whether it reaches these poses is not known\n" in done(command)


def test_what_is_not_seen_in_practice_is_told(done):
    """All poses are turned about nearly one axis."""
    angles = np.random.default_rng(0).uniform(-1, 1, (12, 3)) * [2e-4, 2e-4, 0.3]
    turns = hx.rotations.euler_to_matrix(angles, "xyz")
    point = ROBOT.base_points[2] + ROBOT.home_vectors[2]
    pool = hx.candidates_at(ROBOT, point - turns @ ROBOT.platform_points[2], turns, 3, "leg")
    hx.write_measurements(pool, "mine.csv")
    out = done(f"{LIST} --lock leg --report report.html")
    (line,) = [line for line in out.splitlines() if "not seen in practice" in line]
    assert "platform_point.z" in line
    assert ", not seen in practice" in Path("report.html").read_text()
