"""Confidence ellipses: their axes, their orientation, and that they hold 95 % of draws."""

from dataclasses import replace
from itertools import pairwise

import matplotlib.pyplot as plt
import numpy as np
import pytest
from matplotlib.patches import Ellipse
from scipy.stats import chi2

from hexopt.errors import InputError
from hexopt.plots import error_ellipsoids

PLANES = [(0, 1), (0, 2), (1, 2)]


@pytest.fixture
def covariance():
    root = np.random.default_rng(3).standard_normal((3, 5))
    return root @ root.T


def ellipses(figure):
    """Return the ellipses of each plane."""
    return [[one for one in ax.patches if isinstance(one, Ellipse)] for ax in figure.axes]


def test_semi_axes_are_roots_of_eigenvalues_times_the_quantile(covariance):
    for (one,), plane in zip(ellipses(error_ellipsoids([covariance])), PLANES, strict=True):
        values = np.linalg.eigvalsh(covariance[np.ix_(plane, plane)])
        semi = np.sort([one.get_width(), one.get_height()]) / 2
        np.testing.assert_allclose(semi, np.sqrt(values * chi2(2).ppf(0.95)))


@pytest.mark.parametrize("level", [0.5, 0.95])
def test_points_on_the_ellipse_have_the_quantile(covariance, level):
    """By another route: the drawn outline in data coordinates."""
    for (one,), plane in zip(ellipses(error_ellipsoids([covariance], level=level)), PLANES, strict=True):
        inverse = np.linalg.inv(covariance[np.ix_(plane, plane)])
        corners = one.get_patch_transform().transform([[1, 0], [0, 1], [-1, 0], [0.6, 0.8]])
        distance = np.einsum("ni,ij,nj->n", corners, inverse, corners)
        np.testing.assert_allclose(1 - np.exp(-distance / 2), level)


def test_they_hold_their_share_of_draws(covariance):
    draws = np.random.default_rng(0).multivariate_normal(np.zeros(3), covariance, 4000)
    for (one,), plane in zip(ellipses(error_ellipsoids([covariance], level=0.9)), PLANES, strict=True):
        inside = one.get_patch_transform().inverted().transform(draws[:, plane])
        share = (np.square(inside).sum(axis=1) <= 1).mean()
        assert abs(share - 0.9) < 4 * np.sqrt(0.09 / 4000)


def test_designs_take_the_point_that_is_named(design_of):
    designs = [design_of(np.arange(6)), design_of(np.arange(12))]
    for which, place in (("platform_point", slice(0, 3)), ("base_point", slice(3, 6))):
        figure = error_ellipsoids(designs, which=which)
        bare = error_ellipsoids([one.covariance[place, place] for one in designs])
        for ours, theirs in zip(ellipses(figure), ellipses(bare), strict=True):
            assert [one.get_width() for one in ours] == [one.get_width() for one in theirs]
        assert [ax.get_xlabel() for ax in figure.axes] == ["x (cm)", "x (cm)", "y (cm)"]
        assert [ax.get_ylabel() for ax in figure.axes] == ["y (cm)", "z (cm)", "z (cm)"]
    assert [text.get_text() for text in figure.legends[0].texts] == ["A, 6 poses", "A, 12 poses"]
    assert figure.get_suptitle() == "base_point: regions of 95 % probability"


def test_designs_differ_in_colour_and_style_and_fit(covariance):
    figure = error_ellipsoids([covariance, 4 * covariance], ["chosen", "random"], unit="um")
    for ax, pair in zip(figure.axes, ellipses(figure), strict=True):
        assert len({one.get_edgecolor() for one in pair}) == len({one.get_linestyle() for one in pair}) == 2
        assert ax.get_aspect() == 1
        outline = np.vstack([one.get_verts() for one in pair])
        limits = ax.transData.transform([[ax.get_xlim()[0], ax.get_ylim()[0]], [ax.get_xlim()[1], ax.get_ylim()[1]]])
        assert (outline > limits[0]).all()
        assert (outline < limits[1]).all()
        assert ax.get_xlabel().endswith("(µm)")


def test_one_design_needs_no_list(design_of):
    design = design_of(np.arange(6))
    for one, listed in zip(ellipses(error_ellipsoids(design)), ellipses(error_ellipsoids([design])), strict=True):
        assert one[0].get_width() == listed[0].get_width()


@pytest.mark.parametrize("size", [3e-4, 0.05, 4.0, 12_000.0, 7e5])
def test_numbers_on_the_axes_stand_apart(size):
    figure = error_ellipsoids([np.diag([size, size / 2, size / 3]) ** 2 / 6], unit="um")
    figure.canvas.draw()
    for ax in figure.axes:
        boxes = [label.get_window_extent() for label in ax.get_xticklabels()]
        assert len(boxes) >= 3
        assert all(one.x1 + 2 < two.x0 for one, two in pairwise(boxes))


def test_bad_input(design_of):
    design = design_of(np.arange(6))
    with pytest.raises(InputError, match=r"which: no point 'base'; this design has platform_point\.x"):
        error_ellipsoids([design], which="base")
    with pytest.raises(InputError, match=r"covariance: expected shape \(3, 3\)"):
        error_ellipsoids([np.eye(2)])
    with pytest.raises(InputError, match="NaN or infinite"):
        error_ellipsoids([np.diag([1.0, 1.0, np.inf])])
    with pytest.raises(InputError, match="positive definite"):
        error_ellipsoids([np.diag([1.0, 1.0, 0.0])])
    with pytest.raises(InputError, match="positive definite"):
        error_ellipsoids([np.eye(3) + np.eye(3, k=1) / 2])
    with pytest.raises(InputError, match="different units, cm, mm"):
        error_ellipsoids([design, replace(design, units=("mm",) * 6)])
    with pytest.raises(InputError, match="labels: expected 1, one a design, got 2"):
        error_ellipsoids([design], ["a", "b"])
    for designs in ([], None, 3):
        with pytest.raises(InputError, match=r"designs: expected one or more designs, or covariances \(3, 3\)"):
            error_ellipsoids(designs)
    for level in (95, "x"):
        with pytest.raises(InputError, match=r"level: expected a probability in \(0, 1\)"):
            error_ellipsoids([design], level=level)
    assert not plt.get_fignums()  # what is refused leaves no figure behind
