"""Tables in parquet files, under the same face as those in text files."""

from collections.abc import Sequence
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import pandas as pd
import pyarrow
import pyarrow.parquet

from swarmssm.errors import InputError
from swarmssm.io.opening import check_claim, reading, shorten

__all__ = ["PARQUET_MAGIC", "ParquetTable", "table_of_frame"]

PARQUET_MAGIC = b"PAR1"


class ParquetTable:
    """A parquet file as a :class:`~swarmssm.io.text.Table`.

    Parameters
    ----------
    path
        The file.
    content
        What is in it, if it is in memory; ``path`` is then its name in errors.

    Raises
    ------
    InputError
        If it cannot be read or is not a whole parquet file.
    """

    def __init__(self, path: Path, content: BytesIO | None = None) -> None:
        self.path = path
        with reading(path, "parquet file"):
            self._file = pyarrow.parquet.ParquetFile(content or path, memory_map=False)
            self.names = [str(name) for name in self._file.schema_arrow.names]
            self.metadata: dict[bytes, bytes] = dict(self._file.schema_arrow.metadata or {})
            rows = int(self._file.metadata.num_rows)
        if content is None:
            check_claim(path, "of each column", (rows,), 8)

    def is_numeric(self, column: int) -> bool:
        """Return whether a column holds numbers or moments."""
        kind = self._file.schema_arrow.field(column).type
        types = pyarrow.types
        return not (types.is_string(kind) or types.is_large_string(kind) or types.is_binary(kind))

    def load(
        self, numbers: Sequence[int], texts: Sequence[int] = (), *, infinite: bool = False
    ) -> dict[int, npt.NDArray[Any]]:
        """Return columns by index, as :meth:`swarmssm.io.text.TextTable.load` does.

        Raises
        ------
        InputError
            If a column holds what was not asked for, an infinite number or nothing that can be
            read.
        """
        chosen = {index: self.names[index] for index in (*numbers, *texts)}
        out: dict[int, npt.NDArray[Any]] = {}
        with reading(self.path, "parquet file"):
            table = self._file.read(columns=list(chosen.values()))
            for index, name in chosen.items():
                column = table.column(name)
                if index in texts:
                    out[index] = np.array([_text(v) for v in column.to_pylist()], dtype=str)
                else:
                    out[index] = self._numbers(column, name, infinite)
        return out

    def _numbers(self, column: Any, name: str, infinite: bool) -> npt.NDArray[np.float64]:
        kind = column.type
        types = pyarrow.types
        if types.is_timestamp(kind):
            column = column.cast(pyarrow.timestamp("ns")).cast(pyarrow.int64())
            values = column.to_numpy().astype(np.float64)
            return np.asarray((values - values.min(initial=0)) / 1e9 if len(values) else values)
        if not (types.is_integer(kind) or types.is_floating(kind) or types.is_decimal(kind)):
            raise InputError(f"{self.path}: column {shorten(name)} holds {kind}, not numbers.")
        values = np.asarray(column.cast(pyarrow.float64()).to_numpy(), dtype=np.float64)
        if not infinite and np.isinf(values).any():
            row = int(np.argmax(np.isinf(values)))
            raise InputError(
                f"{self.path}: {self.place(row)}, column {shorten(name)} is {values[row]:g}. "
                "Use null where an individual was not tracked."
            )
        return values

    def place(self, row: int) -> str:
        """Name a row by its number."""
        return f"row {row}"


def table_of_frame(frame: pd.DataFrame) -> ParquetTable:
    """Return a DataFrame as a table; its index, where it has names, as columns too.

    Raises
    ------
    InputError
        If a column holds things of several kinds.
    """
    named = [name for name in frame.index.names if name is not None]
    flat = frame.reset_index(named) if named else frame
    content = BytesIO()
    try:
        flat = flat.rename(columns=str)
        pyarrow.parquet.write_table(pyarrow.Table.from_pandas(flat, preserve_index=False), content)
    except (pyarrow.ArrowException, ValueError, TypeError) as error:
        reason = " ".join(str(part) for part in error.args)
        raise InputError(f"DataFrame: a column cannot be read ({reason}).") from error
    return ParquetTable(Path("DataFrame"), content)


def _text(value: object) -> str:
    """Return a cell as a label: nothing as an empty text, 1.0 as 1."""
    if value is None:
        return ""
    if isinstance(value, float) and value.is_integer():
        return str(int(value))
    return str(value).strip()
