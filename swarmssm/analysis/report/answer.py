"""The first screen of a report: what moves the animals, and how far to trust it."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np
import pandas as pd
import xarray as xr

from swarmssm.analysis.interpretation.result import ANALYSES
from swarmssm.analysis.interpretation.verdict import forecast_verdict, rule_verdict
from swarmssm.analysis.report.contents import kernel_figures
from swarmssm.analysis.report.embed import report_style
from swarmssm.analysis.report.page import Block, Grid, Table, Verdict, figure
from swarmssm.analysis.scoring.references import REFERENCES
from swarmssm.analysis.scoring.summaries import score_table
from swarmssm.analysis.scoring.table import NOTHING, format_unit
from swarmssm.analysis.scoring.table import format_number as number
from swarmssm.analysis.scoring.verdicts import skill_at

__all__ = ["answer", "trust_verdict"]

TRUST = (
    "Forecasts: CRPS skill over the better of staying put and constant velocity (0: no better), "
    "and share of observations within 90 % intervals"
)
KERNELS = (
    "Positive is towards the neighbour, negative away. Bands: 90 % intervals. Grey: density of "
    "distances."
)


def answer(results: Mapping[str, Any]) -> list[Block]:
    """Return verdicts, forces, kernels, trust and a player: what is read first.

    Parameters
    ----------
    results
        As for :func:`swarmssm.analysis.report.contents.sections`, and ``player``.
    """
    found = {name: one for name, one in results.items() if name in ANALYSES and one is not None}
    forces, kernels = found.get("forces"), found.get("kernels")
    scores, checks = results.get("scores"), results.get("checks")
    verdicts: list[Block] = []
    numbers: list[Block] = []
    pictures: list[Block] = []
    if rule := rule_verdict(found):
        verdicts.append(Verdict("What moves the animals:", rule))
    verdicts.append(Verdict("How far to trust it:", trust_verdict(scores, checks)))
    if forces is not None:
        unit = format_unit(str(forces["mean_magnitude"].attrs.get("units", "")))
        caption = f"Mean strength of each force{f' in {unit}' if unit else ''}, and its share"
        numbers.append(Table(caption, _forces_table(forces)))
    if scores is not None and not REFERENCES.keys().isdisjoint(scores["model"].to_numpy()):
        numbers.append(Table(TRUST, _trust_table(scores)))
    if kernels is not None:
        with report_style():
            drawn = kernel_figures(kernels)
        pictures.append(figure("What a neighbour does at each distance", KERNELS, drawn))
    if results.get("player") is not None:
        pictures.append(results["player"])
    if not numbers and not pictures:
        return verdicts
    cells = [cell for cell in (numbers, pictures[:1], pictures[1:]) if cell]
    return [*verdicts, Grid(cells)]


def trust_verdict(scores: xr.Dataset | None, checks: xr.Dataset | None = None) -> str:
    """Return whether forecasts beat the best simple baseline, and what the checks found.

    Parameters
    ----------
    scores
        From :func:`swarmssm.analysis.scoring.score`.
    checks
        From :func:`swarmssm.analysis.diagnostics.checks.check`.
    """
    sentences = [forecast_verdict(scores)]
    if checks is not None:
        verdicts = checks["verdict"].to_numpy().astype(str)
        known = int((verdicts != "unknown").sum())
        differ = int((verdicts == "mismatch").sum())
        sentences.append(
            f"Simulated swarms differ from the recording in {differ} of {known} statistics."
        )
    return " ".join(sentences)


def _forces_table(forces: xr.Dataset) -> pd.DataFrame:
    """Return mean strength and share of each force, with intervals."""
    strength = forces["mean_magnitude"].sel(quantile=[0.05, 0.5, 0.95]).transpose(..., "term")
    low, middle, high = strength.to_numpy()
    share = 100.0 * forces["share"].sel(quantile=0.5).to_numpy()
    frame = pd.DataFrame(
        {
            "strength": middle,
            "90 % interval": [
                f"{number(float(a))} to {number(float(b))}" for a, b in zip(low, high, strict=True)
            ],
            "share": [f"{one:.0f} %" for one in share],
        },
        index=pd.Index([str(name) for name in forces["term"].to_numpy()], name="force"),
    )
    if "truth_r_squared" in forces:
        frame["R² with truth"] = forces["truth_r_squared"].to_numpy()
    return frame.iloc[np.argsort(-np.nan_to_num(middle))]


def _trust_table(scores: xr.Dataset) -> pd.DataFrame:
    """Return skill and coverage at the first, a middle and the last horizon."""
    model = str(scores["model"].to_numpy()[0])
    horizons = scores["horizon"].to_numpy().tolist()
    steps = sorted({horizons[0], horizons[len(horizons) // 2], horizons[-1]})
    covered = score_table(scores, "coverage").sel(model=model)
    skills = [skill_at(scores, model, step) for step in steps]
    ends = [(_percent(one.low), _percent(one.high)) for one in skills]
    rows = {
        "skill": [_percent(one.value, signed=True) for one in skills],
        "90 % interval": [f"{low} to {high}" if low != high else NOTHING for low, high in ends],
        "coverage": [_percent(float(covered.sel(horizon=step))) for step in steps],
    }
    columns = [f"{step} step{'s' * (step > 1)}" for step in steps]
    frame = pd.DataFrame.from_dict(rows, orient="index", columns=columns)
    frame.index.name = "measure"
    return frame


def _percent(share: float, *, signed: bool = False) -> str:
    """Return a share in percent, one far below zero as such."""
    if math.isnan(share):
        return number(math.nan)
    if share < -1.0:
        return "below -100 %"
    return f"{100 * share:{'+' if signed else ''}.0f} %"
