"""Singular values, standard errors, correlations and leverages, as they are drawn."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError
from hexopt.plots import correlation, leverage, singular_values, standard_errors


@pytest.fixture
def blind(pool):
    """Two poses: nothing of the points is determined."""
    return hx.observability(hx.loops.FixedDirection(pool.leg(3).poses([0, 1])))


class TestSingularValues:
    def test_both_kinds(self, observed):
        ax = singular_values(observed)
        everything, main = ax.lines
        np.testing.assert_array_equal(everything.get_ydata(), observed.singular_values)
        np.testing.assert_array_equal(main.get_ydata(), observed.main_singular_values)
        assert main.get_label() == f"nuisances eliminated: condition number {observed.main_condition:.3g}"
        assert ax.get_yscale() == "log"
        assert "no unit" in ax.get_ylabel()

    def test_without_nuisances_one_is_enough(self, pool):
        seen = hx.observability(hx.loops.LegLength(pool.leg(3)))
        assert len(singular_values(seen).lines) == 1

    def test_what_is_not_seen(self, blind):
        ax = singular_values(blind)
        crosses = [line for line in ax.lines if line.get_marker() == "X"]
        assert [len(line.get_xdata()) for line in crosses] == [2, 2]
        assert crosses[0].get_ydata()[0] < blind.singular_values[blind.singular_values > 0].min()
        assert all(line.get_label().endswith("2 not seen (×)") for line in ax.lines if line not in crosses)


class TestStandardErrors:
    def test_a_bar_for_each_parameter(self, observed):
        ax = standard_errors(observed)
        np.testing.assert_allclose([bar.get_width() for bar in ax.patches], observed.standard_errors)
        assert [text.get_text() for text in ax.get_yticklabels()] == list(observed.labels)
        texts = [text.get_text() for text in ax.texts]
        assert texts == [f"{error:.3g} cm" for error in observed.standard_errors]
        assert ax.get_xlabel() == "predicted standard error (cm)"
        colours = [bar.get_facecolor() for bar in ax.patches]
        hatches = [bar.get_hatch() for bar in ax.patches]
        assert len(set(colours[:3])) == len(set(colours[3:])) == 1
        assert colours[0] != colours[3]
        assert hatches[0] != hatches[3]
        low, high = ax.get_ylim()
        assert low > high  # the first parameter stands on top

    def test_a_design(self, design_of):
        design = design_of(np.arange(8))
        found = [bar.get_width() for bar in standard_errors(design).patches]
        np.testing.assert_allclose(found, design.standard_errors)

    def test_several_units(self, pool, left_hand):
        data = hx.simulate(left_hand, "none", 12, noise=pool.noise, nominal=left_hand, rng=0)
        names = ("platform_point", "base_point", "offset", "gain")
        seen = hx.observability(hx.loops.WholeRobot(data, unknown=names))
        ax = standard_errors(seen)
        assert ax.get_xscale() == "log"
        assert ax.get_xlabel() == "predicted standard error, each in its unit"
        assert [text.get_text().split(" ")[1] for text in ax.texts] == list(seen.units)
        per_block = {
            label.split(".")[1]: bar.get_facecolor() for label, bar in zip(seen.labels, ax.patches, strict=True)
        }
        assert len(set(per_block.values())) == 4  # the same for every leg
        assert len({bar.get_facecolor() for bar in ax.patches}) == 4

    def test_what_is_not_seen_says_so(self, blind):
        ax = standard_errors(blind)
        assert not ax.patches
        assert [text.get_text() for text in ax.texts] == ["not seen by these poses"] * 6

    def test_what_is_hardly_seen_says_so(self, observed):
        variance = np.where(np.arange(6) == 4, 1e6, 1.0)
        doubtful = replace(observed, covariance=np.diag(variance), limits=np.full(6, 100.0))
        ax = standard_errors(doubtful)
        assert ax.texts[4].get_text() == "1e+03 cm, as good as not seen"
        assert ax.texts[3].get_text() == "1 cm"
        assert ax.get_xscale() == "log"

    def test_a_caveat_stands_in_the_title(self, left_hand):
        problem = hx.loops.FixedDirection(hx.simulate_leg(left_hand, 3, "direction", 7, rng=0)).linear()
        title = standard_errors(hx.observability(problem)).get_title(loc="left")
        assert "the noise is unknown" in title.replace("\n", " ")


class TestCorrelation:
    def test_the_matrix(self, observed):
        ax = correlation(observed)
        np.testing.assert_array_equal(ax.images[0].get_array(), observed.correlation)
        assert ax.images[0].get_clim() == (-1, 1)
        assert [text.get_text() for text in ax.get_xticklabels()] == list(observed.labels)
        assert [text.get_text() for text in ax.get_yticklabels()] == list(observed.labels)
        assert int(ax.texts[1].get_text().replace("−", "-")) == round(100 * observed.correlation[0, 1])

    def test_large_ones_have_no_numbers(self, pool):
        seen = hx.observability(hx.loops.WholeRobot(pool.poses(slice(12))))
        ax = correlation(seen)
        assert len(seen.labels) > 14
        assert not ax.texts

    def test_what_is_not_seen_is_grey(self, blind):
        ax = correlation(blind)
        assert ax.images[0].get_array().mask.all()
        assert {text.get_text() for text in ax.texts} == {"–"}


class TestLeverage:
    def test_bars_and_mean(self, observed):
        ax = leverage(observed)
        found = sorted((bar.get_x() + bar.get_width() / 2, bar.get_height()) for bar in ax.patches)
        np.testing.assert_allclose([x for x, _ in found], np.arange(10), atol=1e-12)
        np.testing.assert_allclose([height for _, height in found], observed.leverage)
        np.testing.assert_allclose(ax.lines[0].get_ydata(), observed.leverage.mean())
        assert ax.get_xlabel() == "pose, counted from 0"
        assert "no unit" in ax.get_ylabel()

    def test_high_ones_stand_out(self, observed):
        ax = leverage(replace(observed, leverage=np.array([1.0] * 8 + [2.4, 3.2])))  # the mean is 1.36
        assert {bar.get_height(): bar.get_hatch() for bar in ax.patches} == {1.0: None, 2.4: None, 3.2: "///"}

    def test_of_differences(self, observed):
        assert leverage(replace(observed, per="difference")).get_xlabel() == "difference, counted from 0"


@pytest.mark.parametrize("draw", [singular_values, standard_errors, correlation, leverage])
def test_something_else_is_refused(draw, pool):
    with pytest.raises(InputError, match=r"expected what observability\(loop\) returns, got <hexopt.loops"):
        draw(hx.loops.FixedDirection(pool.leg(3)))


@pytest.mark.parametrize("draw", [singular_values, standard_errors, correlation, leverage])
def test_they_draw_where_they_are_told(draw, observed):
    ax = plt.figure().add_subplot()
    assert draw(observed, ax) is ax
    assert len(plt.get_fignums()) == 1
