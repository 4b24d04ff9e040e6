"""The report: it holds what the designs say, and is one file that a browser can read."""

import base64
import re
from html.parser import HTMLParser

import matplotlib.pyplot as plt
import numpy as np
import pytest

import hexopt as hx

ROBOT = hx.robots.left_hand()
NOISE = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
VOID = {"meta", "img", "br", "link", "hr"}


def design_for(leg=3, lock="direction", n=5, **settings):
    pool = hx.candidates(ROBOT, leg, lock, 80, NOISE, rng=0)
    loops = {
        "direction": hx.loops.FixedDirection,
        "leg": hx.loops.FixedLeg,
        "length": hx.loops.FixedLength,
    }
    loop = hx.loops.WholeRobot(pool) if leg is None else loops[lock](pool.leg(leg))
    return hx.select_poses(loop, n, **settings)


class Reader(HTMLParser):
    """Tags that close each other, the text, the cells of every table, and the pictures."""

    def __init__(self, page):
        super().__init__()
        self.open, self.text, self.tables, self.pictures, self.links = [], "", [], [], []
        self.feed(page)
        self.close()

    def handle_starttag(self, tag, attrs):
        if tag not in VOID:
            self.open.append(tag)
        if tag == "table":
            self.tables.append([])
        if tag == "tr":
            self.tables[-1].append([])
        if tag in ("td", "th"):
            self.tables[-1][-1].append("")
        if tag == "img":
            self.pictures.append(dict(attrs))
        self.links += [value for name, value in attrs if name in ("href", "src")]

    def handle_endtag(self, tag):
        assert self.open.pop() == tag

    def handle_data(self, data):
        if {"td", "th"} & set(self.open):
            self.tables[-1][-1][-1] += data
        elif "style" not in self.open:
            self.text += data


@pytest.fixture(scope="module")
def design():
    return design_for()


@pytest.fixture
def unpictured(monkeypatch):
    """A report's text and tables alone, which is quick."""
    for name in ("space_pictures", "share_pictures", "region_pictures"):
        monkeypatch.setattr(f"hexopt.report.choice.{name}", lambda *arguments: [])

    def made(designs, rng=0):
        return hx.design_report(ROBOT, designs, counts=False, rng=rng)

    return made


@pytest.fixture(scope="module")
def page(design):
    return hx.design_report(ROBOT, design, settings={"Remark": "a < b & c"}, rng=0)


@pytest.fixture(scope="module")
def read(page):
    return Reader(page)


def test_it_is_one_well_formed_file_without_links_to_others(read):
    assert read.open == []
    assert all(link.startswith(("#", "data:image/png;base64,")) for link in read.links)


def test_its_pictures_are_there_with_words_for_who_cannot_see_them(read):
    assert len(read.pictures) == 7
    for one in read.pictures:
        data = base64.b64decode(one["src"].partition(",")[2])
        assert data.startswith(b"\x89PNG")
        assert len(one["alt"].split()) > 3


def test_figures_are_closed(design):
    before = plt.get_fignums()
    hx.design_report(ROBOT, design, counts=False, rng=0)
    assert plt.get_fignums() == before


def test_errors_are_those_of_the_design(read, design):
    heads, row = read.tables[0]
    assert heads == ["leg", *(f"{label}cm" for label in design.labels)]
    assert row == ["3", *(f"{error:.3g}" for error in design.standard_errors)]


def test_random_sets_are_worse_by_what_a_count_of_our_own_says(read, design):
    """The predicted errors of random sets, one by one through the library's public way."""
    data = design.question.sets()[0]
    rng = np.random.default_rng(5)
    found = []
    for _ in range(200):
        loop = hx.loops.FixedDirection(data.poses(rng.choice(80, 5, replace=False)))
        found.append(hx.observability(loop).standard_errors)
    expected = np.median(found, axis=0) / design.standard_errors
    ratios = np.array([float(cell.removesuffix("×")) for cell in read.tables[1][1][1:]])
    np.testing.assert_allclose(ratios, expected, rtol=0.15)


def test_poses_are_those_of_the_design_in_their_order(read, design):
    order = hx.measuring_order(ROBOT, design.poses)
    heads, *rows = read.tables[2]
    assert heads[:5] == ["pose", "candidate", "xcm", "ycm", "zcm"]
    assert [row[0] for row in rows] == ["1", "2", "3", "4", "5"]
    assert [int(row[1]) for row in rows] == list(design.indices[order])
    numbers = np.array([[float(cell.replace("−", "-")) for cell in row[2:]] for row in rows])
    position, rotation = design.poses.position[order], design.poses.rotation[order]
    np.testing.assert_allclose(numbers[:, :3], position, atol=6e-4)
    turned = hx.rotations.euler_to_matrix(np.deg2rad(numbers[:, 3:6]), "xyz")
    np.testing.assert_allclose(turned, rotation, atol=1e-3)
    np.testing.assert_allclose(numbers[:, 6:], hx.inverse_kinematics(ROBOT, position, rotation), atol=6e-4)


def test_what_was_asked_is_told(read, design):
    for words in (
        "Left Hand: 5 poses for leg 3 under the lock “direction”",
        "leg length 17.25 to 25.25 cm",
        "uniform, within ± 0.01 cm in x, y and z, 0.01° in each angle (ZXZ), 0.01 cm in a reading",
        "A: the sum of the variances",
        "Leg 3 is held at the direction (-0.2439, -0.2446, 0.9385) in all of these poses.",
        "% of the best choice of these candidates, as a ratio of variances.",
        "a < b & c",
        design.stopped,
    ):
        assert words in read.text
    share = float(re.search(r"of the best choice of these candidates, at least\s*([\d.]+) %", read.text)[1])
    assert 0 <= 100 * design.efficiency - share < 0.1


def test_the_same_seed_gives_the_same_page(design, unpictured):
    one, two, other = (unpictured(design, seed) for seed in (0, 0, 1))
    assert one == two
    assert one != other


def test_several_legs(unpictured):
    designs = [design_for(leg, "leg", 4) for leg in (1, 5)]
    read = Reader(unpictured(designs))
    assert "4 poses for each leg under the lock “leg”" in read.text
    assert [row[0] for row in read.tables[0]] == ["leg", "1", "5"]
    assert len(read.tables) == 4
    assert "Leg 5 is held at the fixed point" in read.text


def test_the_whole_robot_has_a_row_a_leg():
    design = design_for(None, "none", 9)
    read = Reader(hx.design_report(ROBOT, design, counts=False, rng=0))
    assert "Left Hand: 9 poses, none locked" in read.text
    assert [row[0] for row in read.tables[0]] == ["leg", *"123456"]
    assert read.tables[0][3][1:] == [f"{error:.3g}" for error in design.standard_errors[14:21]]


def test_refined_and_proven_designs(unpictured):
    design = design_for(3, "length", 5)
    refined = hx.refine_poses(design, ROBOT, rounds=5, rng=0)
    assert "best choice" not in Reader(unpictured(refined)).text
    proven = design_for(3, "length", 5, prove=30.0)
    assert proven.proven
    assert "The best choice of these candidates, proven." in Reader(unpictured(proven)).text


def test_poses_measured_before_and_few_that_see_nothing_alone():
    pool = hx.candidates(ROBOT, 3, "direction", 60, NOISE, rng=0).leg(3)
    before = hx.loops.FixedDirection(pool.poses(np.arange(40, 46)))
    design = hx.select_poses(hx.loops.FixedDirection(pool.poses(np.arange(40))), 1, measured=before)
    read = Reader(hx.design_report(ROBOT, design, rng=0))
    assert "1 pose for leg 3" in read.text
    assert read.text.count("from the chosen poses and what was measured before.") == 1
    assert "the number of new poses, beside what was measured before." in read.text


def test_without_noise_amounts_the_noise_is_as_given(unpictured):
    covariance = np.diag([1e-4] * 3 + [1e-8] * 3 + [1e-4])
    pool = hx.candidates(ROBOT, 3, "direction", 40, hx.NormalNoise(pose_covariance=covariance), rng=0)
    design = hx.select_poses(hx.loops.FixedDirection(pool.leg(3)), 4)
    assert "normal, of a given covariance" in unpictured(design)


@pytest.mark.parametrize(
    ("designs", "message"),
    [
        ([], "designs: expected a Design, or a list of one or more; got"),
        (None, "designs: expected a Design, or a list of one or more; got None"),
        (["A"], "designs: expected what select_poses returns, got 'A'"),
    ],
)
def test_what_is_no_design(designs, message):
    with pytest.raises(hx.InputError, match=message):
        hx.design_report(ROBOT, designs, rng=0)


def test_a_design_of_bare_information_has_no_poses(design):
    bare = hx.select_poses(design.question.objective().information, 5)
    with pytest.raises(hx.InputError, match="choices among the poses of one set"):
        hx.design_report(ROBOT, bare, rng=0)


def test_every_error_stands_under_its_parameter(unpictured):
    """Also where designs are of different parameters."""
    designs = [design_for(3), design_for(4, of=["base_point"])]
    read = Reader(unpictured(designs))
    heads, three, four = read.tables[0]
    assert heads == ["leg", *(f"{label}cm" for label in designs[0].labels)]
    assert three[1:] == [f"{error:.3g}" for error in designs[0].standard_errors]
    assert four == ["4", *"–––", *(f"{error:.3g}" for error in designs[1].standard_errors)]
    assert read.tables[1][2][:4] == ["4", *"–––"]


def test_the_whole_robot_over_a_locked_set_has_a_row_a_leg(unpictured):
    pool = hx.candidates(ROBOT, 3, "direction", 80, NOISE, rng=0)
    design = hx.select_poses(hx.loops.WholeRobot(pool, unknown=("platform_point", "base_point")), 12)
    read = Reader(unpictured(design))
    assert "12 poses under the lock “direction” of leg 3" in read.text
    assert [row[0] for row in read.tables[0]] == ["leg", *"123456"]
    assert read.tables[0][2][1:] == [f"{error:.3g}" for error in design.standard_errors[6:12]]


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"leg": 4, "lock": "leg"}, "expected one lock, got direction and leg; make a report of each"),
        ({"leg": 4, "criterion": "D"}, "expected one criterion, got A and D"),
        ({"leg": 3}, "expected each leg once, got leg 3 in two of them"),
    ],
)
def test_designs_that_differ_in_what_the_page_says_once(design, others, message):
    with pytest.raises(hx.InputError, match=message):
        hx.design_report(ROBOT, [design, design_for(**others)], rng=0)


def test_designs_with_different_noise(design):
    pool = hx.candidates(ROBOT, 4, "direction", 30, hx.UniformNoise(0.02, 1e-4, 0.01), rng=0)
    other = hx.select_poses(hx.loops.FixedDirection(pool.leg(4)), 5)
    with pytest.raises(hx.InputError, match=r"expected one noise, got uniform, within ± 0\.01 cm"):
        hx.design_report(ROBOT, [design, other], rng=0)


def test_another_robot_than_that_of_the_design(design):
    with pytest.raises(hx.UnitError, match="designs: their poses are in cm, Jugglebot is in mm; give"):
        hx.design_report(hx.robots.jugglebot(), design, rng=0)
    small = hx.Hexapod(
        "small",
        ROBOT.base_points / 2,
        ROBOT.platform_points / 2,
        home_position=ROBOT.home_position / 2,
        limits=hx.Limits(leg_length=(8.6, 12.6)),
        length_unit="cm",
    )
    with pytest.raises(hx.InputError, match=r"5 of 5 poses are far beyond the limits of small \(leg_length: 5"):
        hx.design_report(small, design, rng=0)


@pytest.mark.parametrize(
    ("settings", "message"),
    [({"robot": None}, "robot: expected a Hexapod"), ({"settings": [1]}, "settings: expected a dict of texts by name")],
)
def test_wrong_settings(design, settings, message):
    given = {"robot": ROBOT, "designs": design, "rng": 0} | settings
    with pytest.raises(hx.InputError, match=message):
        hx.design_report(**given)
