"""Maximum likelihood by Monte Carlo: at the Cramér–Rao bound, without bias, and better than the paper's estimator."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import stats

import hexopt as hx
from hexopt.loops import FixedDirection, FixedLeg, FixedLength, LegLength, Sets, WholeRobot

ML = hx.MaximumLikelihood()
ROBOT = hx.robots.left_hand()
LEG = ROBOT.leg(3)
SETS = 2000
NOISES = {
    "normal": hx.NormalNoise(0.01, np.deg2rad(0.01), 0.01),
    "uniform": hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01),
}
LOOPS = {
    "I": ("direction", FixedDirection),
    "II": ("leg", FixedLeg),
    "III": ("length", FixedLength),
    "Model 42": ("none", LegLength),
}


def measured(lock, noise, n, n_sets=SETS, seed=0):
    """The same poses twice: exact, where the bound is taken, and in error."""
    exact = hx.simulate_leg(ROBOT, 3, lock, n, n_sets, rng=seed)
    errors = np.random.default_rng(seed + 1000)
    noisy = noise.apply(exact.position, exact.rotation, exact.length, errors)
    return replace(exact, noise=noise), hx.LegMeasurements(*noisy, lock, noise, LEG)


def error_of(found, names):
    return np.concatenate([found.params[name] - LEG.block(name) for name in names], axis=-1)


def normalised(error, covariance):
    """e'C⁻¹e/p of every set, and their mean's standard error."""
    scale = np.sqrt(np.einsum("...ii->...i", covariance))
    e = error / scale
    correlation = covariance / scale[..., :, None] / scale[..., None, :]
    squares = np.einsum("si,si->s", e, np.linalg.solve(correlation, e[..., None])[..., 0]) / e.shape[-1]
    return squares, squares.std() / np.sqrt(len(squares))


def rms(error):
    return np.sqrt((error**2).sum(axis=-1).mean())


@pytest.mark.parametrize("noise", NOISES)
@pytest.mark.parametrize("n", [7, 20])
@pytest.mark.parametrize("name", ["I", "II", "III"])
def test_errors_are_those_of_the_bound(name, n, noise):
    lock, kind = LOOPS[name]
    exact, noisy = measured(lock, NOISES[noise], n, seed=n)
    loop = kind(noisy)
    found = hx.estimate(loop, ML)
    assert found.ok.all()
    error = error_of(found, loop.unknown)
    squares, spread = normalised(error, kind(exact).crlb(LEG))
    assert abs(squares.mean() - 1) < 4 * spread
    own, _ = normalised(error, found.covariance_of(*loop.unknown))
    assert abs(own.mean() - 1) < 4 * spread
    freedom = found.degrees_of_freedom
    assert abs(found.chi2.mean() / freedom - 1) < 5 * np.sqrt(2 / freedom / SETS)
    bias = np.abs(error.mean(axis=0)) / error.std(axis=0) * np.sqrt(SETS)
    assert bias.max() < 4.5
    if noise == "normal":
        sigma = np.sqrt(np.einsum("...ii->...i", found.covariance_of(*loop.unknown)))
        inside = (np.abs(error) <= stats.norm.ppf(0.975) * sigma).mean(axis=0)
        assert np.abs(inside - 0.95).max() < 0.02


def test_lengths_of_unlocked_poses():
    """Model 42 has heavy tails where poses are few; with 20 it is at the bound."""
    exact, noisy = measured("none", NOISES["normal"], 20, 1000)
    found = hx.estimate(LegLength(noisy), ML)
    assert found.ok.all()
    squares, spread = normalised(error_of(found, LegLength.default_unknown), LegLength(exact).crlb(LEG))
    assert abs(squares.mean() - 1) < 4 * spread


class TestAgainstThePaper:
    """On the same data: consecutive rows, unweighted, as published."""

    def both(self, n, size, n_sets):
        noise = hx.UniformNoise(size, np.deg2rad(size), size)
        loop = FixedDirection(measured("direction", noise, n, n_sets, seed=3)[1])
        return hx.estimate(loop, ML), hx.estimate(loop.linear("consecutive"), hx.LeastSquares())

    def test_seven_poses(self):
        ours, paper = self.both(7, 0.01, SETS)
        ratio = {
            name: rms(error_of(paper, [name])) / rms(error_of(ours, [name])) for name in ours.parameters.main.names
        }
        assert ratio["base_point"] >= 1.5
        assert ratio["platform_point"] >= 1.2

    def test_bias_of_large_errors(self):
        """Half a centimetre and half a degree, 50 poses: noise in the matrix."""
        ours, paper = self.both(50, 0.5, 800)
        assert ours.ok.all()
        bias = [np.linalg.norm(error_of(found, ["base_point"]).mean(axis=0)) / 0.5 for found in (ours, paper)]
        assert bias[0] < 0.2
        assert 2.5 < bias[1] < 3.5

    def test_without_the_unit_norm_much_of_the_gain_is_lost(self):
        loop = FixedDirection(measured("direction", NOISES["uniform"], 7, 1000)[1])
        kept, free = (
            rms(error_of(hx.estimate(loop, hx.MaximumLikelihood(unit_norm=unit_norm)), ["base_point"]))
            for unit_norm in (True, False)
        )
        assert free > 1.1 * kept


class TestCarriedErrors:
    """b by a LEG set of 7 poses, a by a LENGTH set of 50."""

    def found(self, n_sets=1200):
        noise = NOISES["normal"]
        two, three = measured("leg", noise, 7, n_sets)[1], measured("length", noise, 50, n_sets, seed=1)[1]
        b = hx.estimate(FixedLeg(two), ML)
        return two, three, b

    def covers(self, found):
        error = error_of(found, ["base_point"])
        sigma = np.sqrt(np.einsum("...ii->...i", found.covariance_of("base_point")))
        return (np.abs(error) <= stats.norm.ppf(0.975) * sigma).mean(axis=0)

    def test_intervals_cover_where_the_error_of_b_is_carried(self):
        _, three, b = self.found()
        carried = hx.estimate(FixedLength(three, platform_point=b), ML)
        taken = hx.estimate(FixedLength(three, platform_point=b.params["platform_point"]), ML)
        assert np.abs(self.covers(carried) - 0.95).max() < 0.02
        assert self.covers(taken).mean() < 0.8

    def test_both_sets_together_are_better(self):
        two, three, b = self.found(500)
        steps = hx.estimate(FixedLength(three, platform_point=b), ML)
        paper = hx.estimate(
            FixedLength(three, platform_point=b.params["platform_point"]).linear("consecutive"), hx.LeastSquares()
        )
        joint = hx.estimate(Sets(FixedLeg(two), FixedLength(three, unknown=("platform_point", "base_point"))), ML)
        assert joint.ok.all()
        errors = [rms(error_of(found, ["base_point"])) for found in (joint, steps, paper)]
        assert errors[0] < errors[1] * 1.01
        assert errors[2] > 1.4 * errors[0]
        assert np.abs(self.covers(joint) - 0.95).max() < 0.04


def test_six_directions_of_a_whole_robot():
    """42 unknowns of 42 poses, offsets too, from all 252 readings: at the bound, far below one leg at a time."""
    robot = replace(ROBOT, limits=hx.Limits(), ranges=replace(ROBOT.ranges, lock_cone=np.deg2rad(40)))
    noise, n_sets = NOISES["normal"], 60
    sets = [hx.simulate(robot, "direction", 7, n_sets, noise, robot.ranges, leg=k, rng=k) for k in range(1, 7)]
    joint = hx.estimate(WholeRobot(*sets), ML)
    assert joint.ok.all()
    truth = np.concatenate([robot.leg(k).block(name) for k in range(1, 7) for name in LegLength.default_unknown])
    error = joint.values[:, :42] - truth
    squares, spread = normalised(error, joint.covariance[:, :42, :42])
    assert abs(squares.mean() - 1) < 4 * spread
    assert abs(joint.chi2.mean() / joint.degrees_of_freedom - 1) < 5 * np.sqrt(2 / joint.degrees_of_freedom / n_sets)
    alone = [hx.estimate(FixedDirection(data.leg(k)), ML) for k, data in enumerate(sets, start=1)]
    gain = {}
    for name in ("platform_point", "base_point"):
        squared = [
            sum((found.error(robot if found is joint else robot.leg(k))[key] ** 2).mean() for k, found, key in each)
            for each in (
                [(k, found, name) for k, found in enumerate(alone, start=1)],
                [(k, joint, f"leg{k}.{name}") for k in range(1, 7)],
            )
        ]
        gain[name] = np.sqrt(squared[0] / squared[1])
    assert gain["base_point"] >= 4
    assert gain["platform_point"] >= 1.5
