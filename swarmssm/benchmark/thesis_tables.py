"""Tables I and II of the thesis, done again from a benchmark."""

from swarmssm.analysis.scoring.table import NOTHING, format_number
from swarmssm.analysis.scoring.thesis import thesis_rows, thesis_table_for
from swarmssm.benchmark.results import Results

__all__ = ["FOOTNOTE", "thesis_table"]

#: The three methods of the thesis, in its order, as it used them: with direct output.
METHODS = ("graph-vae", "dygrencoder-direct", "dcrnn-direct")
FOOTNOTE = (
    "The printed figures are of the thesis's own recordings, at a scale and in a unit that it does "
    "not give: they cannot be compared with these. The order of the methods within a column can."
)


def thesis_table(results: Results) -> tuple[str, list[dict[str, str]]]:
    """Return caption and rows of the thesis's table; no rows if its methods were not measured.

    MSE (4.2) is of one step, AMD (4.4) and AVD (4.5) are means over a free run without noise; the
    true ones stand in the caption.
    """
    if not any(results.rows.get(name, {}).get("seeds") for name in METHODS):
        return "", []
    which = thesis_table_for(results.task.tracks)
    rows = []
    for name, printed in zip(METHODS, thesis_rows(which), strict=True):
        row = results.rows.get(name, {})
        cells = {"method": name}
        for title, fact, value in (
            ("MSE (4.2)", "mse", printed.mse),
            ("AMD (4.4)", "amd", printed.amd),
            ("AVD (4.5)", "avd", printed.avd),
        ):
            cells[title] = format_number(row[fact]) if row.get("seeds") else NOTHING
            cells[f"{title}, printed"] = format_number(value)
        rows.append(cells)
    truth = next(row for row in results.rows.values() if row["seeds"])
    number = "II (boids)" if which == "boids" else "I (guppies)"
    caption = (
        f"Table {number} of the thesis, done again; of the truth AMD is "
        f"{format_number(truth['amd_true'])} and AVD {format_number(truth['avd_true'])}"
    )
    return caption, rows
