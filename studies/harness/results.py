"""Read the rows of a sweep back: all of them, chunk by chunk, or as statistics of streaming chunks."""

from __future__ import annotations

from collections.abc import Hashable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pandas as pd
import pyarrow as pa

from studies.harness.store import StaleChunkError, chunk_files, read_manifest
from studies.harness.study import StudyError

BLOCK = 100_000  # rows that `aggregate` holds at once, or one chunk, if that has more


def _tables(out: str | Path, columns: Sequence[str] | None, partial: bool) -> Iterator[pa.Table]:
    out = Path(out)
    for place in chunk_files(out, read_manifest(out)):
        try:
            yield place.read(None if columns is None else list(dict.fromkeys(columns)))
        except (FileNotFoundError, StaleChunkError):
            if not partial:
                label = place.label
                raise StudyError(
                    f"{out} is unfinished (chunk {label['chunk']} of scenario {label['key']!r} is missing): "
                    f"run the study again with --resume, or read what there is with partial=True"
                ) from None
        except (OSError, ValueError) as error:
            raise StudyError(f"{place.path} cannot be read ({error}): --resume makes it again") from error


def iter_chunks(
    out: str | Path, columns: Sequence[str] | None = None, *, partial: bool = False
) -> Iterator[pd.DataFrame]:
    """The rows of a sweep, one chunk at a time.

    Parameters
    ----------
    out : path
        The folder of the sweep.
    columns : sequence of str, optional
        The columns to read; all unless given.
    partial : bool
        Pass over missing chunks of an unfinished sweep, instead of raising `StudyError`.

    Yields
    ------
    pandas.DataFrame
        One chunk: scenarios in the study's order, chunks by number, whatever finished first.
    """
    for table in _tables(out, columns, partial):
        yield table.to_pandas()


def load(out: str | Path, columns: Sequence[str] | None = None, *, partial: bool = False) -> pd.DataFrame:
    """All rows of a sweep in one frame; arguments and order are those of `iter_chunks`."""
    tables = list(_tables(out, columns, partial))
    if not tables:
        raise StudyError(f"{out} has no finished chunk yet")
    return _frame(tables)


def _blocks(out: str | Path, columns: Sequence[str], partial: bool) -> Iterator[pd.DataFrame]:
    """Chunks, in their order, put together to blocks worth a call of pandas."""
    block: list[pa.Table] = []
    for table in _tables(out, columns, partial):
        block.append(table)
        if sum(map(len, block)) >= BLOCK:
            yield _frame(block)
            block.clear()
    if block:
        yield _frame(block)


def _frame(tables: Sequence[pa.Table]) -> pd.DataFrame:
    return pa.concat_tables(tables, promote_options="permissive").to_pandas()


@dataclass
class _Moments:
    """Statistics of one value in one group, merged block by block (Chan, Golub and LeVeque 1979)."""

    count: int = 0
    failures: int = 0
    missing: int = 0
    mean: float = 0.0
    squares: float = 0.0  # Σ (x - mean)²
    low: float = np.inf
    high: float = -np.inf
    values: list[np.ndarray] = field(default_factory=list)

    def add(self, values: np.ndarray, ok: np.ndarray | None, keep: bool) -> None:
        finite = np.isfinite(values)
        good = values[finite if ok is None else finite & ok]
        missing = 0 if ok is None else int((ok & np.isnan(values)).sum())
        self.missing += missing
        self.failures += len(values) - len(good) - missing
        if not len(good):
            return
        mean, total = float(good.mean()), self.count + len(good)
        shift = mean - self.mean
        self.squares += float(np.square(good - mean).sum()) + shift**2 * self.count * len(good) / total
        self.mean += shift * len(good) / total
        self.count = total
        self.low, self.high = min(self.low, float(good.min())), max(self.high, float(good.max()))
        if keep:
            self.values.append(good)

    def row(self, quantiles: Sequence[float]) -> dict[str, float]:
        n = self.count
        std = np.sqrt(self.squares / (n - 1)) if n > 1 else np.nan
        counts: dict[str, float] = {"count": n, "failures": self.failures, "missing": self.missing}
        statistics = {"mean": self.mean, "sem": std / np.sqrt(max(n, 1)), "std": std}
        statistics |= {"rms": np.sqrt(self.mean**2 + self.squares / max(n, 1)), "min": self.low, "max": self.high}
        if quantiles:
            found = np.quantile(np.concatenate(self.values), quantiles) if n else np.full(len(quantiles), np.nan)
            statistics |= {f"q{level:g}": float(value) for level, value in zip(quantiles, found, strict=True)}
        return counts | (statistics if n else dict.fromkeys(statistics, np.nan))


def _groups(frame: pd.DataFrame, by: list[str]) -> Iterator[tuple[tuple[Hashable, ...], np.ndarray]]:
    """The groups in order of appearance, and the places of their rows."""
    codes = frame.groupby(by, sort=False, dropna=False, observed=True).ngroup().to_numpy()
    order = np.argsort(codes, kind="stable")
    places = np.split(order, np.flatnonzero(np.diff(codes[order])) + 1)
    for rows in places:
        key = frame[by].iloc[rows[0]]
        yield tuple(None if pd.isna(name) else name for name in key), rows


def aggregate(
    out: str | Path,
    by: str | Sequence[str],
    value: str | Sequence[str],
    *,
    ok: str | None = None,
    quantiles: Sequence[float] = (),
    partial: bool = False,
) -> pd.DataFrame:
    """Statistics of groups of rows, block by block; they do not depend on how the sweep was run.

    Parameters
    ----------
    out : path
        The folder of the sweep.
    by : str or sequence of str
        Columns that name the groups, say ``["scenario", "method"]``.
    value : str or sequence of str
        Columns of numbers.
    ok : str, optional
        A column of booleans, false in rows that failed.
    quantiles : sequence of float
        Probabilities of exact quantiles; these keep the values of these columns in memory.
    partial : bool
        As in `iter_chunks`.

    Returns
    -------
    pandas.DataFrame
        A row for each group (its index, in order of appearance) and value: ``value``; ``count``, the rows
        that count; ``failures``, those that are not ok, or not finite; ``missing``, those that are ok, but
        NaN: without an `ok`, they are failures; then, of the rows that count, ``mean``, its Monte-Carlo
        error ``sem``, ``std``, ``rms``, ``min``, ``max``, and each quantile, as ``q0.5``.
    """
    by, values = ([names] if isinstance(names, str) else list(names) for names in (by, value))
    groups: dict[tuple[Hashable, ...], dict[str, _Moments]] = {}
    for frame in _blocks(out, [*by, *values, *([ok] if ok else [])], partial):
        numbers = frame[values].astype(float)
        good = frame[ok].fillna(False).to_numpy(bool) if ok else None
        for group, rows in _groups(frame, by):
            moments = groups.setdefault(group, {name: _Moments() for name in values})
            for name in values:
                moments[name].add(numbers[name].to_numpy()[rows], None if good is None else good[rows], bool(quantiles))
    table = [{"value": name, **group[name].row(quantiles)} for group in groups.values() for name in values]
    index = pd.MultiIndex.from_tuples([group for group in groups for _ in values], names=by)
    return pd.DataFrame(table, index=index if len(by) > 1 else index.get_level_values(0))
