"""Metadata of a run: data, model, settings and provenance, as labels with their text."""

from collections import Counter
from typing import Any

import xarray as xr

from swarmssm.analysis.scoring.evaluation import Evaluation
from swarmssm.analysis.scoring.table import NOTHING
from swarmssm.analysis.scoring.table import format_number as number
from swarmssm.inference import Fit
from swarmssm.inference.guides import GUIDES
from swarmssm.models import PositionEmission, StateSpaceModel
from swarmssm.models.priors import prior_texts
from swarmssm.models.registry import MODELS
from swarmssm.tracks.summary import summarize

__all__ = [
    "data_metadata",
    "model_metadata",
    "parameter_rows",
    "provenance_metadata",
    "scoring_metadata",
    "setting_words",
]

Metadata = list[tuple[str, str]]

#: Attributes of tracks that say where they come from, in this order, with their labels.
ORIGIN = {
    "species": "species",
    "source": "recording",
    "scale": "scale",
    "attribution": "attribution",
    "license": "license",
    "changes": "changes made",
}
#: Numbers of one parameter that are listed at most.
MOST_ROWS = 20


def data_metadata(fit: Fit, tracks: xr.Dataset, part: str, what: str = "scored part") -> Metadata:
    """Return what was recorded, which part of it was used, and whose it is."""
    found = summarize(tracks)
    unit = found["unit"]
    rows = [
        ("individuals", str(found["individuals"])),
        ("trials", str(found["trials"])),
        (
            "frames",
            f"{found['frames']} at {number(found['fps'])} a second ({number(found['seconds'])} s)",
        ),
        ("tracked", f"{100 * found['observed']:.1f} % of individuals and frames"),
        (
            "gaps",
            f"{found['gaps']}, the longest of {found['longest_gap']} frames"
            if found["gaps"]
            else "none",
        ),
        ("unit of length", unit or "not given"),
        ("graph", _graph_words(fit)),
        (what, _part_words(fit, part)),
        (
            "source",
            " ".join(filter(None, (found["source_software"], found["source_file"]))) or "not given",
        ),
    ]
    rows += [
        (label, str(tracks.attrs[name])) for name, label in ORIGIN.items() if tracks.attrs.get(name)
    ]
    return rows


def model_metadata(fit: Fit) -> Metadata:
    """Return model, guide and what they were fitted with."""
    settings = fit.settings
    rows = [
        ("model", _described(settings.model)),
        ("guide", _described(settings.guide)),
        *_emission_words(fit),
        ("parameters", str(fit.num_parameters)),
    ]
    asked: Metadata = []
    rest: Metadata = []
    for name, value in settings.model_dump(mode="json").items():
        if name in ("model", "guide") or value is None or value == {}:
            continue
        told = (name.replace("_", " "), setting_words(value))
        (asked if isinstance(value, dict) else rest).append(told)
    return [*rows, *asked, ("further settings", "; ".join(" ".join(one) for one in rest))]


def parameter_rows(fit: Fit) -> list[dict[str, str]]:
    """Return prior and posterior of the parameters that have a prior, a row each; none without any.

    Of one that has many numbers there is a row that says so.
    """
    table = fit.summary(entries=10**9)
    columns = {"mean": "mean", "sd": "sd", "5 %": "low", "95 %": "high"}
    blank = dict.fromkeys(columns, NOTHING)
    sizes = Counter(str(name).partition("[")[0] for name in table.index)
    priors = _priors(fit)
    rows = []
    for name in map(str, table.index):
        own, place, _ = name.partition("[")
        if sizes[own] <= MOST_ROWS:
            values = {t: number(float(table[c].loc[name])) for t, c in columns.items()}
            rows.append({"parameter": name, **values, "prior": priors.get(own, NOTHING)})
        elif place and not any(row["parameter"].startswith(f"{own}:") for row in rows):
            label = f"{own}: {sizes[own]} numbers"
            rows.append({"parameter": label, **blank, "prior": priors.get(own, NOTHING)})
    return rows


def _priors(fit: Fit) -> dict[str, str]:
    """Return the priors of parameters as text, by full name and by the last part of it."""
    texts = prior_texts(fit.model)
    return {full.rpartition(".")[2]: text for full, text in texts.items()} | texts


def provenance_metadata(fit: Fit) -> Metadata:
    """Return versions, data and digests."""
    provenance = fit.provenance
    rows: Metadata = []
    if provenance.get("created"):
        rows.append(("fitted", str(provenance["created"])))
    versions = provenance.get("versions") or {}
    if versions:
        rows.append(("versions", ", ".join(f"{k} {v}" for k, v in versions.items())))
    if provenance.get("platform"):
        rows.append(("platform", str(provenance["platform"])))
    data = provenance.get("data") or {}
    rows += [(f"data: {k}", str(v)) for k, v in data.items() if v]
    rows += [(f"sha256 of {k}", str(v)) for k, v in (provenance.get("files") or {}).items()]
    return rows


def scoring_metadata(evaluation: Evaluation) -> Metadata:
    """Return how a fit was scored."""
    shown = (
        "part",
        "horizons",
        "origins",
        "futures",
        "free_run_steps",
        "starts",
        "draws",
        "seed",
        "edges",
    )
    scoring = ", ".join(
        f"{name.replace('_', ' ')} {setting_words(evaluation.settings[name])}" for name in shown
    )
    return [
        ("scored with", scoring),
        ("L (4.1)", f"{number(evaluation.settings['L'])} (scaled states)"),
    ]


def _described(name: str) -> str:
    """Return a part's name with what it is, if that is known."""
    entry = MODELS.get(name) or GUIDES.get(name)
    return name if entry is None else f"{name}. {entry.description}"


def _emission_words(fit: Fit) -> Metadata:
    """Return how a state-space model sees the states, if that is known."""
    model = fit.model
    if not isinstance(model, StateSpaceModel):
        return []
    if model.emission.is_exact:
        return [("observations", "states, taken to be exact")]
    if isinstance(model.emission, PositionEmission):
        return [("observations", "positions, with tracking noise")]
    return [("observations", type(model.emission).__name__)]


def _graph_words(fit: Fit) -> str:
    """Return who sees whom."""
    preparation = fit.preparation
    rule = "" if preparation.rule is None else str(preparation.rule)
    if preparation.own_graph:
        return f"that of the tracks ({rule})" if rule else "that of the tracks"
    return f"made by the rule {rule}"


def _part_words(fit: Fit, part: str) -> str:
    """Return which frames were looked at."""
    if part == "all":
        return "all frames"
    frames = sum(s.stop - s.start for s in fit.split.part(part))
    segments = len(fit.split.part(part))
    return f"{part}: {frames} frames of {segments} trial{'s' * (segments > 1)}"


def setting_words(value: Any) -> str:
    """Return a setting as text."""
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, dict):
        return ", ".join(f"{name} {setting_words(one)}" for name, one in value.items())
    if isinstance(value, list | tuple):
        return ", ".join(setting_words(one) for one in value)
    if isinstance(value, float):
        return f"{value:g}"
    return str(value)
