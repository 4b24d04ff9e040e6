"""Limits and ranges are checked where they are written."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError

RANGES = {"angles": (0.1, 0.2, 0.3), "length": (17.0, 20.0), "cone": 1.0, "lock_cone": 0.3}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"length": (20, 17)}, "length: expected 0 < low <= high"),
        ({"length": (0, 17)}, "length: expected 0 < low <= high"),
        ({"length": (1, 2, 3)}, "length: expected shape"),
        ({"cone": 68}, "cone: expected an angle .* angles are radians"),
        ({"cone": -0.1}, "cone: expected an angle"),
        ({"lock_cone": np.nan}, "lock_cone: .*NaN"),
        ({"angles": (35, 35, 35)}, "angles: expected three half-widths"),
        ({"angles": (-0.1, 0.1, 0.1)}, "angles: expected three half-widths"),
        ({"angles": 0.1}, "angles: expected shape"),
        ({"sequence": "ZZX"}, "Euler sequence"),
        ({"length": "ab"}, "length: expected numbers"),
    ],
)
def test_wrong_ranges(changes, message):
    with pytest.raises(InputError, match=message):
        hx.PoseRanges(**{**RANGES, **changes})


@pytest.mark.parametrize(
    ("limits", "message"),
    [
        ({"leg_length": (2, 1)}, "leg_length"),
        ({"leg_tilt": 45}, "leg_tilt: .*radians"),
        ({"base_tilt": -1}, "base_tilt"),
        ({"tilt": "a"}, "tilt"),
        ({"angles": (1, 2)}, "angles"),
        ({"position": (1, -2, 3)}, "position"),
        ({"sequence": "xyw"}, "Euler sequence"),
    ],
)
def test_wrong_limits(limits, message):
    with pytest.raises(InputError, match=message):
        hx.Limits(**limits)


def test_description_states_every_range():
    text = hx.PoseRanges(**RANGES, sequence="xyz").describe("mm")
    for part in ("xyz", "5.72958°", "11.4592°", "17.1887°", "17–20 mm", "57.2958°", "17.1887°"):
        assert part in text
