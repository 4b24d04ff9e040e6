"""Length units are checked labels."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import UnitError
from hexopt.geometry import LENGTH_UNITS, check_length_unit, length_factor

METRES = {"m": 1.0, "dm": 0.1, "cm": 0.01, "mm": 0.001, "um": 1e-6, "in": 0.0254}


@pytest.mark.parametrize("source", METRES)
@pytest.mark.parametrize("target", METRES)
def test_factors(source, target):
    np.testing.assert_allclose(length_factor(source, target), METRES[source] / METRES[target], rtol=1e-12)
    np.testing.assert_allclose(length_factor(source, target) * length_factor(target, source), 1.0, rtol=1e-12)


def test_the_table_holds_no_other_unit():
    assert set(LENGTH_UNITS) == {*METRES, "unstated"}


@pytest.mark.parametrize(
    ("alias", "label"), [("µm", "um"), ("μm", "um"), ("micron", "um"), ("inch", "in"), ("cm", "cm")]
)
def test_aliases(alias, label):
    assert check_length_unit("unit", alias) == label


@pytest.mark.parametrize("unit", ["", "CM", "km", "parsec", None, 1, ["cm"]])
def test_an_unknown_unit_is_an_error_that_lists_the_known_ones(unit):
    with pytest.raises(UnitError, match=r"length_unit: unknown length unit .*mm"):
        check_length_unit("length_unit", unit)


def test_unstated_converts_to_itself_alone():
    assert length_factor("unstated", "unstated") == 1.0
    with pytest.raises(UnitError, match="states no unit"):
        length_factor("unstated", "cm")
    with pytest.raises(UnitError, match="states no unit"):
        length_factor("mm", "unstated")


def test_measurements_must_have_the_nominals_unit(left_hand):
    with pytest.raises(UnitError, match="measurements are in mm, the nominal geometry in cm"):
        hx.LegMeasurements(np.zeros((1, 3)), np.eye(3)[None], None, "leg", nominal=left_hand.leg(1), length_unit="mm")
