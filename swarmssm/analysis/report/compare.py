"""Analyses of several sets on one page: forces, kernels, maps and held-out scores side by side."""

import math
from collections.abc import Mapping

import numpy as np
import pandas as pd
import xarray as xr

from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.interpretation.summary import Row, rows_of
from swarmssm.analysis.plots.gathered import plot_gathered_shares, plot_log_scores
from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.report.contents import glossary, kernel_figures, mean_scores, sections
from swarmssm.analysis.report.embed import report_style
from swarmssm.analysis.report.markdown import as_prose
from swarmssm.analysis.report.page import (
    Block,
    Grid,
    Note,
    Page,
    Prose,
    Section,
    Table,
    Verdict,
    figure,
)
from swarmssm.analysis.scoring.table import NOTHING, format_number, format_unit
from swarmssm.errors import InputError

__all__ = ["comparison_page", "unit_note"]

#: Summaries that name an individual make no row of several sets.
NO_ROWS = ("influence",)
#: The length of a pixel depends on the camera.
PIXELS = ("px", "pixel", "pixels", "")
SHARES = (
    "Share of each force in the sum of the mean strengths, with 90 % intervals, which hold if the "
    "terms of the model are the right ones."
)
KERNELS = (
    "What a neighbour at each distance does: positive towards it, negative away; bands are 90 % "
    "intervals. Each set has axes of its own."
)
SCORES = "Mean log score of held-out positions, nats per coordinate; higher is better."


def comparison_page(
    analyses: Mapping[str, Analysis], title: str | None = None, *, text: str | None = None
) -> Page:
    """Return one page on several analyses.

    Parameters
    ----------
    analyses
        Name of the set -> what :func:`swarmssm.analysis.interpretation.analyze` returned, or
        :meth:`swarmssm.analysis.Analysis.read` read. The page names what one of them lacks.
    title
        Heading; default names the sets.
    text
        A text of the user's own, in Markdown, that stands first.

    Raises
    ------
    InputError
        If there is no analysis, or one holds nothing.
    """
    if not analyses:
        raise InputError("analyses: there is nothing to compare.")
    for name, analysis in analyses.items():
        if not analysis.datasets.keys() - {"parameters"}:
            raise InputError(f"{name}: there is nothing in this analysis to report.")
    blocks: list[Block] = []
    if text and text.strip():
        blocks.append(Prose(as_prose(text.strip(), 2)))
    blocks += [Verdict(f"{name}:", one.verdict()) for name, one in analyses.items()]
    blocks.append(Note(_notes(analyses)))
    blocks.append(
        Table("Main results, medians with 90 % intervals over the draws", _results(analyses))
    )
    with report_style():
        forces = {name: one.forces for name, one in analyses.items() if one.forces is not None}
        if forces:
            blocks.append(figure("Shares of the forces", SHARES, plot_gathered_shares(forces)[0]))
        kernels = [
            [figure(f"{name}: kernels of distance", KERNELS, kernel_figures(one.kernels))]
            for name, one in analyses.items()
            if one.kernels is not None
        ]
        scores = _scores(analyses)
    blocks += [Grid(cells) for cells in (kernels, scores) if cells]
    blocks.append(
        Section(
            "Recordings, models and settings",
            [Table("A column for each set", _metadata(analyses))],
            folded=True,
        )
    )
    for name, analysis in analyses.items():
        found = sections({k: one for k, one in analysis.datasets.items() if k != "scores"})
        blocks.append(Section(name, [Note(analysis.notes), *found], folded=True))
    return Page(title or _title(list(analyses)), [*blocks, glossary()])


def unit_note(analyses: Mapping[str, Analysis]) -> str:
    """Return what may be compared between the sets; nothing of one."""
    units = {name: _unit(analysis) for name, analysis in analyses.items()}
    if len(units) < 2:
        return ""
    free = "Shares, factors and correlations have no unit and can be compared."
    if len(set(units.values())) > 1:
        named = "; ".join(f"{name}: {unit or 'not given'}" for name, unit in units.items())
        return (
            f"The units of length differ ({named}): distances, forces and log scores cannot be "
            f"compared between sets. {free}"
        )
    unit = next(iter(units.values()))
    if unit in PIXELS:
        what = "All lengths are in pixels" if unit else "No unit of length is given"
        return (
            f"{what}, which differ between cameras: distances, forces and log scores can be "
            f"compared within a set only. {free}"
        )
    return f"All lengths are in {unit}."


def _notes(analyses: Mapping[str, Analysis]) -> list[str]:
    """Return the units, and what each set lacks, with the reason if it is known."""
    notes = [unit_note(analyses)]
    for name, analysis in analyses.items():
        for which, words in (
            ("forces", "forces"),
            ("kernels", "kernels of distance"),
            ("force_maps", "force maps"),
            ("scores", "held-out scores"),
        ):
            if getattr(analysis, which) is not None:
                continue
            left = f"Left out: {words}. "
            why = next((n.removeprefix(left) for n in analysis.notes if n.startswith(left)), "")
            notes.append(f"{name}: its analysis has no {words}. {why}".rstrip())
    return [note for note in notes if note]


def _results(analyses: Mapping[str, Analysis]) -> pd.DataFrame:
    """Return a row for each quantity that any set has, a column for each set."""
    columns = {
        name: {
            f"{one.analysis}: {one.quantity}": _value(one)
            for one in rows_of(analysis.datasets)
            if one.analysis not in NO_ROWS
        }
        for name, analysis in analyses.items()
    }
    labels = list(dict.fromkeys(label for column in columns.values() for label in column))
    # Of one analysis together, in the order in which the analyses appear.
    groups = list(dict.fromkeys(label.partition(":")[0] for label in labels))
    labels.sort(key=lambda label: groups.index(label.partition(":")[0]))
    frame = pd.DataFrame(
        {name: [column.get(label, NOTHING) for label in labels] for name, column in columns.items()}
    )
    frame.index = pd.Index(labels, name="result")
    return frame


def _value(found: Row) -> str:
    """Return a number with its interval and unit."""
    if not math.isfinite(found.value):
        return NOTHING
    text = f"{_number(found, found.value)} {format_unit(found.unit)}".rstrip()
    if math.isfinite(found.low) and math.isfinite(found.high):
        text += f" ({_number(found, found.low)} to {_number(found, found.high)})"
    return text


def _number(found: Row, value: float) -> str:
    """Return three digits, of a percentage no more than are of use."""
    if found.unit == "%":
        return f"{value:.0f}" if abs(value) >= 10 else f"{value:.1f}"
    return format_number(value)


def _scores(analyses: Mapping[str, Analysis]) -> list[list[Block]]:
    """Draw log scores against the horizon, one colour a model in all sets."""
    scored = {name: one.scores for name, one in analyses.items() if one.scores is not None}
    models = list(
        dict.fromkeys(str(m) for found in scored.values() for m in found["model"].to_numpy())
    )
    return [
        [
            figure(f"{name}: log score", SCORES, plot_log_scores(found, models=models)[0]),
            Table(f"{name}: {SCORES}", means),
        ]
        for name, found in scored.items()
        if (means := mean_scores("log_score")(found)) is not None
    ]


def _metadata(analyses: Mapping[str, Analysis]) -> pd.DataFrame:
    """Return what each analysis is of, a column for each set."""
    rows = {}
    for name, analysis in analyses.items():
        settings = analysis.settings
        part = str(settings.get("part", NOTHING))
        rows[name] = {
            "individuals": _count(analysis, "individual"),
            "trials": _count(analysis, "trial"),
            "frames": _frames(analysis),
            "unit of length": _unit(analysis) or "not given",
            "model": str(settings.get("model", NOTHING)),
            "guide": str(settings.get("guide") or NOTHING),
            "part": "all frames" if part == "all" else part,
            "draws": str(settings.get("draws", NOTHING)),
            "seed": str(settings.get("seed", NOTHING)),
            "version": str(settings.get("version", NOTHING)),
        }
    frame = pd.DataFrame(rows)
    frame.index.name = "set"
    return frame


def _unit(analysis: Analysis) -> str:
    units = (str(one.attrs.get("unit", "")) for one in analysis.datasets.values())
    return next(filter(None, units), "")


def _count(analysis: Analysis, dim: str) -> str:
    sizes = [one.sizes[dim] for one in analysis.datasets.values() if dim in one.sizes]
    return str(sizes[0]) if sizes else NOTHING


def _frames(analysis: Analysis) -> str:
    """Return how many frames there are, and how long they last."""
    timed = [one for one in analysis.datasets.values() if "time" in one.sizes]
    if not timed:
        return NOTHING
    least: xr.Dataset = min(timed, key=lambda one: int(one.attrs.get("stride", 1)))
    stride = int(least.attrs.get("stride", 1))
    seconds = least["time"].to_numpy()
    long = f", {format_number(float(np.ptp(seconds)))} s" if len(seconds) > 1 else ""
    if stride == 1:
        return f"{len(seconds)}{long}"
    return f"about {len(seconds) * stride}{long}; one in {stride} kept"


def _title(names: list[str]) -> str:
    return f"Comparison of {joined(names)}" if len(names) <= 4 else f"{len(names)} sets compared"
