"""What one set of poses sees: the singular values of its whitened rows, with and without the nuisance."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from ..arrays import Array, BoolArray, norm
from ..geometry import LENGTH_UNITS
from ..information import chosen_scalars, coordinate_units, expected_spreads
from ..loops.implicit import Implicit
from ..numerics.lstsq import null_combinations, rank_tolerance
from ..parameters import Parameters
from ..problem import LinearProblem
from .report import Direction, Observability
from .rows import ObservedRows, hidden_scalars, observed_rows

__all__ = ["observability"]

#: A coordinate with no more than this share in what is not seen is determined.
LEAK = 1e-6
#: Coefficients below this share of the largest are left out of words.
WORTH_SAYING = 0.05
#: So many coefficients of a weak direction are said.
MOST_WORDS = 3
#: Without an expected spread, a standard error beyond this share of the robot's size is as good as none.
SHARE_OF_SIZE = 0.1


def observability(
    target: Implicit | LinearProblem,
    at: Any = None,
    of: Sequence[str] | None = None,
    spread: Mapping[str, float] | None = None,
) -> Observability:
    r"""What the poses of one set determine, how well, and what they do not see.

    Let J be the whitened rows :math:`S_i^{-1/2} G_i` of all poses by all unknowns, in coordinates scaled by the
    expected spread of the parameters of interest (those of nuisances and shared errors so that their columns are as
    long as those of interest), with the unit variances of shared errors below. With :math:`J = [J_\theta\; J_\nu]` the
    information of interest is the Schur complement :math:`J_\theta^T(I - J_\nu J_\nu^+)J_\theta`; the square roots
    :math:`\sigma_1 \ge … \ge \sigma_k` of its eigenvalues are the `main_singular_values`. Its inverse is the predicted
    covariance, that is the Cramér–Rao bound of a loop. Where J is singular, a parameter is determined if its
    coordinate is orthogonal to the null space; the others have an infinite standard error.

    Parameters
    ----------
    target : loop or LinearProblem
        One set of poses (or several sets in one loop). A problem may have any form; rows whose noise is unknown are
        taken as they are, and the report says so.
    at : values, geometry or Estimate, optional
        Where a loop is evaluated, or the noise of a problem; by default the loop's start, as a rule its nominal, or
        where the problem evaluates its weights.
    of : sequence of str, optional
        Blocks of interest; the others are estimated on the way. By default all that are no nuisance. Of several legs
        "base_point" means that of each.
    spread : dict of str to float, optional
        Expected spread of blocks by name, in their units; by default their ``scale``, 1.

    Returns
    -------
    Observability

    Raises
    ------
    InputError
        For a batch of sets, unknown names, a loop without a noise model, or values that are not finite.

    Notes
    -----
    The condition numbers and O2 say nothing of magnitude, and all indices change with `spread`; standard errors do
    not. Errors of the measured poses make what is not seen look seen, badly: poses turned about one axis have rotations
    that differ from it by their noise. The summary warns of standard errors beyond the given `spread`, or else beyond
    a tenth of the robot's size; what a loop's ``blind_spots`` name is never determined. A problem evaluates its noise
    at its own unweighted solution, which is far off where the poses see little: rather take the loop, or give `at`.

    References
    ----------
    Borm and Menq (1991), Driels and Pathre (1990), Nahvi, Hollerbach and Hayward (1994), Nahvi and Hollerbach (1996)
    and Sun and Hollerbach (2008), for the indices O1…O5.

    Examples
    --------
    >>> import numpy as np
    >>> import hexopt as hx
    >>> robot = hx.robots.left_hand()
    >>> noise = hx.UniformNoise(position=0.01, angle=np.deg2rad(0.01), length=0.01)
    >>> data = hx.simulate_leg(robot, leg=3, lock="direction", n_poses=7, noise=noise, rng=0)
    >>> seen = hx.observability(hx.loops.FixedDirection(data), at=robot.leg(3), spread={"base_point": 0.5})
    >>> {name: round(error, 4) for name, error in seen.block_errors.items()}
    {'platform_point': 0.0083, 'base_point': 0.1038}
    >>> bool(np.isclose(seen.leverage.sum(), 8))  # b, a and two of the direction, seven poses
    True
    """
    parameters = target.parameters if isinstance(target, (Implicit, LinearProblem)) else Parameters(())
    rows = observed_rows(target, at)
    chosen = chosen_scalars(parameters, of)
    blind = target.blind_spots if isinstance(target, Implicit) else ()
    main = np.flatnonzero(chosen[rows.places])
    sizes = expected_spreads(parameters, spread)[rows.places[main]]
    interest = Parameters(tuple(block for block in parameters if chosen[parameters[block.name]].all()))
    seen = _Seen(rows, main)
    complement = seen.complement(sizes)
    values, directions = _spectrum(complement, seen.null_main / (seen.length[main] * sizes)[:, None])
    scale = coordinate_units(seen.length, main, sizes)
    determined = seen.determined & ~hidden_scalars(parameters, blind)[rows.places[main]]
    return Observability(
        title=target.name if isinstance(target, LinearProblem) else type(target).__name__,
        parameters=interest,
        spread=sizes,
        covariance=seen.covariance(determined),
        singular_values=_spectrum(rows.matrix * scale, seen.null / (seen.length * scale)[:, None])[0],
        main_singular_values=values,
        directions=directions,
        condition_raw=_condition(rows.raw, float(rows.lost.max())),
        leverage=seen.leverage(rows.owner),
        rank=seen.rank,
        unseen=blind + _words(parameters, rows, seen.null.shape[1]),
        weak=_weak(interest, values, directions, sizes),
        limits=np.full(len(sizes), np.inf) if rows.caveat else _limits(interest, rows.size, spread, sizes),
        per=rows.per,
        caveat=rows.caveat,
    )


class _Seen:
    """The singular value decomposition of rows with columns of unit length, and what it says of coordinates."""

    def __init__(self, rows: ObservedRows, main: npt.NDArray[np.intp]) -> None:
        self.main = main
        length = norm(rows.matrix.T)
        #: Of the columns.
        self.length = np.where(length > 0, length, 1.0)
        self.rows = rows.matrix / self.length
        count, size = rows.matrix.shape
        padded = np.concatenate([self.rows, np.zeros((max(size - count, 0), size))])
        left, values, right = np.linalg.svd(padded, full_matrices=False)
        self.tolerance = rank_tolerance(*rows.matrix.shape) * float(rows.lost.max())
        self.rank = int((values > self.tolerance * values[0]).sum())
        self._shares = np.square(left[:count, : self.rank]).sum(axis=1)
        #: An orthonormal basis (q, z) of what is not seen.
        self.null = right[self.rank :].T
        self._root = right[: self.rank].T / values[: self.rank]
        vectors, sizes, _ = np.linalg.svd(self.null[main], full_matrices=False)
        #: A basis (k, z') of what is not seen of interest.
        self.null_main = vectors[:, sizes > LEAK]
        self.determined: BoolArray = norm(self.null[main]) <= LEAK

    def leverage(self, owner: npt.NDArray[np.intp]) -> Array:
        """The share of every owner's rows in the information, (n,)."""
        owned = owner >= 0
        return np.bincount(owner[owned], self._shares[owned]).astype(float)

    def complement(self, sizes: Array) -> Array:
        """The columns of interest, times sizes, without what the others explain, (M, k)."""
        others = np.delete(self.rows, self.main, axis=1)
        left, values, _ = np.linalg.svd(others, full_matrices=False)
        basis = left[:, values > self.tolerance * values.max(initial=0.0)]
        columns = self.rows[:, self.main]
        return (columns - basis @ (basis.T @ columns)) * (self.length[self.main] * sizes)

    def covariance(self, determined: BoolArray) -> Array:
        """The covariance of interest, infinite on the diagonal and NaN beside it where nothing is determined."""
        root = self._root[self.main] / self.length[self.main, None]
        both = determined[:, None] & determined
        return np.where(both, root @ root.T, np.where(np.eye(len(root)) > 0, np.inf, np.nan))


def _spectrum(rows: Array, null: Array) -> tuple[Array, Array]:
    """Singular values (q,) of rows that do not see the columns of `null`, as zeros, and directions (q, q) by rows."""
    unseen = null.shape[1]
    whole = np.linalg.qr(null, mode="complete")[0]
    seen = whole[:, unseen:]
    _, values, right = np.linalg.svd(rows @ seen, full_matrices=False)
    return np.concatenate([values, np.zeros(unseen)]), np.concatenate([right @ seen.T, whole[:, :unseen].T])


def _condition(matrix: Array, lost: float) -> float:
    """The condition number of a matrix as it is; infinite if its columns are dependent, to rounding."""
    values = np.linalg.svd(matrix, compute_uv=False)
    full = len(values) == matrix.shape[1] and values[-1] > np.finfo(float).eps * lost * values[0]
    return float(values[0] / values[-1]) if full else np.inf


def _words(parameters: Parameters, rows: ObservedRows, count: int) -> tuple[str, ...]:
    """What is not seen, by name."""
    if not count:
        return ()
    found = null_combinations(rows.matrix, rows.lost, threshold=WORTH_SAYING, at_least=count)
    return tuple(parameters.combination(rows.basis @ vector, threshold=WORTH_SAYING) for vector in found)


def _weak(interest: Parameters, values: Array, directions: Array, sizes: Array) -> tuple[Direction, ...]:
    """The directions that are seen, the least seen first."""
    units = [block.unit for block in interest for _ in range(block.size)]
    found = []
    for value, direction in zip(values[::-1], directions[::-1], strict=True):
        if value > 0:
            shares = np.abs(direction) / np.abs(direction).max()
            said = shares >= max(WORTH_SAYING, np.sort(shares)[-MOST_WORDS:][0])
            more = " + …" * bool((shares[~said] >= WORTH_SAYING).any())
            kept = np.where(said, direction * sizes, 0.0)
            first = int(np.abs(kept).argmax())
            words = interest.combination(kept, threshold=0.0) + more
            found.append(Direction(words, float(abs(kept[first]) / value), units[first]))
    return tuple(found)


def _limits(interest: Parameters, size: float, spread: Mapping[str, float] | None, sizes: Array) -> Array:
    """Standard errors (k,) beyond which nothing is seen in practice."""
    given = set(spread or {})
    named = [bool(given & {block.name, block.name.rpartition(".")[2]}) for block in interest]
    lengths = [SHARE_OF_SIZE * size if block.unit in LENGTH_UNITS else np.inf for block in interest]
    counts = [block.size for block in interest]
    return np.where(np.repeat(named, counts), sizes, np.repeat(lengths, counts))
