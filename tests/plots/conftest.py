"""What the plots' tests share: no screen, settings that stay as they were, robots' data, designs made by hand."""

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest

import hexopt as hx
from hexopt.information import pose_information
from hexopt.selection.design import Design
from hexopt.selection.question import Question, criterion_of


@pytest.fixture(autouse=True)
def drawn():
    """Draw every figure of a test to the end, without a warning; no setting of matplotlib has changed."""
    mpl.use("Agg")
    before = dict(mpl.rcParams)
    yield
    for number in plt.get_fignums():
        plt.figure(number).canvas.draw()
    plt.close("all")
    assert dict(mpl.rcParams) == before


@pytest.fixture(scope="package")
def pool():
    """200 poses of Type I that all legs reach, leg 3."""
    robot = hx.robots.left_hand()
    noise = hx.UniformNoise(0.01, np.deg2rad(0.01), 0.01)
    return hx.simulate(robot, "direction", 200, leg=3, noise=noise, nominal=robot, rng=1)


@pytest.fixture(scope="package")
def design_of(pool):
    """Return a function: the design of some of the pool's poses, with a bound of 0.9 of its value."""
    data = pool.leg(3)
    loop = hx.loops.FixedDirection(data)
    information = pose_information(loop)

    def design(indices, criterion="A"):
        index = np.asarray(indices)
        weights = np.bincount(index, minlength=200).astype(float)
        covariance = information.covariance(weights)[0]
        value = float(np.trace(covariance))
        return Design(
            indices=index,
            poses=data.poses(index),
            criterion=criterion,
            value=value,
            bound=0.9 * value,
            weights=weights,
            relaxed=0.9 * value,
            covariance=covariance,
            labels=information.labels,
            units=information.units,
            efficiency=0.9,
            proven=False,
            stopped="by hand",
            question=Question(loop, criterion_of(criterion)),
        )

    return design


@pytest.fixture(scope="package")
def observed(pool):
    """What the first ten poses see of leg 3."""
    return hx.observability(hx.loops.FixedDirection(pool.leg(3).poses(slice(10))))
