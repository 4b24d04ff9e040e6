"""What the tests share: a reproducible hypothesis profile, robots, noise, central differences."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import HealthCheck, settings
from threadpoolctl import threadpool_limits

import hexopt as hx
from hexopt.robots import BUILT_IN

settings.register_profile(
    "ci", deadline=None, derandomize=True, max_examples=60, suppress_health_check=[HealthCheck.too_slow]
)
settings.register_profile("thorough", deadline=None, max_examples=2000)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "ci"))

#: The errors of the paper: 0.01 cm, 0.01 degree.
PAPER_NOISE = {"position": 0.01, "angle": np.deg2rad(0.01), "length": 0.01}


class Figures:
    """A plugin, so for doctests too: what a test draws is closed behind it; pyplot bears twenty figures in peace."""

    @pytest.fixture(autouse=True)
    def _closed(self):
        yield
        if "matplotlib.pyplot" in sys.modules:
            sys.modules["matplotlib.pyplot"].close("all")


def pytest_configure(config):
    """Pin BLAS to one thread: more of them make small problems up to forty times slower when the machine is busy."""
    config.pluginmanager.register(Figures())
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")  # for libraries that are loaded later
    threadpool_limits(1)


@pytest.fixture
def left_hand():
    return hx.robots.left_hand()


@pytest.fixture(params=sorted(BUILT_IN))
def robot(request):
    """Every built-in robot."""
    return BUILT_IN[request.param]()


@pytest.fixture
def paper_noise():
    return hx.UniformNoise(**PAPER_NOISE)


@pytest.fixture
def small_noise():
    """Normal errors so small that first-order statistics hold, the same in every frame."""
    return hx.NormalNoise(1e-3, np.deg2rad(1e-3), 1e-3, coordinates="rotation_vector")


@pytest.fixture(scope="session")
def real_data():
    """The folder of real measurements that HEXOPT_REAL_DATA names."""
    folder = os.environ.get("HEXOPT_REAL_DATA")
    if not folder:
        pytest.skip("HEXOPT_REAL_DATA does not name a folder with real measurements")
    return Path(folder)


@pytest.fixture
def central_difference():
    """Return a function: the derivative of f at x, on new last axes, by a five-point stencil."""

    def derivative(f, x, step=1e-3):
        x = np.asarray(x, dtype=float)
        columns = []
        for index in np.ndindex(x.shape):
            e = np.zeros(x.shape)
            e[index] = step
            near, far = f(x + e) - f(x - e), f(x + 2 * e) - f(x - 2 * e)
            columns.append((8 * near - far) / (12 * step))
        return np.stack(columns, axis=-1)

    return derivative
