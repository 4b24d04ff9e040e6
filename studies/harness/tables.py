"""Numbers and frames as the cells of an accessible table."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Hashable, Iterable, Mapping
from itertools import groupby
from typing import Any

import pandas as pd
from markupsafe import Markup

Format = str | Callable[[Any], str]
Texts = Mapping[Hashable, str]
_NUMBER = re.compile(r"[+−]?[\d.∞]")
_MISSING = "–"
_RAISED = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def number(value: object, digits: int = 3) -> str:
    """A number with so many significant digits, a whole one whole; any other value as text.

    Examples
    --------
    >>> number(-0.012345), number(12345), number(2.5e-7), number(float("nan"))
    ('−0.0123', '12\u202f345', '2.50×10⁻⁷', '–')
    """
    if isinstance(value, bool | str) or not hasattr(value, "__float__"):
        return value if isinstance(value, str) else _MISSING if value is None or value is pd.NA else str(value)
    if hasattr(value, "__index__"):
        return f"{value.__index__():,}".replace(",", "\u202f").replace("-", "−")
    real = float(value)
    if not math.isfinite(real):
        return _MISSING if math.isnan(real) else "∞" if real > 0 else "−∞"
    if real and not 1e-4 <= abs(real) < 1e6:
        mantissa, exponent = f"{real:.{digits - 1}e}".split("e")
        return f"{mantissa}×10{str(int(exponent)).translate(_RAISED)}".replace("-", "−")
    return f"{real:.{_decimals(real, digits)}f}".replace("-", "−")


def with_error(value: float, error: float) -> str:
    """A mean and its Monte-Carlo error, to the second digit of the error.

    Examples
    --------
    >>> with_error(1.23456, 0.0567)
    '1.235 ± 0.057'
    """
    if not (math.isfinite(value) and math.isfinite(error) and error > 0):
        return number(value)
    decimals = _decimals(error, 2)
    return f"{value:.{decimals}f} ± {error:.{decimals}f}".replace("-", "−")


def _decimals(real: float, digits: int) -> int:
    """Decimals that show so many significant digits of a number, once it is rounded to them."""
    magnitude = int(f"{real:.{digits - 1}e}".partition("e")[2]) if real else 0
    return max(0, digits - 1 - magnitude)


def table(frame: pd.DataFrame, units: Texts, formats: Mapping[Hashable, Format], digits: int) -> dict[str, Any]:
    """What a template needs to write a frame as a table: rows of cells, and their heads with their spans."""
    columns = [[_text(value, formats.get(name), digits) for value in frame.iloc[:, i]] for i, name in enumerate(frame)]
    named = [name for name in frame.index.names if name is not None]
    heads = _row_heads(frame.index) if named else [[] for _ in frame.index]
    return {
        "corner": [{"text": str(name), "unit": units.get(name, "")} for name in named],
        "columns": _column_heads(frame.columns, units),
        "numeric": [all(_NUMBER.match(text) or text == _MISSING for text in column) for column in columns],
        "rows": list(zip(heads, zip(*columns, strict=True), strict=True)),
    }


def _text(value: Any, form: Format | None, digits: int) -> str:
    if isinstance(value, Markup):
        return value
    if value is None or value is pd.NA or (isinstance(value, float) and math.isnan(value)):
        return _MISSING
    if form is None:
        return number(value, digits)
    return form(value) if callable(form) else format(value, form).replace("-", "−")


def _spans(keys: Iterable[Hashable]) -> list[int]:
    return [len(list(run)) for _, run in groupby(keys)]


def _column_heads(columns: pd.Index, units: Texts) -> list[list[dict[str, Any]]]:
    """The heads of each level; an outer one spans the columns that share it."""
    keys = [name if isinstance(name, tuple) else (name,) for name in columns]
    levels = []
    for depth in range(columns.nlevels):
        inner, level, start = depth == columns.nlevels - 1, [], 0
        for span in [1] * len(keys) if inner else _spans(key[: depth + 1] for key in keys):
            name = keys[start][depth]
            unit = (units.get(columns[start]) or units.get(name, "")) if inner else ""
            level.append({"text": str(name), "unit": unit, "span": span})
            start += span
        levels.append(level)
    return levels


def _row_heads(index: pd.Index) -> list[list[dict[str, Any]]]:
    """For each row the heads that begin there; an outer one spans the rows that share it."""
    keys = [key if isinstance(key, tuple) else (key,) for key in index]
    heads: list[list[dict[str, Any]]] = [[] for _ in keys]
    for depth in range(index.nlevels):
        inner, start = depth == index.nlevels - 1, 0
        for span in [1] * len(keys) if inner else _spans(key[: depth + 1] for key in keys):
            heads[start].append({"text": number(keys[start][depth]), "span": span})
            start += span
    return heads
