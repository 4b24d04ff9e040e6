"""One leg: checked values, true length and reading."""

import pickle

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError, UnitError


def leg(**changes):
    settings = {"number": 3, "platform_point": [1, 2, 3], "base_point": [4, 5, 6], "offset": 2.0, "gain": 0.5}
    return hx.Leg(**{**settings, **changes})


def test_true_length_and_reading_are_inverse():
    one = leg()
    reading = np.array([[1.0, 2.0], [3.0, 4.0]])
    np.testing.assert_allclose(one.true_length(reading), 2.0 + 0.5 * reading)
    np.testing.assert_allclose(one.reading(one.true_length(reading)), reading, rtol=1e-15)


def test_a_batch_of_legs_broadcasts_over_poses():
    many = leg(offset=[1.0, 2.0], gain=[1.0, 3.0])
    np.testing.assert_allclose(many.true_length([10.0, 20.0, 30.0]), [[11, 21, 31], [32, 62, 92]])


def test_blocks_have_a_last_dimension():
    assert leg().block("offset").shape == (1,)
    assert leg(offset=np.zeros(4)).block("offset").shape == (4, 1)
    assert leg().block("platform_point").shape == (3,)


def test_replaced_keeps_the_rest():
    changed = leg().replaced(base_point=[7, 8, 9])
    np.testing.assert_array_equal(changed.base_point, [7, 8, 9])
    np.testing.assert_array_equal(changed.platform_point, [1, 2, 3])
    assert changed.number == 3
    with pytest.raises(InputError, match="got bace_point"):
        leg().replaced(bace_point=[7, 8, 9])


def test_a_leg_is_read_only():
    with pytest.raises(ValueError, match="read-only"):
        leg().base_point[0] = 0.0
    with pytest.raises(AttributeError):
        leg().offset = 1.0


def test_a_leg_does_not_change_with_the_callers_arrays():
    mine = np.array([4.0, 5.0, 6.0])
    one = leg(base_point=mine)
    mine[0] = 0.0
    np.testing.assert_array_equal(one.base_point, [4, 5, 6])


def test_legs_are_values():
    """Equal numbers make equal legs: settings that hold one (a start, say) compare and pickle as values."""
    one, two = leg(), leg()
    assert one == two
    assert hash(one) == hash(two)
    assert pickle.loads(pickle.dumps(one)) == one
    assert leg(base_point=[4, 5, 0.0]) == leg(base_point=[4, 5, -0.0])
    for change in (
        {"number": 4},
        {"base_point": [4, 5, 6 + 1e-15]},
        {"offset": 2.1},
        {"length_unit": "mm"},
        {"offset": [2.0]},
    ):
        assert leg(**change) != one
    assert one != "leg"


@pytest.mark.parametrize("number", [0, 7, -1, 3.0, "3", None, True])
def test_an_unknown_leg_is_an_error(number):
    with pytest.raises(InputError, match="leg: expected a number from 1 to 6"):
        leg(number=number)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"gain": 0.0}, "gain: expected values other than 0"),
        ({"gain": np.linspace(-1, 1, 101)}, "gain: expected values other than 0"),
        ({"base_point": [1, 2]}, "base_point: expected shape"),
        ({"platform_point": [1, np.nan, 2]}, "platform_point: .*NaN"),
        ({"offset": "15"}, "offset: expected numbers"),
    ],
)
def test_wrong_values_are_one_line(changes, message):
    with pytest.raises(InputError, match=message) as caught:
        leg(**changes)
    assert "\n" not in str(caught.value)


def test_an_unknown_unit_is_an_error():
    with pytest.raises(UnitError):
        leg(length_unit="furlong")
