"""Whole chains: simulated files become calibrated files, which agree with the truth."""

from pathlib import Path

import numpy as np
import pytest

import hexopt as hx

NOISE = "--position-noise 0.001cm --angle-noise 0.001deg --length-noise 0.001cm"


def parameters(path, names):
    robot = hx.Hexapod.from_toml(path)
    return np.hstack([np.hstack([leg.block(name) for name in names]) for leg in robot.legs])


def names_of(model):
    return ("platform_point", "base_point", "offset", "gain")[: {36: 2, 42: 3, 48: 4}[model]]


CHAINS = [
    ("--lock direction --poses 7", "--method one-step", 36),
    ("--lock direction --poses 7", "--method one-step --form direct", 36),
    ("--lock leg --lock length --poses 8 --offset-error 0.3cm", "--method three-step", 42),
    ("--lock leg --lock length --poses 8 --offset-error 0.3cm", "--method three-step --form centred", 42),
    ("--lock none --poses 20", "--method free --model 36", 36),
    ("--lock none --poses 20 --offset-error 0.3cm", "--method free", 42),
    ("--lock none --poses 20 --offset-error 0.3cm", "--method free --model 48", 48),
]

#: By maximum likelihood, which needs a noise.
JOINT = [
    ("--lock direction --offset-error 0.3cm", "--method joint", 42),
    ("--lock leg --lock length --offset-error 0.3cm", "--method joint", 42),
    ("--lock direction --lock none", "--method joint --model 48", 48),
]


@pytest.mark.parametrize(("simulated", "method", "model"), CHAINS)
@pytest.mark.parametrize("robot", ["left-hand", "jugglebot"])
def test_without_noise_the_truth_is_found(done, robot, simulated, method, model):
    done(f"simulate --robot {robot} {simulated} --nominal-error 0.4cm --seed 3 --out run.csv")
    unit = hx.Hexapod.from_toml("run.truth.toml").length_unit
    out = done(f"calibrate run.nominal.toml run.csv {method} --length-unit {unit} --out found.toml")
    assert "6 of 6 legs calibrated" in out
    truth = parameters("run.truth.toml", names_of(model))
    found = parameters("found.toml", names_of(model))
    assert abs(parameters("run.nominal.toml", names_of(model)) - truth).max() > 0.1
    assert abs(found - truth).max() < 1e-9


@pytest.mark.parametrize(
    ("simulated", "method", "model"),
    [(simulated, method + more, model) for simulated, method, model in CHAINS for more in ("", " --weighted")] + JOINT,
)
@pytest.mark.parametrize("kind", ["uniform", "normal"])
def test_with_noise_the_truth_is_within_the_standard_errors(done, simulated, method, model, kind):
    noise = f"{NOISE} --noise-kind {kind} --noise-angles rotation_vector"
    done(f"simulate --robot left-hand {simulated} --poses 15 {noise} --nominal-error 0.4cm --seed 5 --out run.csv")
    out = done(f"calibrate run.nominal.toml run.csv {method} {noise} --length-unit cm --out found.toml")
    errors = np.array([float(line.split()[4]) for line in out.splitlines() if line.endswith("  cm")])
    difference = parameters("found.toml", names_of(model)) - parameters("run.truth.toml", names_of(model))
    if model == 48:  # gains are in cm/cm
        difference = np.delete(difference, np.s_[7::8])
    scaled = difference / errors
    assert abs(scaled).max() < 5
    assert 0.5 < np.sqrt(np.mean(scaled**2)) < 1.6


def test_the_same_seed_gives_the_same_files(done):
    command = "simulate --robot left-hand --lock leg --leg 2 --poses 5 --nominal-error 1mm --position-noise 1mm --seed"
    done(f"{command} 4 --out a.csv")
    done(f"{command} 4 --out b.csv")
    done(f"{command} 5 --out c.csv")
    for suffix in (".csv", ".nominal.toml", ".truth.toml"):
        assert Path("a.csv").with_suffix(suffix).read_bytes() == Path("b.csv").with_suffix(suffix).read_bytes()
    assert Path("a.csv").read_bytes() != Path("c.csv").read_bytes()


def test_the_nominal_does_not_change_the_measurements(done):
    done("simulate --robot left-hand --lock none --out a.csv")
    done("simulate --robot left-hand --lock none --nominal-error 1cm --out b.csv")
    assert Path("a.csv").read_bytes() == Path("b.csv").read_bytes()
    assert not Path("a.nominal.toml").exists()


def test_one_leg_and_several_files(done):
    done("simulate --robot left-hand --lock leg --leg 4 --poses 6 --out first.csv")
    done("simulate --robot left-hand --lock length --leg 4 --poses 6 --seed 1 --out second.csv")
    out = done("calibrate left-hand first.csv second.csv --method three-step --length-unit cm --out found.toml")
    assert "1 of 6 legs calibrated" in out
    assert "not measured, nominal kept: leg 1, 2, 3, 5, 6" in out


def test_other_units_angles_and_columns(done):
    done("simulate --robot left-hand --lock direction --poses 6 --orientation ZXZ --angle-unit deg --out run.csv")
    sets = hx.read_measurements("run.csv", length_unit="cm", orientation="ZXZ", angle_unit="deg")
    millimetres = [
        hx.Measurements(
            part.position * 10, part.rotation, part.length * 10, part.lock, part.locked_leg, length_unit="mm"
        )
        for part in sets
    ]
    hx.write_measurements(millimetres, "mm.csv", orientation="xyz", angle_unit="rad")
    text = Path("mm.csv").read_text()
    Path("mm.csv").write_text(text.replace("position_x", "X").replace("orientation_1", "roll"))
    columns = "--column position_x=X --column orientation_1=roll"
    done(
        f"calibrate left-hand mm.csv --method one-step --length-unit mm --orientation xyz --angle-unit rad {columns} "
        "--out found.toml"
    )
    found, truth = hx.Hexapod.from_toml("found.toml"), hx.robots.left_hand()
    np.testing.assert_allclose(found.base_points, truth.base_points, atol=1e-9)


def test_files_of_single_legs(done):
    robot = hx.robots.left_hand()
    sets = [hx.simulate_leg(robot, leg, "direction", 5, rng=leg) for leg in (1, 6)]
    done("robots left-hand")  # moves to the folder
    hx.write_measurements(sets, "legs.csv")
    assert "2 of 6 legs calibrated" in done("calibrate left-hand legs.csv --method one-step --length-unit cm")


def test_the_report_is_what_was_printed(done):
    done("simulate --robot left-hand --lock direction --poses 6 --out run.csv")
    out = done("calibrate left-hand run.csv --method one-step --length-unit cm --report report.txt")
    assert Path("report.txt").read_text() == out.partition("wrote report.txt")[0]
    assert "residual of the nominal, RMS" in out
    assert out.endswith("nothing written: --out FILE.toml keeps the calibrated robot\n")


@pytest.mark.parametrize(("unit", "doubted"), [("cm", False), ("mm", True), ("m", True)])
def test_a_wrong_length_unit_is_doubted(done, unit, doubted):
    done("simulate --robot left-hand --lock direction --poses 6 --nominal-error 0.5cm --out run.csv")
    out = done(f"calibrate run.nominal.toml run.csv --method one-step --length-unit {unit}")
    assert ("is the length unit right?" in out) == doubted


def test_force_replaces(done, hexopt):
    command = "simulate --robot left-hand --lock none --poses 5 --out run.csv"
    done(command)
    assert hexopt(command).code == 2
    done(f"{command} --seed 1 --force")


# --- the real hexapod


@pytest.mark.parametrize(("flags", "rms"), [("", 0.88), ("--model 48", 0.41)])
def test_real_measurements_by_one_command(done, real_data, flags, rms):
    robot, poses = real_data / "nominal.toml", real_data / "calibration_108.csv"
    flags = ["--length-unit", "mm", "--method", "free", *flags.split(), "--out", "found.toml"]
    out = done("calibrate", robot, poses, *flags)
    assert round(float(out.partition("all:")[2].split()[0]), 2) == rms
    calibrated = hx.Hexapod.from_toml("found.toml")
    assert (calibrated.length_unit, calibrated.reading_unit) == ("mm", "rev")
    assert (calibrated.offsets != hx.Hexapod.from_toml(robot).offsets).all()


def test_a_likelihood_needs_a_noise_and_has_no_form(done, hexopt):
    done("simulate --robot left-hand --lock direction --poses 8 --out run.csv")
    command = "calibrate left-hand run.csv --method joint --length-unit cm"
    for more, message in (
        ("", "--position-noise"),
        ("--position-noise 0.001cm --angle-noise 0.001deg", "--length-noise, all > 0"),
        (f"{NOISE} --form direct", "--form: --method joint"),
        (f"{NOISE} --weighted", "--weighted: --method joint"),
    ):
        answer = hexopt(f"{command} {more}")
        assert answer.code == 2
        assert message in answer.err
