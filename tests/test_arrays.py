"""The gate through which numbers enter."""

from fractions import Fraction

import numpy as np
import pandas as pd
import pytest
from hypothesis import given
from hypothesis.extra import numpy as hnp

from hexopt.arrays import as_array, as_count, as_generator, matvec, norm, transpose
from hexopt.errors import InputError


def test_numbers_become_read_only_floats():
    for value in (
        [1, 2, 3],
        (1.0, 2, 3),
        np.array([1, 2, 3], dtype=np.int16),
        pd.Series([1, 2, 3]),
        [Fraction(1), 2, 3],
    ):
        array = as_array("x", value, (3,))
        assert array.dtype == np.float64
        assert not array.flags.writeable
        np.testing.assert_array_equal(array, [1.0, 2.0, 3.0])


def test_the_callers_array_keeps_its_flags():
    mine = np.zeros(3)
    as_array("x", mine, (3,))
    assert mine.flags.writeable


@pytest.mark.parametrize(
    "value",
    [
        "1",
        ["1", "2", "3"],
        b"1",
        [1 + 2j, 0, 0],
        np.array([1 + 0j, 0, 0]),
        [True, False, True],
        [None, 1, 2],
        [1, [2, 3]],
        [10**400, 0, 0],
        {"a": 1},
        object(),
        np.array([["a", "b"], ["c", "d"]] * 20),
        np.array(["2020-01-01"], dtype="datetime64[D]"),
    ],
)
def test_what_is_no_real_number_is_one_line(value):
    with pytest.raises(InputError, match=r"^position: expected numbers, got ") as caught:
        as_array("position", value, ("n",))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("shape", "batch", "given_shape", "shown"),
    [
        ((3,), True, (4,), r"\(\.\.\., 3\)"),
        ((3,), True, (), r"\(\.\.\., 3\)"),
        ((3,), False, (2, 3), r"\(3\)"),
        (("n", 3), True, (3,), r"\(\.\.\., n, 3\)"),
        ((None, 3), True, (3, 2), r"\(\.\.\., any, 3\)"),
        ((), False, (1,), r"\(\)"),
    ],
)
def test_a_wrong_shape_names_both(shape, batch, given_shape, shown):
    with pytest.raises(InputError, match=rf"x: expected shape {shown}, got \({', '.join(map(str, given_shape))},?\)"):
        as_array("x", np.zeros(given_shape), shape, batch=batch)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_nan_and_infinity_name_their_place_and_number(bad):
    value = np.zeros((4, 3))
    value[2, 1] = value[3, 0] = bad
    with pytest.raises(InputError, match=r"x: 2 value\(s\) are NaN or infinite, the first at index \(2, 1\)"):
        as_array("x", value, (3,))


@given(hnp.arrays(np.float64, hnp.array_shapes(max_dims=3), elements={"allow_nan": False, "allow_infinity": False}))
def test_finite_floats_pass_to_the_bit(value):
    np.testing.assert_array_equal(as_array("x", value, tuple([None] * value.ndim)), value)


def test_the_same_seed_gives_the_same_stream():
    draws = [
        as_generator(seed).uniform() for seed in (3, np.int64(3), np.random.SeedSequence(3), np.random.default_rng(3))
    ]
    assert len(set(draws)) == 1
    generator = np.random.default_rng(0)
    assert as_generator(generator) is generator


@pytest.mark.parametrize("bad", [None, -1, 1.5, True, "0", np.random])
def test_what_is_no_seed_is_an_error(bad):
    with pytest.raises(InputError, match=r"^rng: "):
        as_generator(bad)


def test_a_count_is_a_whole_number():
    assert as_count("n", np.int64(3)) == 3
    for bad in (0, -1, 2.5, "a", True, None, np.nan):
        with pytest.raises(InputError, match=r"n: expected a whole number >= 1, got "):
            as_count("n", bad)


def test_small_linear_algebra_is_numpys():
    rng = np.random.default_rng(0)
    matrix, vector = rng.standard_normal((4, 5, 2, 3)), rng.standard_normal((5, 3))
    np.testing.assert_allclose(matvec(matrix, vector), (matrix @ vector[..., None])[..., 0], atol=1e-15)
    np.testing.assert_allclose(norm(matrix), np.linalg.norm(matrix, axis=-1), rtol=1e-15)
    np.testing.assert_array_equal(transpose(matrix), np.moveaxis(matrix, -1, -2))
