"""The hexapod and its poses in space: what is drawn where, labels, and what is refused."""

from dataclasses import replace

import matplotlib.pyplot as plt
import numpy as np
import pytest
from mpl_toolkits.mplot3d.art3d import Line3D, Path3DCollection, Poly3DCollection

import hexopt as hx
from hexopt.errors import InputError, UnitError
from hexopt.rotations import euler_to_matrix

PLACE, TURN = np.array([1.0, -2.0, 20.0]), euler_to_matrix([0.2, -0.1, 0.3], "xyz")


def segments(ax):
    """Return the ends of every line, (n, 2, 3)."""
    return np.array([np.transpose(line.get_data_3d()) for line in ax.lines if isinstance(line, Line3D)])


def polygons(ax):
    """Return the corners of every polygon, (n, 6, 3), each twice: face and edge."""
    found = [one for one in ax.collections if isinstance(one, Poly3DCollection)]
    return np.array([np.asarray(one._faces)[0] for one in found])


def inside(ax, points):
    limits = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    return bool(((points > limits[:, 0]) & (points < limits[:, 1])).all())


class TestHexapod:
    def test_six_legs_join_the_joints(self, robot):
        ax = hx.plots.hexapod(robot, robot.home_position, TURN)
        ends = robot.home_position + robot.platform_points @ TURN.T
        np.testing.assert_allclose(segments(ax), np.stack([robot.base_points, ends], axis=1))
        assert sorted(text.get_text() for text in ax.texts) == list("123456")
        assert inside(ax, ends)
        assert inside(ax, robot.base_points)

    def test_the_default_is_home(self, left_hand):
        default, home = (
            segments(hx.plots.hexapod(left_hand)),
            segments(hx.plots.hexapod(left_hand, left_hand.home_position, left_hand.home_rotation)),
        )
        np.testing.assert_array_equal(default, home)

    def test_base_and_platform_are_simple_polygons(self, left_hand):
        """Joined around their centre: no edge is longer than the largest of the hexagon in order."""
        shuffled = [0, 3, 1, 5, 2, 4]
        mixed = hx.Hexapod(
            "mixed", left_hand.base_points[shuffled], left_hand.platform_points[shuffled], home_position=[0, 0, 19]
        )
        for robot in (left_hand, mixed):
            for corners in polygons(hx.plots.hexapod(robot)):
                edges = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
                platform = corners[0, 2] > 1
                known = left_hand.platform_points if platform else left_hand.base_points
                want = np.linalg.norm(np.roll(known, -1, axis=0) - known, axis=1)
                np.testing.assert_allclose(sorted(edges), sorted(want))

    def test_the_scale_is_the_same_on_all_axes(self, robot):
        ax = hx.plots.hexapod(robot)
        widths = np.ptp([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()], axis=1)
        scale = ax._box_aspect / widths
        np.testing.assert_allclose(scale, scale[0])

    def test_the_locked_leg_stands_out(self, left_hand):
        ax = hx.plots.hexapod(left_hand, leg=5)
        colours = [line.get_color() for line in ax.lines]
        widths = [line.get_linewidth() for line in ax.lines]
        assert len({colour for k, colour in enumerate(colours, 1) if k != 5}) == 1
        assert colours[4] != colours[0]
        assert widths[4] > widths[0]
        assert [text.get_text() for text in ax.get_legend().texts] == ["leg 5, locked"]
        assert hx.plots.hexapod(left_hand).get_legend() is None

    @pytest.mark.parametrize(
        ("name", "label", "tick"),
        [
            ("left_hand", "x (cm)", "8"),
            ("rubin", "x (10⁵ µm)", "4"),
            ("linuxcnc", "x", "15"),
            ("jugglebot", "x (mm)", "250"),
        ],
    )
    def test_labels_have_units(self, name, label, tick):
        ax = hx.plots.hexapod(getattr(hx.robots, name)())
        ax.figure.canvas.draw()
        assert ax.get_xlabel() == label
        assert (ax.get_ylabel(), ax.get_zlabel()) == (label.replace("x", "y"), label.replace("x", "z"))
        assert tick in [text.get_text() for text in ax.get_xticklabels()]

    def test_it_draws_where_it_is_told(self, left_hand):
        ax = plt.figure().add_subplot(projection="3d")
        assert hx.plots.hexapod(left_hand, ax=ax) is ax
        assert len(plt.get_fignums()) == 1

    @pytest.mark.parametrize(
        ("arguments", "message"),
        [
            ({"position": [1.0, 2.0]}, r"position: expected shape \(3\)"),
            ({"rotation": 2 * np.eye(3)}, "rotation"),
            ({"leg": 7}, "leg: expected a number from 1 to 6"),
            ({"ax": "here"}, "axes in space, got str; make them with figure.add_subplot"),
        ],
    )
    def test_bad_input(self, left_hand, arguments, message):
        with pytest.raises(InputError, match=message):
            hx.plots.hexapod(left_hand, **arguments)

    def test_no_robot(self, pool):
        with pytest.raises(InputError, match="robot: expected a Hexapod, got NoneType"):
            hx.plots.hexapod(None)
        for draw in (hx.plots.poses, hx.plots.pose_gallery):
            with pytest.raises(InputError, match="robot: expected a Hexapod, got NoneType"):
                draw(None, pool)

    def test_flat_axes_are_refused(self, left_hand):
        with pytest.raises(InputError, match="axes in space, got Axes"):
            hx.plots.hexapod(left_hand, ax=plt.figure().add_subplot())


class TestPoses:
    def dots(self, ax):
        """Return the positions of candidates and of chosen poses."""
        found = [one for one in ax.collections if isinstance(one, Path3DCollection)]
        points = [np.ma.getdata(one._offsets3d).T for one in found]
        return [one for one in points if len(one)]

    def test_candidates_and_chosen(self, left_hand, pool):
        chosen = [150, 3, 77]
        ax = hx.plots.poses(left_hand, pool, chosen)
        rest, picked = self.dots(ax)
        assert len(rest) == 197
        np.testing.assert_allclose(picked, pool.position[chosen])
        platforms = polygons(ax)[4:][::2]
        ends = pool.position[:, None] + left_hand.platform_points @ np.swapaxes(pool.rotation, -1, -2)
        for corners, index in zip(platforms, chosen, strict=True):
            np.testing.assert_allclose(np.sort(corners, axis=0), np.sort(ends[index], axis=0))
        assert inside(ax, ends[chosen].reshape(-1, 3))
        assert inside(ax, pool.position)
        assert ax.get_xlabel() == "x (cm)"

    def test_the_locked_leg_of_every_pose(self, left_hand, pool):
        """Six legs at home and the third of each chosen pose."""
        ax = hx.plots.poses(left_hand, pool, [0, 1])
        lines = segments(ax)
        assert len(lines) == 8
        ends = pool.position[:2] + pool.rotation[:2] @ left_hand.platform_points[2]
        np.testing.assert_allclose(lines[6:], [[left_hand.base_points[2], end] for end in ends])
        other = segments(hx.plots.poses(left_hand, pool, [0, 1], leg=6))
        np.testing.assert_allclose(other[6:, 0], [left_hand.base_points[5]] * 2)

    def test_a_design_two_ways(self, left_hand, pool, design_of):
        design = design_of([5, 60, 61, 62])
        alone, among = hx.plots.poses(left_hand, design), hx.plots.poses(left_hand, pool, design)
        np.testing.assert_array_equal(self.dots(alone)[0], self.dots(among)[1])
        assert alone.get_title(loc="left") == "Left Hand: 4 poses"
        assert among.get_title(loc="left") == "Left Hand: 4 of 200 poses"

    def test_a_design_over_several_sets(self, left_hand, pool, design_of):
        sets = pool.leg(3).poses([1, 2]), hx.simulate_leg(left_hand, 4, "leg", 1, nominal=left_hand, rng=0)
        ax = hx.plots.poses(left_hand, replace(design_of([1, 2, 3, 4]), poses=sets))
        assert len(self.dots(ax)[0]) == 3
        np.testing.assert_allclose(segments(ax)[6:, 0], left_hand.base_points[[2, 2, 3]])
        assert [text.get_text() for text in ax.get_legend().texts] == ["chosen, 1 (dark) to 3 (light)"]

    def test_only_the_first_have_platforms(self, left_hand, pool):
        ax = hx.plots.poses(left_hand, pool, range(10), most=4)
        assert len(polygons(ax)) == 2 * (2 + 4)
        assert len(self.dots(ax)[1]) == 10
        numbers = ", ".join(text.get_text() for text in ax.texts).split(", ")
        assert sorted(numbers) == ["1", "2", "3", "4"]

    def test_a_pose_that_is_measured_twice_has_two_numbers(self, left_hand, pool):
        ax = hx.plots.poses(left_hand, pool, [7, 7])
        assert [text.get_text() for text in ax.texts] == ["1, 2"]

    def test_many_candidates_are_thinned(self, left_hand, pool):
        many = pool.poses(np.arange(12_000) % 200)
        rest = self.dots(hx.plots.poses(left_hand, many, [0]))[0]
        assert 2500 <= len(rest) <= 5000

    def test_units_are_turned_into_the_robots(self, left_hand):
        in_mm = hx.LegMeasurements([[0.0, 0.0, 190.0]], [np.eye(3)], None, "none", length_unit="mm")
        np.testing.assert_allclose(self.dots(hx.plots.poses(left_hand, in_mm))[0], [[0, 0, 19]])

    def test_unstated_units_are_refused(self, left_hand):
        with pytest.raises(UnitError, match="cannot convert 'unstated'"):
            hx.plots.poses(left_hand, hx.LegMeasurements([[0.0, 0.0, 190.0]], [np.eye(3)], None, "none"))

    @pytest.mark.parametrize(
        ("chosen", "message"),
        [
            ([0, 200], r"chosen: there are 200 poses, 0…199; got 0…200"),
            ([-1], "chosen: there are 200 poses"),
            ([], "chosen: expected a design or indices"),
            ([0.5], "chosen: expected a design or indices"),
            ([True, False], "chosen: expected a design or indices"),
        ],
    )
    def test_bad_choices(self, left_hand, pool, chosen, message):
        with pytest.raises(InputError, match=message):
            hx.plots.poses(left_hand, pool, chosen)

    def test_bad_poses(self, left_hand, pool, design_of):
        with pytest.raises(InputError, match="poses: expected LegMeasurements, Measurements or a Design, got 'all'"):
            hx.plots.poses(left_hand, "all")
        with pytest.raises(InputError, match="or a Design, got None"):
            hx.plots.poses(left_hand, None)
        with pytest.raises(InputError, match=r"got a batch of \(3,\)"):
            hx.plots.poses(left_hand, hx.simulate_leg(left_hand, 3, "leg", 5, n_sets=3, rng=0))
        with pytest.raises(InputError, match="bare information"):
            hx.plots.poses(left_hand, replace(design_of([1, 2, 3, 4]), poses=None))
        with pytest.raises(InputError, match="most: expected a whole number >= 1"):
            hx.plots.poses(left_hand, pool, [0], most=0)
