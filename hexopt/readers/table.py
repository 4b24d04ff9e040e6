"""CSV text as a table of cells that know their line; no row is dropped, and every fault has a place."""

from __future__ import annotations

import csv
import io
import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from ..arrays import Array
from ..errors import FileFormatError

__all__ = ["Table", "brief", "read_table"]

SEPARATORS = ",;\t"
_NUMBER = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+([eE][+-]?\d+)?", re.ASCII)


@dataclass(frozen=True)
class Table:
    """The rows under a header.

    Attributes
    ----------
    path : Path
    header : dict of str to int
        Column names and their places.
    rows : list of list of str
        Cells without surrounding blanks, as many in each row as in the header.
    lines : list of int
        The line of each row in the file, counted from 1.
    labels : dict of str to str
        What the file calls a column, where that differs.
    """

    path: Path
    header: Mapping[str, int]
    rows: Sequence[Sequence[str]]
    lines: Sequence[int]
    labels: Mapping[str, str] = field(default_factory=dict)

    def __contains__(self, name: str) -> bool:
        return name in self.header

    def error(self, message: str, row: int | None = None, column: str | None = None) -> FileFormatError:
        """An error that names the file and, where known, the line and the column."""
        place = str(self.path)
        if row is not None:
            place += f", line {self.lines[row]}"
        if column is not None:
            place += f", column {self.labels.get(column, column)!r}"
        return FileFormatError(f"{place}: {message}")

    def cell(self, row: int, name: str) -> str:
        """One cell as text; empty where the file has no such column."""
        return self.rows[row][self.header[name]] if name in self.header else ""

    def numbers(self, names: Sequence[str], rows: range | None = None) -> Array:
        """Some columns as finite numbers, (n, len(names))."""
        places = range(len(self.rows)) if rows is None else rows
        return np.array([[self._number(row, name) for name in names] for row in places])

    def _number(self, row: int, name: str) -> float:
        text = self.cell(row, name)
        if _NUMBER.fullmatch(text) and math.isfinite(value := float(text)):
            return value
        if not text:
            fault = "the value is missing; expected a number. Fill it in, or remove the row"
        elif _DECIMAL_COMMA.fullmatch(text):
            fault = f"got {text!r}, expected a decimal point; write {text.replace(',', '.')}"
        else:
            fault = f"got {brief(text)}, expected a finite number; mend the value, or remove the row"
        raise self.error(fault, row, name)


def brief(text: str) -> str:
    """A cell in an error message: quoted, on one line, and not too long."""
    quoted = repr(text)
    return quoted if len(quoted) <= 40 else quoted[:36] + "…'"


def read_table(path: Path) -> Table:
    """The table in the file `path`, with its header as it stands there.

    Raises
    ------
    FileFormatError
        If the file cannot be read, is no text, has no header or no rows, or a row has more or fewer fields
        than the header.
    """
    lines, rows = zip(*_records(path, _text(path)), strict=True)
    names = rows[0]
    table = Table(path, {}, rows[1:], lines[1:])
    _check_header(table, names)
    if len(rows) == 1:
        raise table.error("there are no rows under the header; expected one a pose")
    for i, row in enumerate(table.rows):
        if len(row) < len(names):
            raise table.error(f"{len(row)} fields, the header has {len(names)}; the row is cut short, mend it", i)
        if len(row) > len(names):
            hint = "is there a decimal comma, or a separator too many?"
            raise table.error(f"{len(row)} fields, the header has {len(names)}; {hint}", i)
    return Table(path, {name: i for i, name in enumerate(names) if name}, table.rows, table.lines)


def _text(path: Path) -> str:
    """The file as text; the mark that some programs put before it (BOM) is no part of it."""
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileFormatError(f"{path}: cannot be read ({error.strerror})") from None
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise FileFormatError(f"{path}, line {line}: is not UTF-8 text; save the file as CSV in UTF-8") from None
    if not text.strip():
        raise FileFormatError(f"{path}: is empty; expected a header with column names, and one row a pose")
    return text


def _records(path: Path, text: str) -> Iterator[tuple[int, list[str]]]:
    """Line number and cells of every row that is not blank; a quoted cell may span lines."""
    reader = csv.reader(io.StringIO(text, newline=""), delimiter=_separator(text), strict=True)
    line = 1
    try:
        for row in reader:
            cells = [cell.strip() for cell in row]
            if cells not in ([], [""]):
                yield line, cells
            line = reader.line_num + 1
    except csv.Error as error:
        raise FileFormatError(f"{path}, line {line}: is not CSV ({error}); check the quotes in it") from None


def _separator(text: str) -> str:
    """The separator that divides the header into the most columns."""
    header = next(line for line in text.splitlines() if line.strip())
    return max(SEPARATORS, key=header.count)


def _check_header(table: Table, names: Sequence[str]) -> None:
    numbers = [name for name in names if _NUMBER.fullmatch(name)]
    if 2 * len(numbers) > len(names):
        raise table.error(f"the first row holds numbers ({numbers[0]}, …), expected column names; add a header")
    twice = sorted({name for name in names if name and names.count(name) > 1})
    if twice:
        raise table.error(f"the header names {', '.join(map(repr, twice))} more than once; rename or remove one")
