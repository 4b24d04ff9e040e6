"""How many poses: the knee on known sequences, and the curves."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import hexopt as hx
from hexopt.errors import InputError
from hexopt.plots import error_against_poses, knee

COUNTS = np.arange(4, 31)


class TestKnee:
    def test_the_law_of_repeated_poses(self):
        """1 − √(N/(N + 1)) < share first at 10 for 5 %, at 25 for 2 %."""
        assert knee(COUNTS, 1 / np.sqrt(COUNTS)) == 10
        assert knee(COUNTS, 1 / np.sqrt(COUNTS), 0.02) == 25

    @pytest.mark.parametrize(
        ("errors", "found"),
        [
            ([8.0, 4.0, 2.0, 1.0], None),  # still falling
            ([8.0, 4.0, 2.0, 1.99], 6),
            ([8.0, 7.9, 7.8, 7.7], 4),  # the first is enough
            ([8.0, 7.9, 4.0, 3.99], 6),  # a step that helps, after one that does not
            ([8.0, 9.0, 10.0, 11.0], 4),
            ([np.inf, np.inf, 4.0, 3.99], 6),
            ([np.inf, np.inf, np.inf, np.inf], None),
            ([np.inf, 4.0, 4.0, 4.0], 5),
            ([np.inf, np.inf, np.inf, 4.0], None),
        ],
    )
    def test_known_sequences(self, errors, found):
        assert knee([4, 5, 6, 7], errors) == found

    def test_gaps_between_counts_count_pose_by_pose(self):
        """A fall of 15 % over five poses is 3.2 % a pose."""
        assert knee([5, 10, 15], [1.0, 0.85, 0.84]) == 5
        assert knee([5, 6, 7], [1.0, 0.85, 0.84]) == 6

    @given(st.lists(st.floats(1e-3, 1e3), min_size=2, max_size=12), st.floats(0.01, 0.5))
    def test_it_is_the_definition(self, errors, share):
        """Each later step gains less than the share, and the step before gains at least as much."""
        counts = np.arange(3, 3 + len(errors))
        gains = 1 - np.array(errors[1:]) / np.array(errors[:-1])
        if (np.abs(gains - share) < 1e-9).any():
            return
        first = knee(counts, errors, share)
        place = len(errors) - 1 if first is None else first - 3
        assert (gains[place:] < share).all()
        assert place == 0 or gains[place - 1] >= share

    @pytest.mark.parametrize(
        ("counts", "errors", "share", "message"),
        [
            ([4, 4], [1.0, 1.0], 0.05, "counts: expected ascending"),
            ([4, 5.5], [1.0, 1.0], 0.05, "counts: expected ascending"),
            ([0, 5], [1.0, 1.0], 0.05, "counts: expected ascending"),
            ([4, 5], [1.0], 0.05, "expected two or more of both"),
            ([4], [1.0], 0.05, "expected two or more of both"),
            ([4, 5], [1.0, np.nan], 0.05, "errors: expected values > 0"),
            ([4, 5], [1.0, 0.0], 0.05, "errors: expected values > 0"),
            ([4, 5], [1.0, 0.9], 5, r"share: expected a share in \(0, 1\)"),
            ([4, 5], [1.0, 0.9], "x", r"share: expected a share in \(0, 1\), such as 0.05, got 'x'"),
            ([4, 5], ["a", "b"], 0.05, r"errors: expected numbers, got \['a', 'b'\]"),
            ([4, 5], [1.0, [2.0, 3.0]], 0.05, "errors: expected numbers"),
        ],
    )
    def test_bad_input(self, counts, errors, share, message):
        with pytest.raises(InputError, match=message):
            knee(counts, errors, share)


def curves(ax):
    """Return the lines by label."""
    return {line.get_label(): line for line in ax.lines}


class TestErrorAgainstPoses:
    def test_designs(self, design_of):
        designs = [design_of(np.arange(n)) for n in (12, 5, 8, 20)]
        ax = error_against_poses(designs)
        found = curves(ax)
        n = [5, 8, 12, 20]
        ordered = sorted(designs, key=lambda design: len(design.indices))
        np.testing.assert_array_equal(found["base_point"].get_xdata(), n)
        base = [np.linalg.norm(design.standard_errors[3:]) for design in ordered]
        np.testing.assert_allclose(found["base_point"].get_ydata(), base)
        total = np.sqrt([design.value for design in ordered])
        np.testing.assert_allclose(found["all together"].get_ydata(), total)
        np.testing.assert_allclose(found["bound: no choice is better"].get_ydata(), np.sqrt(0.9) * total)
        reference = found["as 1/√N"].get_ydata()
        np.testing.assert_allclose(reference * np.sqrt(n), total[-1] * np.sqrt(20))
        assert ax.get_ylabel() == "predicted error (cm)"
        assert ax.get_xlabel() == "poses, N"

    def test_no_bound_where_the_criterion_is_another(self, design_of):
        found = curves(error_against_poses([design_of(np.arange(n), "D") for n in (5, 8, 12)]))
        named = {label for label in found if not label.startswith("_")}  # matplotlib's own are of lines without one
        assert named == {"as 1/√N", "base_point", "platform_point"}

    def test_the_knee_is_marked(self):
        ax = error_against_poses(COUNTS, {"a": 3 / np.sqrt(COUNTS), "b": 1 / np.sqrt(COUNTS)}, unit="mm")
        assert ax.lines[-1].get_xdata()[0] == 10
        assert ax.get_title(loc="left") == "From 10 poses on, one more gains less than 5 %"
        assert ax.get_ylabel() == "predicted error (mm)"

    def test_a_knee_at_the_first_number_is_no_place_to_begin_from(self):
        ax = error_against_poses([4, 5, 6], {"a": [8.0, 7.9, 7.8]})
        assert ax.get_title(loc="left") == "One more pose gains less than 5 % at all of these numbers"
        assert len(ax.lines) == 2  # no vertical one

    def test_where_others_were_measured_before_only_new_ones_count(self, design_of, pool):
        before = hx.loops.FixedDirection(pool.leg(3).poses(slice(8)))
        designs = [design_of(np.arange(n)) for n in (5, 8, 12)]
        designs = [replace(one, question=replace(one.question, measured=before)) for one in designs]
        for ax in (error_against_poses(designs), error_against_poses([5, 8], {"a": [2.0, 1.0]}, new=True)):
            assert ax.get_xlabel() == "new poses, N"
            assert ax.get_title(loc="left").startswith("Up to ")
            assert " new poses, one more gains" in ax.get_title(loc="left")
            assert "as 1/√N" not in curves(ax)

    def test_no_knee_yet(self):
        ax = error_against_poses([4, 5, 6], {"a": [8.0, 4.0, 2.0]}, share=0.1)
        assert ax.get_title(loc="left") == "Up to 6 poses, one more gains 10 % or more"
        assert len(ax.lines) == 2  # no vertical one

    def test_too_few_poses_are_left_out(self):
        ax = error_against_poses([3, 4, 5, 6], {"a": [np.inf, 4.0, 3.99, 3.98]}, bound=[0.1, 3.0, 3.0, 3.0])
        assert ax.get_title(loc="left").startswith("From 4 poses on")
        ax.figure.canvas.draw()
        assert np.isfinite(ax.get_ylim()).all()

    def test_different_units_stand_at_their_curves(self, design_of):
        units = ("cm",) * 3 + ("mm",) * 3
        ax = error_against_poses([replace(design_of(np.arange(n)), units=units) for n in (5, 8, 12)])
        labels = [text.get_text() for text in ax.get_legend().texts]
        assert labels == ["platform_point (cm)", "base_point (mm)", "as 1/√N"]
        assert ax.get_ylabel() == "predicted error (each in its unit)"

    def test_bad_input(self, design_of):
        with pytest.raises(InputError, match="expected a list of designs"):
            error_against_poses(design_of(np.arange(5)))
        with pytest.raises(InputError, match="expected a list of designs"):
            error_against_poses([4, 5, 6])
        with pytest.raises(InputError, match="counts: expected ascending"):
            error_against_poses([design_of(np.arange(5))] * 2)
        other = replace(design_of(np.arange(6)), labels=tuple("abcdef"))
        with pytest.raises(InputError, match="different parameters"):
            error_against_poses([design_of(np.arange(5)), other])
        with pytest.raises(InputError, match="one error > 0 for each of the 3 counts"):
            error_against_poses([4, 5, 6], {"a": [1.0, 2.0]})
        with pytest.raises(InputError, match="one error > 0 for each of the 3 counts"):
            error_against_poses([4, 5, 6], {"a": [1.0, 2.0, -1.0]})
        with pytest.raises(InputError, match="one error > 0"):
            error_against_poses([4, 5, 6], {})
        with pytest.raises(InputError, match=r"errors: expected a dict of errors by block, got \[2.0, 1.0, 0.9\]"):
            error_against_poses([3, 4, 5], [2.0, 1.0, 0.9])
        with pytest.raises(InputError, match="errors: expected numbers, got 'a'"):
            error_against_poses([3, 4, 5], {"a": "a"})
        with pytest.raises(InputError, match="ax: expected flat axes"):
            error_against_poses([4, 5], {"a": [2.0, 1.0]}, ax=hx.plots.hexapod(hx.robots.left_hand()))
