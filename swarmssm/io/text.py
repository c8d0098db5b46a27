"""Tables in text files: encoding, separator, decimal sign, and the line of whatever is wrong.

A table is looked at twice: first its header, from which a reader chooses columns, then only those
are turned into numbers. Text cells, ragged rows and infinite numbers are refused by line and
column.
"""

import codecs
import csv
import io
import re
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt
import pyarrow
import pyarrow.csv

from swarmssm.errors import InputError
from swarmssm.io.opening import check_memory, reading, shorten
from swarmssm.tracks.time_grid import Array

__all__ = ["Table", "TextTable"]

#: Cells, in lower case, that say that there is no number.
ABSENT = frozenset({"", "nan", "na", "n/a", "null", "none", "-", "."})
SEPARATORS = "\t;,"
DECIMAL_COMMA = re.compile(r"[+-]?\d*,\d+(e[+-]?\d+)?", re.IGNORECASE)
CONTROL = re.compile(r"[\x00-\x08\x0e-\x1f\x7f]")
BOMS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)
#: Rows turned into numbers in one go, so that their text need not all be held.
BLOCK = 20_000


class Table(Protocol):
    """A table whose columns are read when they are chosen."""

    path: Path
    names: list[str]

    def is_numeric(self, column: int) -> bool:
        """Return whether a column begins with a number."""
        ...

    def load(
        self, numbers: Sequence[int], texts: Sequence[int] = (), *, infinite: bool = False
    ) -> dict[int, npt.NDArray[Any]]:
        """Return columns by index: ``numbers`` as float64, ``texts`` as str."""
        ...

    def place(self, row: int) -> str:
        """Name a row in a sentence."""
        ...


class TextTable:
    """A table in a text file with a header.

    UTF-8 and, with a byte order mark, UTF-16 and UTF-32; else Windows-1252. The separator is the
    most frequent one of tab, semicolon and comma in the header, else white space. Decimal commas
    are understood where the separator is no comma. Empty lines, lines before the header that start
    with ``#``, and Excel's ``sep=;`` are passed over.

    Parameters
    ----------
    path
        The file.

    Raises
    ------
    InputError
        If it cannot be read, is empty, or is no text.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        check_memory(path, 4 * path.stat().st_size, "its text")
        self._text = _decoded(path)
        self._lines: Sequence[int] = []
        header = self._find_header()
        self.names = [name.strip().strip('"').strip() for name in self._split_one(header)]
        # A separator at the end of each line, as idTracker writes it, makes no column.
        while self.names and not self.names[-1]:
            self.names.pop()

    def _find_header(self) -> str:
        """Remember where the data begin, and return the line before."""
        self._separator: str | None = None
        start = 0
        for number, line in enumerate(self._text.split("\n"), start=1):
            start += len(line) + 1
            content = line.strip()
            if not content or content.startswith("#"):
                continue
            if re.fullmatch(r"sep=.", content, re.IGNORECASE):
                continue
            counts = {mark: line.count(mark) for mark in SEPARATORS}
            best = max(counts, key=lambda mark: counts[mark])
            self._separator = best if counts[best] else None
            self._start, self._first_line = start, number + 1
            return line
        raise InputError(f"{self.path}: the file holds no header and no rows. Export it again.")

    def _split_one(self, line: str) -> list[str]:
        if self._separator is None:
            return line.split()
        with reading(self.path, "table"):
            return next(csv.reader([line], delimiter=self._separator))

    def _rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield line number and cells of each row that is not empty."""
        body = io.StringIO(self._text[self._start :], newline="")
        if self._separator is None:
            for number, line in enumerate(body, start=self._first_line):
                if line.strip():
                    yield number, line.split()
            return
        rows = csv.reader(body, delimiter=self._separator)
        last = 0
        for cells in rows:
            # A quoted cell may span lines: the row is where it begins.
            number, last = last + self._first_line, rows.line_num
            if len(cells) > 1 or (cells and cells[0].strip()):
                yield number, cells

    def _even_rows(self) -> Iterator[tuple[int, list[str]]]:
        """Yield the rows, refusing one that is longer or shorter than the header."""
        width = len(self.names)
        for number, cells in self._rows():
            while len(cells) > width and not cells[-1].strip():
                cells.pop()
            if len(cells) != width:
                raise InputError(
                    f"{self.path}: line {number} has {len(cells)} cell{'s' * (len(cells) != 1)} "
                    f"and the header {width}. Mend that line."
                )
            yield number, cells

    def is_numeric(self, column: int) -> bool:
        """Return whether the first cell of a column that is not empty is a number."""
        with reading(self.path, "table"):
            for _, cells in self._even_rows():
                if cells[column].strip():
                    return self._is_number(cells[column].strip())
        return True

    def load(
        self, numbers: Sequence[int], texts: Sequence[int] = (), *, infinite: bool = False
    ) -> dict[int, npt.NDArray[Any]]:
        """Return columns by index.

        Parameters
        ----------
        numbers
            Columns to return as float64, NaN where a cell is empty.
        texts
            Columns to return as str.
        infinite
            Whether ``inf`` may stand for a missing number, and is returned as it is.

        Raises
        ------
        InputError
            Naming the line of a ragged row, and line and column of a text or infinite cell.
        """
        columns_at_once = self._load_at_once(numbers, texts, infinite)
        if columns_at_once is not None:
            return columns_at_once
        blocks: dict[int, list[npt.NDArray[Any]]] = {c: [] for c in (*numbers, *texts)}
        places: list[int] = []
        self._lines = places
        with reading(self.path, "table"):
            for lines, rows in self._blocks():
                places.extend(lines)
                columns = list(zip(*rows, strict=True))
                for column in texts:
                    blocks[column].append(np.array([cell.strip() for cell in columns[column]]))
                for column in numbers:
                    values = self._numbers(columns[column], column, lines)
                    if not infinite:
                        self._check_finite(values, column, lines)
                    blocks[column].append(values)
        empty = np.empty(0)
        return {c: np.concatenate(parts) if parts else empty for c, parts in blocks.items()}

    def _load_at_once(
        self, numbers: Sequence[int], texts: Sequence[int], infinite: bool
    ) -> dict[int, npt.NDArray[Any]] | None:
        """Let Arrow read a plain table, ten times faster; None if it is anything else.

        Arrow refuses uneven rows and cells that are no numbers; the way through the
        rows then finds the line, or understands what Arrow does not (quotes, decimal commas).
        """
        body = self._text[self._start :].rstrip("\n")
        # Arrow makes a row of an empty line, and takes a mark at the start for one of byte order.
        if not self._separator or '"' in body or "\n\n" in body or body[:1] in ("\n", "\ufeff"):
            return None
        types = {str(c): pyarrow.float64() for c in numbers}
        types |= {str(c): pyarrow.string() for c in texts}
        try:
            table = pyarrow.csv.read_csv(
                pyarrow.BufferReader(body.encode()),
                pyarrow.csv.ReadOptions(column_names=[str(c) for c in range(len(self.names))]),
                pyarrow.csv.ParseOptions(delimiter=self._separator, quote_char=False),
                pyarrow.csv.ConvertOptions(
                    column_types=types,
                    include_columns=list(types),
                    null_values=sorted(ABSENT),
                    strings_can_be_null=False,
                ),
            )
        except (pyarrow.ArrowException, ValueError):
            return None
        values: dict[int, npt.NDArray[Any]] = {
            c: np.array(table[str(c)].to_numpy(), dtype=np.float64) for c in numbers
        }
        if not infinite and any(np.isinf(column).any() for column in values.values()):
            return None
        for column in texts:
            cells = table[str(column)].to_pylist()
            values[column] = np.array([cell.strip() for cell in cells], dtype=str)
        self._lines = range(self._first_line, self._first_line + table.num_rows)
        return values

    def _blocks(self) -> Iterator[tuple[list[int], list[list[str]]]]:
        lines: list[int] = []
        rows: list[list[str]] = []
        for number, cells in self._even_rows():
            lines.append(number)
            rows.append(cells)
            if len(rows) == BLOCK:
                yield lines, rows
                lines, rows = [], []
        if rows:
            yield lines, rows

    def _numbers(self, cells: Sequence[str], column: int, lines: Sequence[int]) -> Array:
        """Turn cells into numbers: all at once where that goes, else one by one."""
        if not any("_" in cell for cell in cells):
            try:
                return np.array(cells, dtype=np.float64)
            except ValueError:
                pass
        values = np.empty(len(cells))
        for row, cell in enumerate(cells):
            try:
                values[row] = self._number(cell.strip())
            except ValueError:
                raise InputError(
                    f"{self.path}: line {lines[row]}, column {shorten(self.names[column])}: "
                    f"{shorten(cell)} is not a number. Mend it, or leave the cell empty."
                ) from None
        return values

    def _number(self, cell: str) -> float:
        if cell.lower() in ABSENT:
            return np.nan
        if "_" in cell:
            raise ValueError(cell)
        if self._separator != "," and DECIMAL_COMMA.fullmatch(cell):
            cell = cell.replace(",", ".")
        return float(cell)

    def _is_number(self, cell: str) -> bool:
        try:
            self._number(cell)
        except ValueError:
            return False
        return True

    def _check_finite(self, values: Array, column: int, lines: Sequence[int]) -> None:
        wrong = np.isinf(values)
        if wrong.any():
            row = int(np.argmax(wrong))
            raise InputError(
                f"{self.path}: line {lines[row]}, column {shorten(self.names[column])} is "
                f"{values[row]:g}. Leave the cell empty where an individual was not tracked."
            )

    def place(self, row: int) -> str:
        """Name a row by its line."""
        return f"line {self._lines[row]}"


def _decoded(path: Path) -> str:
    """Return a file's text with plain line ends, or refuse what is none."""
    with reading(path, "text file"):
        data = path.read_bytes()
    if not data:
        raise InputError(f"{path}: the file is empty. Export it again.")
    encoding = next((name for mark, name in BOMS if data.startswith(mark)), None)
    try:
        text = data.decode(encoding or "utf-8")
    except UnicodeDecodeError:
        text = "\0" if encoding else data.decode("cp1252", errors="replace")
    if CONTROL.search(text):
        raise InputError(
            f"{path}: this is not a text file (it holds control characters), whatever its name "
            "says. Name the right file, or export it again."
        )
    return text.replace("\r\n", "\n").replace("\r", "\n")
