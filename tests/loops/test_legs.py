"""Parameters of several legs: their order, their values, their stacked arrays."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, UnitError
from hexopt.loops.legs import leg_blocks, leg_columns, leg_parameters, leg_values

NAMES = ("platform_point", "base_point", "offset", "gain")
FIELDS = {"platform_point": "platform_points", "base_point": "base_points", "offset": "offsets", "gain": "gains"}
LEGS = (1, 3, 4)


def test_order_and_units():
    parameters = leg_parameters(("gain", "base_point"), (2, 5), "mm")
    assert parameters.names == ("leg2.base_point", "leg2.gain", "leg5.base_point", "leg5.gain")
    assert [block.unit for block in parameters] == ["mm", "mm/reading", "mm", "mm/reading"]
    assert leg_parameters(NAMES, range(1, 7), "cm").size == 48


@pytest.mark.parametrize("unknown", [NAMES, NAMES[:2], ("offset",)])
def test_a_robot_there_and_back(unknown):
    robot = hx.robots.jugglebot()
    parameters = leg_parameters(unknown, LEGS, "mm")
    values = leg_values(robot, parameters, "mm")
    blocks = leg_blocks(values, parameters, robot if len(unknown) < 4 else None, LEGS)
    for name, field in FIELDS.items():
        np.testing.assert_array_equal(blocks[name], getattr(robot, field)[[0, 2, 3]])


def test_batches_of_values():
    parameters = leg_parameters(NAMES[:3], LEGS, "cm")
    values = np.arange(2 * 5 * 21.0).reshape(2, 5, 21)
    blocks = leg_blocks(values, parameters, hx.robots.left_hand(), LEGS)
    assert {name: block.shape for name, block in blocks.items()} == {
        "platform_point": (2, 5, 3, 3),
        "base_point": (2, 5, 3, 3),
        "offset": (2, 5, 3),
        "gain": (3,),
    }
    np.testing.assert_array_equal(blocks["base_point"][1, 4, 2], values[1, 4, parameters["leg4.base_point"]])
    np.testing.assert_array_equal(leg_values(values, parameters, "cm"), values)


def test_an_only_leg_may_be_a_batch(left_hand):
    parameters = leg_parameters(("base_point", "offset"), (3,), "cm")
    leg = left_hand.leg(3).replaced(base_point=np.arange(12.0).reshape(4, 3))
    values = leg_values(leg, parameters, "cm")
    assert values.shape == (4, 4)
    np.testing.assert_array_equal(values[:, 3], 15.25)


def test_values_of_an_estimate(left_hand):
    data = hx.simulate(left_hand, n_poses=8, rng=0)
    loop = hx.loops.PlatformPose(data)
    found = hx.estimate(loop, hx.ForwardKinematics())
    offsets = leg_parameters(("offset",), range(1, 7), "cm")
    np.testing.assert_allclose(leg_values(found, offsets, "cm"), 15.25)
    with pytest.raises(InputError, match=r"leg1\.gain, .* missing; the estimate has leg1\.platform_point"):
        leg_values(found, leg_parameters(("gain",), range(1, 7), "cm"), "cm")
    with pytest.raises(UnitError, match="the measurements are in mm, the estimate in cm"):
        leg_values(found, leg_parameters(("offset",), range(1, 7), "mm"), "mm")


def test_wrong_values(left_hand):
    parameters = leg_parameters(NAMES[:2], LEGS, "mm")
    with pytest.raises(UnitError, match="the measurements are in mm, the hexapod in cm"):
        leg_values(left_hand, parameters, "mm")
    with pytest.raises(InputError, match=r"values: expected 18 \(leg1\.platform_point, .*\), got shape \(17,\)"):
        leg_values(np.zeros(17), parameters, "mm")
    with pytest.raises(InputError, match=r"leg1\.platform_point is wanted, and leg 3 is given; give the robot"):
        leg_values(left_hand.leg(3), leg_parameters(NAMES[:2], LEGS, "cm"), "cm")
    with pytest.raises(InputError, match="offset: neither unknown nor known; give measurements with a nominal robot"):
        leg_blocks(np.zeros(18), parameters, None, LEGS)


def test_columns_are_the_chain_rule(left_hand):
    """A weighted sum of all blocks, differentiated by the vector of values."""
    parameters = leg_parameters(NAMES[:3], LEGS, "cm")
    rng = np.random.default_rng(0)
    weights = {"platform_point": rng.normal(size=(2, 3, 3)), "base_point": rng.normal(size=(2, 3, 3))}
    weights |= {"offset": rng.normal(size=(2, 3, 1)), "gain": rng.normal(size=(2, 3, 1))}
    columns = leg_columns(weights, parameters, LEGS)
    assert columns.shape == (2, 21)
    step = rng.normal(size=21)
    before, after = (leg_blocks(x, parameters, left_hand, LEGS) for x in (np.zeros(21), step))
    change = sum(np.einsum("rls,ls->r", weights[name], (after[name] - before[name]).reshape(3, -1)) for name in NAMES)
    np.testing.assert_allclose(columns @ step, change, rtol=1e-12)
