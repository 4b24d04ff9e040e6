"""hexopt's column names, and the columns of a file that bear them."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping

from ..errors import InputError
from .orientation import OrientationKind
from .table import Table, brief

__all__ = ["LEG", "LENGTH", "LENGTHS", "LOCK", "POSITION", "SET", "choose_columns"]

SET, LEG, LOCK = "set", "leg", "lock"
POSITION = ("position_x", "position_y", "position_z")
LENGTH = "leg_length"
LENGTHS = tuple(f"{LENGTH}_{number}" for number in range(1, 7))
OPTIONAL = (SET, LEG, LOCK)
MAP_THEM = "Map columns of other names by columns= (--column in the command line)"


def choose_columns(table: Table, kind: OrientationKind, columns: Mapping[str, str], *, readings: bool = True) -> Table:
    """The table with hexopt's names, each read from the column that `columns` names, or that bears it.

    Without `readings` those of the legs need not be there.

    Raises
    ------
    InputError
        If `columns` has a name that is not hexopt's, or reads two from the same column.
    FileFormatError
        If a column is missing, or one that stands in the file would be ignored though it seems meant.
    """
    known = (*OPTIONAL, LENGTH, *LENGTHS, *POSITION, *kind.columns)
    labels = _labels(known, columns)
    for name, label in columns.items():
        if label not in table:
            raise table.error(f"has no column {brief(label)}, from which {name} is to be read. {_has(table)}")
    chosen = Table(
        table.path,
        {name: table.header[label] for name, label in labels.items() if label in table},
        table.rows,
        table.lines,
        labels,
    )
    if readings:
        _check_lengths(chosen, table)
    missing = [name for name in (*POSITION, *kind.columns) if name not in chosen]
    if missing:
        raise table.error(f"misses {', '.join(missing)}. {_has(table)}. {MAP_THEM}")
    _check_ignored(table, {labels[name] for name in chosen.header}, columns)
    return chosen


def _labels(known: tuple[str, ...], columns: Mapping[str, str]) -> dict[str, str]:
    """What the file calls each of hexopt's columns."""
    strange = [name for name in columns if name not in known]
    if strange:
        raise InputError(f"columns: {strange[0]!r} is not a column of hexopt's; expected {', '.join(known)}")
    labels = {name: columns.get(name, name) for name in known}
    given = list(columns.values())
    for name, label in columns.items():
        others = [other for other in columns if other != name and columns[other] == label]
        if others:
            raise InputError(f"columns: {name} and {others[0]} would both be read from {label!r}; map one of them")
    # a column that the mapping reads as something else no longer stands for its own name
    return {name: label for name, label in labels.items() if name in columns or label not in given}


def _check_lengths(chosen: Table, table: Table) -> None:
    """Either the six readings or the one of the measured leg, or an error that says what is missing."""
    found = [name for name in LENGTHS if name in chosen]
    if LENGTH in chosen and found:
        raise table.error(f"has both {LENGTH} and {found[0]}; expected six readings a pose, or one: remove the others")
    if LENGTH not in chosen and len(found) < len(LENGTHS):
        missing = [name for name in LENGTHS if name not in found]
        hint = "" if found else f" (or {LENGTH} with {LEG}, where one leg was measured)"
        raise table.error(f"misses {', '.join(missing)}{hint}. {_has(table)}. {MAP_THEM}")


def _check_ignored(table: Table, used: set[str], mapped: Collection[str]) -> None:
    """Columns that nobody reads may stand in the file, but not one that looks as if it were meant."""
    meant = {_plain(name): name for name in (*OPTIONAL, LENGTH)}
    for label in table.header:
        plain = _plain(label)
        if label in used or label in mapped:
            continue
        if plain in meant:
            raise table.error(f"the column {brief(label)} is not read; rename it to {meant[plain]!r}, or map it")
        if re.fullmatch(r"leglength\d+", plain):
            raise table.error(f"the column {brief(label)} is not read: a hexapod has legs 1…6; rename or remove it")
        if plain == "orientationw" and "orientation_x" in used:
            raise table.error(f"the column {brief(label)} makes this a quaternion; read it with orientation=quaternion")


def _plain(label: str) -> str:
    return re.sub(r"[^a-z0-9]", "", label.casefold())


def _has(table: Table) -> str:
    names = [brief(label).strip("'") for label in table.header]
    return f"It has {', '.join(names[:20])}" + (", …" if len(names) > 20 else "")
