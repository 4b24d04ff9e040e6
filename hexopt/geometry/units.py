"""Length units: a checked label on every robot and measurement, and the factor between two of them."""

from __future__ import annotations

from fractions import Fraction

from ..errors import UnitError

__all__ = ["LENGTH_UNITS", "check_length_unit", "length_factor"]

#: Metres in one unit; "unstated" is a label of its own, for robots whose source names no unit.
LENGTH_UNITS: dict[str, float | None] = {
    "m": 1.0,
    "dm": 1e-1,
    "cm": 1e-2,
    "mm": 1e-3,
    "um": 1e-6,
    "in": 0.0254,
    "unstated": None,
}
_ALIASES = {"µm": "um", "μm": "um", "micron": "um", "inch": "in"}


def check_length_unit(name: str, unit: object) -> str:
    """The canonical label of a length unit.

    Raises
    ------
    UnitError
        If the unit is not known.

    Examples
    --------
    >>> check_length_unit("length_unit", "µm")
    'um'
    """
    label = _ALIASES.get(unit, unit) if isinstance(unit, str) else unit
    if not isinstance(label, str) or label not in LENGTH_UNITS:
        raise UnitError(f"{name}: unknown length unit {unit!r}; expected one of {', '.join(LENGTH_UNITS)}")
    return label


def length_factor(source: str, target: str) -> float:
    """The number that turns lengths in `source` into lengths in `target`.

    Raises
    ------
    UnitError
        If a unit is unknown, or exactly one of them is "unstated".

    Examples
    --------
    >>> length_factor("cm", "mm")
    10.0
    """
    source, target = check_length_unit("source unit", source), check_length_unit("target unit", target)
    if source == target:
        return 1.0
    numerator, denominator = LENGTH_UNITS[source], LENGTH_UNITS[target]
    if numerator is None or denominator is None:
        raise UnitError(f"cannot convert {source!r} to {target!r}: one of them states no unit")
    return float(Fraction(str(numerator)) / Fraction(str(denominator)))  # exact decimals, rounded once
