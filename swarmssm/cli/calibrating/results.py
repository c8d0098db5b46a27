"""What a study leaves: a NetCDF file, a picture, tables and a sentence."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from swarmssm.cli.calibrating.studies import Study
from swarmssm.cli.console import print_json, print_rows, say
from swarmssm.cli.options import TableFormat
from swarmssm.files import write_beside

if TYPE_CHECKING:
    import xarray as xr
    from matplotlib.figure import Figure

__all__ = ["print_study", "write_study"]


def write_study(found: "xr.Dataset", study: Study, out: Path, picture: Path) -> bool:
    """Write the dataset and the picture; return whether there was anything to draw."""
    from swarmssm import io

    io.write_dataset(found, out, overwrite=True)
    figure = _drawn(found, study)
    if figure is None:
        return False
    with write_beside(picture, overwrite=True) as temporary:
        figure.savefig(temporary, format=picture.suffix[1:].lower(), dpi=150)
    return True


def print_study(found: "xr.Dataset", study: Study, format: TableFormat) -> None:
    """Print tables, the sentence, and what failed."""
    sentence, tables = _told(found, study)
    failures = str(found.attrs["failures"])
    if format is TableFormat.json:
        names = ("calibration",) if study is Study.calibration else ("errors", "needs")
        result: dict[str, Any] = dict(zip(names, tables.values(), strict=True))
        print_json({**result, "sentence": sentence, "failures": failures})
        return
    for title, rows in tables.items():
        print_rows(title, rows)
    say(sentence)
    if failures:
        say(f"Failed: {failures}")


def _drawn(found: "xr.Dataset", study: Study) -> "Figure | None":
    """Return the picture; none of a recovery of a single setting."""
    from swarmssm.analysis.plots.calibration import plot_calibration
    from swarmssm.analysis.plots.recovery import plot_recovery, varied_factors

    if study is Study.calibration:
        return plot_calibration(found)[0]
    return plot_recovery(found)[0] if varied_factors(found) else None


def _told(found: "xr.Dataset", study: Study) -> tuple[str, dict[str, list[dict[str, Any]]]]:
    """Return the sentence, and tables by their titles."""
    from swarmssm.analysis.diagnostics.calibration.ranks import (
        calibration_sentence,
        calibration_table,
    )
    from swarmssm.analysis.diagnostics.recovery.table import (
        recovery_needs,
        recovery_sentence,
        recovery_table,
    )

    if study is Study.calibration:
        return calibration_sentence(found), {"": calibration_table(found)}
    title = (
        f"median error ± half the 90 % interval (! beyond {100 * found.attrs['tolerance']:.0f} %)"
    )
    tables = {title: recovery_table(found), "good enough at": recovery_needs(found)}
    return recovery_sentence(found), tables
