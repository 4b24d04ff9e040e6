"""Times maximum likelihood against SciPy and IPOPT, set by set, in the same run on one thread."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
from scipy.optimize import least_squares

import hexopt as hx
from studies.timing.nonlinear import ERR, Rows, race

POSES = (7, 20)
#: How many sets the peers are given.
FEW_SCIPY, FEW_IPOPT = 100, 3


def directions(n_poses: int, n_sets: int) -> hx.loops.FixedDirection:
    """Type I of leg 3 of the Left Hand."""
    robot = hx.robots.left_hand()
    noise = hx.UniformNoise(ERR, float(np.deg2rad(ERR)), ERR)
    return hx.loops.FixedDirection(hx.simulate_leg(robot, 3, "direction", n_poses, n_sets, noise=noise, rng=1))


def _skew(vectors: np.ndarray) -> np.ndarray:
    out = np.zeros((len(vectors), 3, 3))
    out[:, 2, 1], out[:, 0, 2], out[:, 1, 0] = vectors.T
    return out - out.transpose(0, 2, 1)


def _rotations(vectors: np.ndarray) -> np.ndarray:
    angle = np.sqrt((vectors * vectors).sum(axis=1))[:, None, None]
    cross, angle = _skew(vectors), np.where(angle < 1e-8, 1e-8, angle)
    return np.asarray(np.eye(3) + np.sin(angle) / angle * cross + (1 - np.cos(angle)) / angle**2 * cross @ cross)


class DirectionRows:
    """Type I of one set as one would write it for SciPy: (b, a) and the direction as two numbers across a first one.

    With fixed `roots` the rows are whitened once; without, by the covariance at the values, at measurements that are
    moved until the loop equations hold, as maximum likelihood needs it.
    """

    def __init__(self, data: hx.LegMeasurements, start: np.ndarray, roots: np.ndarray | None = None) -> None:
        assert data.length is not None
        assert data.nominal is not None
        assert data.noise is not None
        self.position, self.rotation, self.roots = data.position, data.rotation, roots
        self.length = data.length + float(data.nominal.offset)
        self.covariance = data.noise.covariance(data.position, data.rotation)
        self.first = start[6:] / np.linalg.norm(start[6:])
        self.across = np.linalg.svd(self.first[None])[2][1:].T
        self.start = np.r_[start[:6], 0.0, 0.0]

    def direction(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The unit vector, and its derivative."""
        turned = self.first + self.across @ x[6:]
        size = np.linalg.norm(turned)
        unit = turned / size
        return unit, (self.across - np.outer(unit, unit @ self.across)) / size

    def at(self, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rows and Jacobian."""
        unit, turning = self.direction(x)
        position, rotation, length = self.position, self.rotation, self.length
        error = np.zeros((len(length), 7))
        for _ in range(4 if self.roots is None else 1):
            arm = rotation @ x[:3]
            g = position + arm - x[3:6] - np.outer(length, unit)
            if self.roots is not None:
                root = self.roots
                break
            by_error = np.zeros((len(g), 3, 7))
            by_error[..., :3], by_error[..., 3:6], by_error[..., 6] = np.eye(3), -_skew(arm), -unit
            through = by_error @ self.covariance
            root = np.linalg.inv(np.linalg.cholesky(through @ by_error.transpose(0, 2, 1)))
            g = g - (by_error @ error[..., None])[..., 0]
            error = -(through.transpose(0, 2, 1) @ root.transpose(0, 2, 1) @ root @ g[..., None])[..., 0]
            position, length = self.position + error[:, :3], self.length + error[:, 6]
            rotation = _rotations(error[:, 3:6]) @ self.rotation
        rows = np.empty((len(g), 3, 8))
        rows[..., :3], rows[..., 3:6], rows[..., 6:] = rotation, -np.eye(3), -length[:, None, None] * turning
        return (root @ g[..., None]).ravel(), (root @ rows).reshape(-1, 8)

    def functions(self) -> Rows:
        """Residual and Jacobian, evaluated together."""
        last: dict[bytes, tuple[np.ndarray, np.ndarray]] = {}

        def both(x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            key = x.tobytes()
            if key not in last:
                last.clear()
                last[key] = self.at(x)
            return last[key]

        return lambda x: both(x)[0], lambda x: both(x)[1]


def scipy_direction(loop: hx.loops.FixedDirection, *, fixed: bool) -> Callable[[], int]:
    """``least_squares(method="lm")`` from the linear solution, with its weights or with the likelihood's own."""
    problem = loop.linear("direct")
    start = hx.estimate(problem, hx.LeastSquares()).values
    roots = problem.whitening().blocks
    few = min(len(start), FEW_SCIPY)
    sets = [loop.data[i] for i in range(few)]

    def work() -> int:
        for i, data in enumerate(sets):
            rows = DirectionRows(data, start[i], roots[i] if fixed else None)
            residual, jacobian = rows.functions()
            least_squares(residual, rows.start, jacobian, method="lm")
        return few

    return work


def ipopt(loop: hx.loops.FixedDirection) -> Callable[[], int]:
    """A CasADi program a set, solved by IPOPT from the answer."""
    few = hx.loops.FixedDirection(loop.data[:FEW_IPOPT])
    start = hx.estimate(few, hx.MaximumLikelihood()).values

    def work() -> int:
        for i in range(FEW_IPOPT):
            hx.symbolic.maximum_likelihood(hx.loops.FixedDirection(few.data[i]), start[i])
        return FEW_IPOPT

    return work


def against_peers(n_sets: int, repeats: int) -> pd.DataFrame:
    """A batch of hexopt on Type I, against loops over SciPy and over IPOPT."""
    table = []
    for n_poses in POSES:
        loop = directions(n_poses, n_sets)

        def likelihood(loop: hx.loops.FixedDirection = loop) -> object:
            return hx.estimate(hx.loops.FixedDirection(loop.data), hx.MaximumLikelihood())

        def weighted(loop: hx.loops.FixedDirection = loop) -> object:
            return hx.estimate(loop.linear("direct"), hx.UnitNormLeastSquares(weights="model"))

        for who, name, ours, slow in (
            ("MaximumLikelihood", "scipy, the same likelihood", likelihood, scipy_direction(loop, fixed=False)),
            ("MaximumLikelihood", "scipy, weights fixed", likelihood, scipy_direction(loop, fixed=True)),
            ("UnitNormLeastSquares", "scipy, weights fixed", weighted, scipy_direction(loop, fixed=True)),
            ("MaximumLikelihood", "CasADi + IPOPT", likelihood, ipopt(loop)),
        ):
            table.append({"estimator": who, "poses N": n_poses, "peer": name} | race(ours, slow, n_sets, repeats))
    return pd.DataFrame(table)
