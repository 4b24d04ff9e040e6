"""Named blocks of unknowns."""

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError


@pytest.fixture
def parameters():
    return hx.Parameters(
        (
            hx.Block("platform_point", 3, "cm", scale=0.5),
            hx.Block("offset", 1, "cm", scale=2.0),
            hx.Block("direction", 3, "1", nuisance=True),
            hx.Block("pair", 2, "cm"),
        )
    )


def test_places_labels_and_scales(parameters):
    assert parameters.size == 9
    assert parameters.names == ("platform_point", "offset", "direction", "pair")
    assert parameters["offset"] == slice(3, 4)
    assert parameters["direction"] == slice(4, 7)
    assert parameters.labels[2:5] == ("platform_point.z", "offset", "direction.x")
    assert parameters.labels[7:] == ("pair.1", "pair.2")
    np.testing.assert_array_equal(parameters.scale, [0.5] * 3 + [2.0] + [1.0] * 5)
    assert "offset" in parameters
    assert "gain" not in parameters
    assert [block.name for block in parameters] == list(parameters.names)


def test_main_leaves_the_nuisance_out(parameters):
    assert parameters.main.names == ("platform_point", "offset", "pair")


def test_split_names_the_values(parameters):
    values = np.arange(18.0).reshape(2, 9)
    parts = parameters.split(values)
    np.testing.assert_array_equal(parts["offset"], [[3.0], [12.0]])
    np.testing.assert_array_equal(np.concatenate(list(parts.values()), axis=-1), values)


def test_an_unknown_name_is_an_error_that_lists_the_known_ones(parameters):
    with pytest.raises(InputError, match=r"unknown parameter 'bace_point'.*platform_point, offset, direction, pair"):
        parameters["bace_point"]


def test_a_name_twice_is_an_error():
    with pytest.raises(InputError, match="twice"):
        hx.Parameters((hx.Block("a", 1, "cm"), hx.Block("a", 3, "cm")))


@pytest.mark.parametrize(
    ("vector", "words"),
    [
        ([0, 0, 0, 1.0], "offset"),
        ([0, 0, 0, -2.0], "offset"),
        ([-1.0, 0, 0, 1.0], "base_point.x − offset"),
        ([1.0, 0, 0, -1.0], "base_point.x − offset"),
        ([0.5, -1.0, 0.01, 0], "0.5·base_point.x − base_point.y"),
    ],
)
def test_a_combination_in_words(vector, words):
    parameters = hx.Parameters((hx.Block("base_point", 3, "cm"), hx.Block("offset", 1, "cm")))
    assert parameters.combination(vector) == words


def test_parameters_are_values():
    one, two = (hx.Parameters((hx.Block("a", 3, "cm"),)) for _ in range(2))
    assert one == two
    assert hash(one) == hash(two)
    assert one != hx.Parameters((hx.Block("a", 3, "mm"),))
