"""Chapters that a report may have besides its own: checks, and comparison with rivals."""

from collections.abc import Sequence

import numpy as np
import xarray as xr

from swarmssm.analysis.diagnostics.checks.pit import ForecastCalibration
from swarmssm.analysis.diagnostics.checks.result import PredictiveCheck
from swarmssm.analysis.plots.checks import (
    plot_check_overview,
    plot_order_parameters,
    plot_pit,
    plot_statistic,
)
from swarmssm.analysis.plots.scores import plot_forecast_coverage, plot_scores
from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.report.blocks import Block, Chapter, Notes, Picture, Rows, Table
from swarmssm.analysis.report.embed import as_svg
from swarmssm.analysis.report.held_out import shown_models
from swarmssm.analysis.report.panels import as_panels
from swarmssm.analysis.scoring.summaries import score_table
from swarmssm.analysis.scoring.table import NOTHING, format_unit
from swarmssm.analysis.scoring.table import format_number as number
from swarmssm.analysis.scoring.verdicts import verdict as scores_verdict

__all__ = ["check_chapter", "comparison_chapter"]

#: What a statistic of a verdict is called in the order in which they are told.
VERDICTS = ("mismatch", "borderline", "consistent", "unknown")
#: Statistics that are drawn one by one at most, those that tell most first.
DRAWN = 9
#: Of the intervals whose coverage is told.
LEVEL = 0.9
#: Order parameters in words.
ORDER = {"amd": "AMD", "avd": "AVD"}
OVERVIEW = (
    "Each row is a statistic: the dot is the recording, the bar holds 90 % of the simulated swarms."
)
OVER_TIME = (
    "The first run, and the band of 90 % of the swarms simulated from the same start. If the model "
    "is right the recording is within it in 90 % of the frames, on average; here {found}."
)
STATISTICS = (
    "The statistics that tell most, the recording beside the swarms simulated from the model; the "
    "band holds 90 % of them at each point."
)
COVERAGE = (
    "How often what came was within the forecasts' central intervals of {level}. Below the "
    "horizontal line a model is surer than it may be, above it less sure than it could be."
)


def check_chapter(
    anchor: str, checked: xr.Dataset | None, pit: xr.Dataset | None = None
) -> Chapter:
    """Return what posterior predictive checks found; without any, a chapter without blocks.

    Parameters
    ----------
    anchor
        Of the section, which names of figures start with.
    checked
        From :func:`swarmssm.analysis.diagnostics.checks.check`.
    pit
        From :func:`swarmssm.analysis.diagnostics.checks.one_step_pit`.
    """
    blocks: list[Block] = []
    if checked is not None:
        blocks += _checked(anchor, checked)
    if pit is not None:
        text = ForecastCalibration(pit).verdict()
        title = "How sure one-step forecasts are"
        svg = as_svg(plot_pit(pit)[0], f"{anchor}-pit", f"{title}. {text}")
        blocks.append(Picture(title, "", text, svg))
    return Chapter("checks", "Checks", blocks)


def _checked(anchor: str, checked: xr.Dataset) -> list[Block]:
    """Return overview, table, and pictures of what tells most."""
    text = PredictiveCheck(checked).verdict()
    title = "Does the model make swarms like this one"
    overview = as_svg(plot_check_overview(checked)[0], f"{anchor}-checks", f"{title}. {text}")
    blocks: list[Block] = [
        Picture(title, "", f"{text} {OVERVIEW}", overview),
        Table(
            "Statistics of the recording beside those of simulated swarms; p corrected is for "
            "asking so many questions",
            _verdict_rows(checked),
            "plain words",
        ),
    ]
    if bool(checked["series_observed"].notnull().any()):
        name = "Order parameters over time"
        text = OVER_TIME.format(found=_within_band(checked))
        svg = as_svg(plot_order_parameters(checked)[0], f"{anchor}-order", f"{name}. {text}")
        blocks.append(Picture(name, "", text, svg))
    telling = [
        str(name)
        for name in checked["statistic"].to_numpy()[_by_place(checked)]
        if str(checked["verdict"].sel(statistic=name).item()) != "unknown"
    ][:DRAWN]
    if telling:
        name = "Where recording and model differ most"
        figures = [plot_statistic(checked, one)[0] for one in telling]
        svg = as_panels(figures, f"{anchor}-statistics", f"{name}. {STATISTICS}")
        blocks.append(Picture(name, "", STATISTICS, svg))
    blocks.append(Notes([line for line in str(checked.attrs["notes"]).splitlines() if line]))
    return blocks


def _within_band(checked: xr.Dataset) -> str:
    """Return in which share of the frames of the first run each order parameter is in the band."""
    own = checked["series_observed"].isel(run=0)
    low, high = (checked["series_replicated"].isel(run=0, quantile=end) for end in (0, -1))
    inside = ((own >= low) & (own <= high)).where(own.notnull() & low.notnull()).mean("step")
    told = []
    for name in inside["series"].to_numpy():
        share = float(inside.sel(series=name))
        if not np.isnan(share):
            word = ORDER.get(str(name), str(name))
            told.append(f"{word} is in {100 * share:.0f} %")
    return joined(told)


def _by_place(checked: xr.Dataset) -> "np.ndarray[tuple[int], np.dtype[np.intp]]":
    """Return the order of statistics, those of the smallest p first."""
    p_values = np.nan_to_num(checked["p_value"].to_numpy(), nan=2.0)
    far = -np.nan_to_num(np.abs(checked["place"].to_numpy()))
    return np.lexsort((far, p_values))


def _verdict_rows(checked: xr.Dataset) -> Rows:
    """Return a row for each statistic."""
    rows = []
    for index in _by_place(checked):
        one = checked.isel(statistic=int(index))
        rows.append(
            {
                "statistic": str(one["title"].item()),
                "p": _or_nothing(float(one["p_value"])),
                "p corrected": _or_nothing(float(one["p_adjusted"])),
                "verdict": str(one["verdict"].item()),
            }
        )
    return rows


def _or_nothing(value: float) -> str:
    """Return a number, or a dash where it is not known."""
    return NOTHING if np.isnan(value) else number(value, 2)


def comparison_chapter(anchor: str, scores: xr.Dataset | None) -> Chapter:
    """Return the model beside its rivals on the same frames; without scores, no blocks.

    Parameters
    ----------
    anchor
        Of the section, which names of figures start with.
    scores
        From :func:`swarmssm.analysis.scoring.score`.
    """
    if scores is None:
        return Chapter("comparison", "Comparison")
    text = scores_verdict(scores)
    drawn = [plot_scores(scores, score)[0] for score in ("log_score", "crps")]
    title = "Scores against the number of steps ahead"
    blocks: list[Block] = [
        Picture(title, "", text, as_panels(drawn, f"{anchor}-scores", f"{title}. {text}"))
    ]
    for score, words in (
        ("log_score", "Log score of positions, nats per coordinate (higher is better)"),
        ("crps", f"CRPS of a coordinate, {_unit(scores)} (lower is better)"),
        ("energy_score", f"Energy score of a position, {_unit(scores)} (lower is better)"),
        ("coverage", "Share of coordinates within the central 90 % interval"),
    ):
        blocks.append(
            Table(f"{words}, at so many steps ahead", _score_rows(scores, score), "plain")
        )
    name = "Coverage of the forecasts' intervals"
    text = COVERAGE.format(level=f"{100 * LEVEL:.0f} %")
    svg = as_svg(plot_forecast_coverage(scores, level=LEVEL)[0], f"{anchor}-coverage", text)
    blocks.append(Picture(name, "", text, svg))
    blocks.append(Notes(_lines(scores.attrs.get("notes", ""))))
    return Chapter("comparison", "Comparison", blocks)


def _score_rows(scores: xr.Dataset, score: str) -> Rows:
    """Return a row for each model."""
    table = score_table(scores, score)
    return [
        {"model": title}
        | {
            str(int(step)): number(float(table.sel({"model": name, "horizon": step})))
            for step in table["horizon"].to_numpy()
        }
        for name, title in shown_models(scores).items()
    ]


def _unit(scores: xr.Dataset) -> str:
    """Return the unit of length, or words for that of the tracks."""
    unit = format_unit(str(scores["crps"].attrs.get("units", "")))
    return unit or "in the tracks' unit of length"


def _lines(notes: str | Sequence[str]) -> list[str]:
    """Return notes that are one text with line breaks, or several."""
    several = notes.splitlines() if isinstance(notes, str) else notes
    return [str(note) for note in several if note]
