"""Checked, read-only float arrays: the one gate through which numbers enter hexopt."""

from __future__ import annotations

from collections.abc import Sequence
from numbers import Real
from typing import Any

import numpy as np
import numpy.typing as npt

from .errors import InputError

__all__ = [
    "Array",
    "BoolArray",
    "as_array",
    "as_count",
    "as_generator",
    "brief",
    "frozen",
    "matvec",
    "norm",
    "transpose",
]

Array = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]


def frozen(array: npt.NDArray[Any]) -> npt.NDArray[Any]:
    """A read-only view of `array`; the caller's own array keeps its flags."""
    view = array.view()
    view.flags.writeable = False
    return view


def as_array(
    name: str, value: npt.ArrayLike, shape: Sequence[int | str | None] = (), *, batch: bool = True, own: bool = False
) -> Array:
    """`value` as a read-only float array whose last dimensions are `shape`.

    Parameters
    ----------
    name : str
        What the user calls the argument; it opens the error message.
    value : array_like
        The input; copied only where its type has to change.
    shape : sequence of int, str or None
        Trailing dimensions: an integer must match, a letter or None stands for any size.
    batch : bool, default True
        Whether leading dimensions may stand before `shape`.
    own : bool, default False
        Whether the result is kept: an array that its owner could still change is then copied.

    Raises
    ------
    InputError
        If the input is not numeric, has another shape, or holds NaN or infinity.

    Examples
    --------
    >>> as_array("base_point", [1, 2, 3], (3,))
    array([1., 2., 3.])
    """
    try:
        raw = np.asarray(value)
        if raw.dtype.kind not in "iuf" and not (raw.dtype.kind == "O" and all(isinstance(v, Real) for v in raw.flat)):
            raise TypeError(f"{raw.dtype} is no type of real numbers")  # NumPy would read "1.5" and drop 2i
        array: Array = np.asarray(raw, dtype=np.float64)
    except (TypeError, ValueError, OverflowError) as error:
        raise InputError(f"{name}: expected numbers, got {brief(value)} ({error})") from None
    wanted = len(shape)
    fits = array.ndim >= wanted if batch else array.ndim == wanted
    fits = fits and all(
        not isinstance(size, int) or size == actual
        for size, actual in zip(shape, array.shape[array.ndim - wanted :], strict=False)
    )
    if not fits:
        parts = (["..."] if batch else []) + [str(size) if size is not None else "any" for size in shape]
        raise InputError(f"{name}: expected shape ({', '.join(parts)}), got {array.shape}")
    if not np.isfinite(array).all():
        bad = np.argwhere(~np.isfinite(array))
        where = tuple(int(index) for index in bad[0])
        raise InputError(
            f"{name}: {len(bad)} value(s) are NaN or infinite, the first at index {where}; "
            "remove or mend these measurements"
        )
    if own and array.flags.writeable and isinstance(value, np.ndarray) and np.may_share_memory(array, value):
        array = array.copy()
    return frozen(array)


def as_count(name: str, value: object) -> int:
    """`value` as a whole number of at least 1, or an :class:`InputError`."""
    if isinstance(value, bool) or not isinstance(value, (int, np.integer)) or value < 1:
        raise InputError(f"{name}: expected a whole number >= 1, got {brief(value)}")
    return int(value)


def brief(value: object) -> str:
    """`value` on one line of an error message, cut short."""
    text = " ".join(repr(value).split())  # one line
    return text if len(text) <= 60 else text[:57] + "..."


def as_generator(rng: int | np.random.Generator | np.random.SeedSequence | None) -> np.random.Generator:
    """The random generator behind an `rng=` argument.

    Raises
    ------
    InputError
        If `rng` is None or is no seed: hexopt has no hidden randomness.
    """
    if rng is None:
        raise InputError("rng: a seed or a numpy.random.Generator is needed, e.g. rng=0")
    if isinstance(rng, bool) or not isinstance(rng, (int, np.integer, np.random.Generator, np.random.SeedSequence)):
        raise InputError(f"rng: expected a seed or a numpy.random.Generator, got {brief(rng)}")
    if isinstance(rng, (int, np.integer)) and rng < 0:
        raise InputError(f"rng: a seed must not be negative, got {rng}")
    return np.random.default_rng(rng)


def matvec(matrix: Array, vector: Array) -> Array:
    """Batched matrix–vector product, ``(..., m, n) @ (..., n)``."""
    product: Array = np.einsum("...mn,...n->...m", matrix, vector)
    return product


def transpose(matrix: Array) -> Array:
    """The last two dimensions swapped."""
    return np.swapaxes(matrix, -1, -2)


def norm(vector: Array) -> Array:
    """Euclidean length of the last dimension."""
    length: Array = np.sqrt(np.einsum("...i,...i->...", vector, vector))
    return length
