"""A thousand candidates of a real robot: how good the designs are, and that the best is proven."""

import numpy as np
import pytest

import hexopt as hx

NOISE = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
LOOPS = {"direction": hx.loops.FixedDirection, "leg": hx.loops.FixedLeg, "length": hx.loops.FixedLength}


@pytest.fixture(scope="module", params=LOOPS)
def loop(request):
    """Leg 3 of the Left Hand, under each lock."""
    pool = hx.candidates(hx.robots.left_hand(), 3, request.param, 1000, NOISE, rng=0)
    return LOOPS[request.param](pool.leg(3))


@pytest.mark.parametrize("criterion", ["A", "D"])
def test_a_design_is_near_the_bound(loop, criterion):
    """Of the relaxation, whose weights may be fractions: at ten poses not every best design comes within 1.5 %."""
    found = {n: hx.select_poses(loop, n, criterion).efficiency for n in (7, 10, 20)}
    assert found[7] >= 0.96
    assert found[10] >= 0.98
    assert found[20] >= 0.985


@pytest.mark.parametrize("criterion", ["A", "D"])
@pytest.mark.parametrize("n", [4, 7, 10, 20])
def test_the_best_of_all_is_proven(loop, criterion, n):
    design = hx.select_poses(loop, n, criterion, prove=60.0)
    assert design.proven
    assert design.efficiency == pytest.approx(1.0, abs=1e-6)
    assert design.value <= hx.select_poses(loop, n, criterion).value * (1 + 1e-12 * np.sign(design.value))
