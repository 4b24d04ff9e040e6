"""Linear estimates know nothing of the nominal's joints: another nominal leaves them the same to the bit."""

from dataclasses import replace

import numpy as np
import pytest

import hexopt as hx

LOOPS = {
    "FixedDirection": ("direction", ("direct", "consecutive")),
    "FixedLeg": ("leg", ("direct", "consecutive", "centred")),
    "FixedLength": ("length", ("direct", "consecutive", "centred")),
    "LegLength": ("none", ("direct",)),
}
CASES = [(name, form) for name, (_, forms) in LOOPS.items() for form in forms]
ESTIMATORS = [
    hx.LeastSquares(),
    hx.LeastSquares(weights="model"),
    hx.LeastSquares(method="svd"),
    hx.LeastSquares(method="svd", weights="model"),
    hx.ConvexEstimator(weights=None),
    hx.ConvexEstimator(),
]


def estimates(data, name, form, estimator):
    leg = hx.robots.left_hand().leg(3)
    known = {}
    if name == "FixedLength":
        known = {"platform_point": leg.platform_point}
    if name == "LegLength":
        known = {"unknown": "offset", "platform_point": leg.platform_point, "base_point": leg.base_point}
    return hx.estimate(getattr(hx.loops, name)(data, **known).linear(form), estimator)


@pytest.fixture
def nominals(left_hand):
    """The truth, wrong ones, and one that is absurd; offset and gain kept."""
    leg = left_hand.leg(3)
    return [
        leg,
        left_hand.perturbed(0.1, rng=0).leg(3),
        left_hand.perturbed(5.0, rng=1).leg(3),
        leg.replaced(base_point=[1e6, -1e6, 1e-9], platform_point=[0, 0, 0]),
    ]


@pytest.mark.parametrize("estimator", ESTIMATORS, ids=repr)
@pytest.mark.parametrize(("name", "form"), CASES)
def test_the_nominal_changes_no_bit(nominals, paper_noise, name, form, estimator):
    n_sets = 3 if isinstance(estimator, hx.ConvexEstimator) else 40
    data = hx.simulate_leg(
        hx.robots.left_hand(), 3, LOOPS[name][0], 8, n_sets, noise=paper_noise, nominal=nominals[0], rng=0
    )
    found = [estimates(replace(data, nominal=nominal), name, form, estimator) for nominal in nominals]
    for other in found[1:]:
        for field in ("values", "covariance", "objective", "gap", "condition", "codes", "influence"):
            assert np.array_equal(getattr(found[0], field), getattr(other, field)), field


@pytest.mark.parametrize("estimator", [None, hx.LeastSquares(weights="model")], ids=repr)
@pytest.mark.parametrize(
    "method",
    [hx.OneStep("consecutive"), hx.OneStep("direct"), hx.ThreeStep("consecutive"), hx.ThreeStep("centred")],
    ids=repr,
)
def test_calibrations_neither(nominals, paper_noise, left_hand, method, estimator):
    sets = {lock: hx.simulate_leg(left_hand, 3, lock, 8, 20, noise=paper_noise, rng=5) for lock in method.locks}
    found = [
        method.calibrate_leg({lock: replace(d, nominal=nominal) for lock, d in sets.items()}, estimator)
        for nominal in nominals
    ]
    for other in found[1:]:
        for field in ("base_point", "platform_point", "offset", "gain"):
            assert np.array_equal(getattr(found[0].leg, field), getattr(other.leg, field)), field
        assert np.array_equal(found[0].covariance, other.covariance)
        assert np.array_equal(found[0].residual_rms, other.residual_rms)


def test_offset_and_gain_are_taken_from_it_where_the_loop_says_so(paper_noise, left_hand):
    """The other side of the coin: what the nominal does lend."""
    data = hx.simulate_leg(left_hand, 3, "direction", 8, noise=paper_noise, rng=0)
    for change in ({"offset": 15.0}, {"gain": 1.01}):
        other = replace(data, nominal=data.nominal.replaced(**change))
        one, two = (hx.estimate(hx.loops.FixedDirection(d).linear(), hx.LeastSquares()) for d in (data, other))
        assert (one.params["base_point"] != two.params["base_point"]).all()
