"""What a study of simulated data writes: finished data sets, a NetCDF file and a figure."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from swarmssm.cli.console import say
from swarmssm.errors import InputError, WorkError
from swarmssm.files import check_output, write_beside

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["Output"]

FIGURES = (".png", ".svg", ".pdf")


@dataclass(frozen=True)
class Output:
    """Files of a study, checked before any work is done.

    Attributes
    ----------
    out, figure, rows
        NetCDF file, figure, and the JSON lines of finished data sets.
    resume
        Whether finished data sets are kept.
    """

    out: Path
    figure: Path
    rows: Path
    resume: bool

    @classmethod
    def of(cls, out: Path, figure: Path | None, resume: bool, overwrite: bool) -> "Output":
        """Return the files.

        Raises
        ------
        InputError
            If one may not be written, or holds an interrupted study that is not to be resumed.
        """
        again = overwrite or resume
        check_output(out, overwrite=again)
        picture = out.with_suffix(".png") if figure is None else figure
        if picture.suffix.lower() not in FIGURES:
            raise InputError(f"--figure: {picture} must end in one of {', '.join(FIGURES)}.")
        rows = out.with_suffix(".jsonl")
        if out in (rows, picture):
            raise InputError(f"--out: {out} must be a NetCDF file; let it end in .nc.")
        check_output(picture, overwrite=again)
        if rows.exists() and not again:
            raise InputError(
                f"{rows}: it holds data sets of an unfinished study. Use --resume to continue it, "
                "--overwrite to start anew, or another --out."
            )
        check_output(rows, overwrite=again)
        return cls(out, picture, rows, resume)

    @contextmanager
    def resumable(self) -> Iterator[None]:
        """Keep finished data sets if the work is interrupted.

        A new study sets an old file of rows aside. If it ends before any data set is finished, the
        old file is put back.
        """
        old = None
        if not self.resume and self.rows.exists():
            old = self.rows.with_name(f".{self.rows.name}.old")
            self.rows.replace(old)
        existed = self.rows.exists()
        try:
            yield
        except KeyboardInterrupt:
            left = "No data set was finished."
            if self._finished():
                left = f"Finished data sets are in {self.rows}; continue with --resume."
            raise WorkError(f"interrupted. {left}") from None
        finally:
            if not existed and not self._finished():
                self.rows.unlink(missing_ok=True)
            if old is not None:
                if self.rows.exists():
                    old.unlink(missing_ok=True)
                else:
                    old.replace(self.rows)

    def _finished(self) -> int:
        """Return the number of finished data sets; the first line of the file has the settings."""
        return max(self.rows.read_bytes().count(b"\n") - 1, 0) if self.rows.exists() else 0

    def write(self, data: "xr.Dataset", figure: "Figure | None") -> None:
        """Write the result and its figure."""
        from swarmssm import io

        io.write_dataset(data, self.out, overwrite=True)
        if figure is not None:
            with write_beside(self.figure, overwrite=True) as temporary:
                figure.savefig(temporary, format=self.figure.suffix[1:].lower(), dpi=150)

    def tell(self, figure: "Figure | None") -> None:
        """Print which files were written."""
        drawn = "" if figure is None else f", {self.figure}"
        say(f"{self.out}{drawn}: written. Finished data sets: {self.rows}.")
