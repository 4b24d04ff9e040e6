"""The form that takes every pose against the first of its set."""

import numpy as np
import pytest

from hexopt.estimators.local_fit import AgainstFirst


@pytest.mark.parametrize("counts", [(5,), (3, 2), (4, 1, 3)])
@pytest.mark.parametrize("batch", [(), (2,)])
def test_it_is_a_matrix_on_the_poses(counts, batch):
    n, d, c = sum(counts), 2, 3
    rows = np.random.default_rng(0).normal(size=(*batch, n, d, c))
    blocks, first = [], 0
    for count in counts:
        block = np.zeros((count - 1, n))
        block[:, first] = -1
        block[:, first + 1 : first + count] = np.eye(count - 1)
        blocks.append(block)
        first += count
    matrix = np.concatenate(blocks)
    form = AgainstFirst(counts)
    np.testing.assert_allclose(form.apply(rows), np.einsum("kn,...ndc->...kdc", matrix, rows), atol=1e-14)
    back = np.random.default_rng(1).normal(size=(*batch, len(matrix), d, c))
    np.testing.assert_allclose(form.adjoint(back), np.einsum("kn,...kdc->...ndc", matrix, back), atol=1e-14)
    squares = np.einsum("...ndc->...nc", rows**2)
    np.testing.assert_allclose(form.before(squares), np.einsum("kn,...nc->...c", matrix**2, squares), rtol=1e-13)
