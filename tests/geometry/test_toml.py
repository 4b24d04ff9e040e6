"""Robots as TOML files: the round trip is exact, every mistake is one line."""

from dataclasses import fields, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hexopt as hx
from hexopt.errors import FileFormatError


def assert_same(one, two):
    """Check every field to the bit, the sign of zero included."""
    for field in fields(hx.Hexapod):
        left, right = getattr(one, field.name), getattr(two, field.name)
        if isinstance(left, np.ndarray):
            np.testing.assert_array_equal(left, right, err_msg=field.name)
            np.testing.assert_array_equal(np.signbit(left), np.signbit(right), err_msg=field.name)
        elif isinstance(left, (hx.Limits, hx.PoseRanges)):
            assert repr(left) == repr(right)
        else:
            assert left == right


def test_every_built_in_robot_survives_to_the_bit(robot, tmp_path):
    assert_same(hx.Hexapod.from_toml(robot.to_toml(tmp_path / "robot.toml")), robot)


def test_a_perturbed_robot_survives_to_the_bit(robot, tmp_path):
    moved = robot.perturbed(0.1 * robot.size, offsets=0.1 * robot.size, rng=0)
    assert_same(hx.Hexapod.from_toml(moved.to_toml(str(tmp_path / "robot.toml"))), moved)


FINITE = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e100, max_value=1e100)
ANGLE = st.floats(0, np.pi)
LENGTHS = st.tuples(st.floats(1e-300, 1e200), st.floats(1e-300, 1e200)).map(lambda pair: tuple(sorted(pair)))
TEXT = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=30)


@st.composite
def robots(draw):
    points = st.lists(st.tuples(FINITE, FINITE, FINITE), min_size=6, max_size=6).map(np.array)
    base, platform = draw(points), draw(points)
    optional = lambda strategy: draw(st.none() | strategy)  # noqa: E731 - a name for a strategy of strategies
    return hx.Hexapod(
        name=draw(TEXT),
        base_points=base,
        platform_points=platform,
        offsets=draw(st.lists(FINITE, min_size=6, max_size=6)),
        gains=draw(st.lists(st.floats(1e-300, 1e300), min_size=6, max_size=6)),
        length_unit=draw(st.sampled_from(["m", "cm", "mm", "um", "in", "unstated"])),
        reading_unit=draw(TEXT),
        home_position=[0, 0, 10 * (1 + np.abs(base).max() + np.abs(platform).max())],
        home_rotation=hx.rotations.euler_to_matrix(draw(st.tuples(ANGLE, ANGLE, ANGLE))),
        limits=hx.Limits(
            leg_length=optional(LENGTHS),
            leg_tilt=optional(ANGLE),
            base_tilt=optional(ANGLE),
            tilt=optional(ANGLE),
            angles=optional(st.tuples(ANGLE, ANGLE, ANGLE)),
            sequence=draw(st.sampled_from(["xyz", "ZXZ", "zyx"])),
            position=optional(st.tuples(*[st.floats(0, 1e300)] * 3)),
        ),
        ranges=hx.PoseRanges(
            angles=draw(st.tuples(ANGLE, ANGLE, ANGLE)),
            length=draw(LENGTHS),
            cone=draw(ANGLE),
            lock_cone=draw(ANGLE),
            sequence=draw(st.sampled_from(["xyz", "ZXZ"])),
        ),
    )


@given(robots())
def test_any_robot_survives_to_the_bit(tmp_path_factory, robot):
    path = tmp_path_factory.mktemp("robots") / "robot.toml"
    assert_same(hx.Hexapod.from_toml(robot.to_toml(path)), robot)


def test_only_the_needed_keys_are_needed(left_hand, tmp_path):
    path = tmp_path / "robot.toml"
    path.write_text(
        'name = "small"\nlength_unit = "mm"\n'
        f"base_points = {left_hand.base_points.tolist()}\nplatform_points = {left_hand.platform_points.tolist()}\n"
    )
    small = hx.Hexapod.from_toml(path)
    np.testing.assert_array_equal(small.offsets, 0)
    np.testing.assert_array_equal(small.gains, 1)
    assert (small.length_unit, small.reading_unit) == ("mm", "mm")


def test_whole_numbers_are_numbers(left_hand, tmp_path):
    path = tmp_path / "robot.toml"
    text = left_hand.to_toml(path).read_text().replace("15.25", "15")
    path.write_text(text)
    np.testing.assert_array_equal(hx.Hexapod.from_toml(path).offsets, 15.0)


ROW = "    [\n        -9.7,\n        9.1,\n        0.0,\n    ],\n"


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        (ROW, "", "base_points: a hexapod has 6 legs, got 5"),
        ("        9.1,\n        0.0,\n", "        9.1,\n", "base_points: expected numbers"),
        ("-9.7", '"-9.7"', "base_points: expected numbers"),
        ("-9.7", "nan", "base_points: 1 value.* NaN"),
        ("-9.7", "1" + 400 * "0", "base_points: expected numbers"),
        ("base_points", "bace_points", "misses base_points"),
        ('name = "Left Hand"', "", "misses name"),
        ('length_unit = "cm"', "", "misses length_unit"),
        ('length_unit = "cm"', 'length_unit = "furlong"', "unknown length unit 'furlong'"),
        ('length_unit = "cm"', "length_unit = 3", "unknown length unit 3"),
        ('reading_unit = "cm"', "reading_unit = 3", "reading_unit: expected a text"),
        ('name = "Left Hand"', "name = 3", "name: expected a non-empty text"),
        ('name = "Left Hand"', 'name = "Left Hand"\ncolour = "red"', r"unknown key\(s\) colour"),
        ('name = "Left Hand"', 'name = "Left Hand', "is not a TOML file"),
        ('name = "Left Hand"', 'name = "Left Hand"\nname = "twice"', "is not a TOML file"),
        ("[limits]", "[limits]\ncolour = 3", r"\[limits\]: expected a table with"),
        ("[limits]", "[[limits]]", r"\[limits\]: expected a table"),
        ("base_tilt = ", "base_tilt = 4", r"base_tilt: expected an angle"),
        ('sequence = "xyz"', 'sequence = "xyy"', "Euler sequence"),
        ('sequence = "xyz"', "sequence = 3", "Euler sequence"),
        ("cone = 1.", "cone = 9.", "cone: expected an angle"),
        ("[ranges]", "[ranges]\ncolour = 3", r"\[ranges\]: expected a table"),
    ],
)
def test_a_wrong_file_is_one_line_that_names_it(left_hand, tmp_path, old, new, message):
    path = left_hand.to_toml(tmp_path / "robot.toml")
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(FileFormatError, match=message) as caught:
        hx.Hexapod.from_toml(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert "\n" not in str(caught.value)


def test_a_missing_range_is_named(left_hand, tmp_path):
    path = left_hand.to_toml(tmp_path / "robot.toml")
    text = path.read_text()
    path.write_text(text[: text.index("lock_cone")] + "\n")
    with pytest.raises(FileFormatError, match="lock_cone"):
        hx.Hexapod.from_toml(path)


@pytest.mark.parametrize("content", [b"\xff\xfe\x00", b"not toml", b"[[[", b"a = 1\x00"])
def test_what_is_no_toml_is_said_so(tmp_path, content):
    path = tmp_path / "robot.toml"
    path.write_bytes(content)
    with pytest.raises(FileFormatError, match="is not a TOML file") as caught:
        hx.Hexapod.from_toml(path)
    assert "\n" not in str(caught.value)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(FileFormatError, match=r"none\.toml: cannot be read \(No such file"):
        hx.Hexapod.from_toml(tmp_path / "none.toml")
    with pytest.raises(FileFormatError, match="cannot be read"):
        hx.Hexapod.from_toml(tmp_path)


def test_a_robot_that_cannot_be_written_leaves_nothing(left_hand, tmp_path):
    with pytest.raises(hx.InputError, match="cannot be written"):
        left_hand.to_toml(tmp_path / "none" / "robot.toml")
    assert list(tmp_path.iterdir()) == []


def test_replace_and_write_do_not_touch_the_original(left_hand, tmp_path):
    before = repr(left_hand)
    replace(left_hand, name="other").to_toml(tmp_path / "robot.toml")
    assert repr(left_hand) == before
