"""What a summary warns of."""

import numpy as np

import hexopt as hx

WARNING = "χ² is far beyond its degrees of freedom"


def test_a_noise_that_is_too_small_is_said(left_hand):
    noise = hx.NormalNoise(0.01, 1e-4, 0.01)
    data = hx.simulate_leg(left_hand, 3, "direction", 12, noise=noise, rng=1)
    loop = hx.loops.FixedDirection(data)
    assert WARNING not in hx.estimate(loop, hx.MaximumLikelihood()).summary()
    few = hx.loops.FixedDirection(data.poses(slice(0, 3)))  # one degree of freedom
    assert WARNING not in hx.estimate(few, hx.MaximumLikelihood()).summary()
    position = np.array(data.position)
    position[4] += 0.5
    moved = hx.LegMeasurements(position, data.rotation, data.length, data.lock, noise, data.nominal)
    assert WARNING in hx.estimate(hx.loops.FixedDirection(moved), hx.MaximumLikelihood()).summary()
