"""What tests of designs share: small pools of poses whose designs can be counted out."""

import numpy as np
import pytest

from hexopt.information import PoseInformation


@pytest.fixture
def random_pool():
    """Return a maker of poses with random rows, by coordinates of uneven size."""

    def make(seed, n=12, m=5, k=3, rank=2, scenarios=1, fixed=0.0):
        rows = np.random.default_rng(seed).normal(size=(scenarios, n, rank, m)) * np.geomspace(1, 20, m)
        blocks = np.swapaxes(rows, -1, -2) @ rows
        before = np.broadcast_to(fixed * np.diag(np.geomspace(1, 400, m)), (scenarios, m, m))
        return PoseInformation(blocks, before, tuple(f"x.{i}" for i in range(k)), ("cm",) * k, np.ones(k))

    return make
