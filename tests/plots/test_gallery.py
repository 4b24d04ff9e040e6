"""The sheet of poses: one picture a pose, titled with what a controller is told."""

import re

import numpy as np
import pytest

import hexopt as hx
from hexopt.errors import InputError
from hexopt.rotations import euler_to_matrix


def numbers(text):
    return [float(value) for value in re.findall(r"-?\d+\.?\d*", text.replace("−", "-"))]


def titles(figure):
    return [ax.get_title(loc="left").split("\n") for ax in figure.axes]


def test_titles_say_the_poses(left_hand, pool, design_of):
    index = [4, 30, 30, 99, 150]
    figure = hx.plots.pose_gallery(left_hand, design_of(index))
    assert [title[0] for title in titles(figure)] == [f"{i} · candidate {j}" for i, j in enumerate(index, start=1)]
    for (_, place, angles), i in zip(titles(figure), index, strict=True):
        np.testing.assert_allclose(numbers(place), pool.position[i], atol=5.01e-4)
        assert place.endswith(") cm")
        turn = euler_to_matrix(np.deg2rad(numbers(angles)), left_hand.limits.sequence)
        np.testing.assert_allclose(turn, pool.rotation[i], atol=np.deg2rad(1e-3))
    assert figure.get_suptitle() == "Left Hand: 5 poses, leg 3 locked; angles xyz"


def test_another_sequence(left_hand, pool):
    figure = hx.plots.pose_gallery(left_hand, pool.poses([8]), sequence="ZXZ")
    _, _, angles = titles(figure)[0]
    np.testing.assert_allclose(
        euler_to_matrix(np.deg2rad(numbers(angles)), "ZXZ"), pool.rotation[8], atol=np.deg2rad(2e-3)
    )
    with pytest.raises(InputError, match="xyq"):
        hx.plots.pose_gallery(left_hand, pool.poses([8]), sequence="xyq")


def test_all_pictures_have_the_same_scale(robot):
    data = hx.simulate(robot, "none", 6, rng=0)
    figure = hx.plots.pose_gallery(robot, data)
    assert len(figure.axes) == 6
    assert len({(*ax.get_xlim(), *ax.get_ylim(), *ax.get_zlim()) for ax in figure.axes}) == 1
    assert all(len(ax.lines) == 6 for ax in figure.axes)
    assert "locked" not in figure.get_suptitle()


def test_the_locked_leg(left_hand, pool):
    def bold(figure):
        return {text.get_text() for ax in figure.axes for text in ax.texts if text.get_fontweight() == "bold"}

    assert bold(hx.plots.pose_gallery(left_hand, pool.poses([0, 1]))) == {"3"}
    assert bold(hx.plots.pose_gallery(left_hand, pool.poses([0, 1]), leg=2)) == {"2"}
    free = hx.simulate_leg(left_hand, 3, "none", 2, nominal=left_hand, rng=0)
    assert bold(hx.plots.pose_gallery(left_hand, free)) == set()
    unknown = hx.LegMeasurements(free.position, free.rotation, None, "leg", length_unit="cm")
    assert bold(hx.plots.pose_gallery(left_hand, unknown)) == set()


def test_no_minus_zero(left_hand):
    data = hx.LegMeasurements([[-1e-9, 0.0, 19.0]], [np.eye(3)], None, "none", length_unit="cm")
    assert titles(hx.plots.pose_gallery(left_hand, data))[0][1] == "P = (0.000, 0.000, 19.000) cm"


@pytest.mark.parametrize(("columns", "n", "across"), [(4, 3, 3), (2, 3, 2), (1, 2, 1)])
def test_so_many_columns(left_hand, pool, columns, n, across):
    figure = hx.plots.pose_gallery(left_hand, pool.poses(range(n)), columns=columns)
    figure.canvas.draw()
    assert len({round(ax.get_position().x0, 3) for ax in figure.axes}) == across


def test_labels_lie_within_the_figure(robot):
    for n in (1, 4):
        figure = hx.plots.pose_gallery(robot, hx.simulate(robot, "none", n, rng=0))
        figure.canvas.draw()
        assert all(ax.zaxis.label.get_window_extent().x1 < figure.bbox.x1 for ax in figure.axes)


def test_no_columns(left_hand, pool):
    with pytest.raises(InputError, match="columns: expected a whole number >= 1, got 0"):
        hx.plots.pose_gallery(left_hand, pool.poses([0]), columns=0)
