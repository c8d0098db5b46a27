"""A Methods paragraph for a paper: how a fit and its analysis were made, with their numbers."""

import xarray as xr

from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.scoring.table import format_number, format_unit
from swarmssm.inference import Fit
from swarmssm.models.priors import prior_texts
from swarmssm.tracks.summary import summarize

__all__ = ["methods_text"]

PARTS = ("train", "validation", "test")
NAMES = {"train": "training", "validation": "validation", "test": "test"}


def methods_text(analysis: Analysis, fit: Fit, tracks: xr.Dataset) -> str:
    """Return a section in Markdown to paste into a paper, and to edit.

    Data, model and priors, inference, split, analysis, forecast test and versions, all as the run
    folder and the analysis record them.

    Parameters
    ----------
    analysis, fit, tracks
        An analysis, its fit and its tracks.
    """
    paragraphs = [
        _data(tracks),
        _model(fit),
        _inference(fit),
        _analysis(analysis),
        _versions(analysis, fit),
    ]
    return "# Methods\n\n" + "\n\n".join(paragraphs) + "\n"


def _data(tracks: xr.Dataset) -> str:
    found = summarize(tracks)
    source = " ".join(filter(None, (found["source_software"], found["source_file"])))
    unit = format_unit(found["unit"]) or "the unit of the file"
    return (
        f"**Data.** Positions of {found['individuals']} individuals in {found['trials']} "
        f"trial{'s' * (found['trials'] != 1)}, {found['frames']} frames a trial at "
        f"{format_number(found['fps'])} frames per second ({format_number(found['seconds'])} s), "
        f"in {unit}{f', from {source}' if source else ''}. Of all individuals and frames "
        f"{100 * found['observed']:.1f} % were tracked."
    )


def _model(fit: Fit) -> str:
    settings = fit.settings
    options = ", ".join(f"{name} = {value}" for name, value in settings.model_options.items())
    rule = "the graph of the tracks" if fit.preparation.own_graph else str(fit.preparation.rule)
    text = (
        f"**Model.** swarmssm model `{settings.model}`{f' ({options})' if options else ''}, "
        f"neighbours by {rule}, states scaled by `{fit.preparation.scaler.kind}`."
    )
    priors = [f"{name} ~ {prior}" for name, prior in _priors(fit)]
    if priors:
        text += f" Priors, in units of the scaled states and seconds: {'; '.join(priors)}."
    return text


def _priors(fit: Fit) -> list[tuple[str, str]]:
    """Return the name and the text of each prior."""
    return [(full.rpartition(".")[2], text) for full, text in prior_texts(fit.model).items()]


def _inference(fit: Fit) -> str:
    settings = fit.settings
    window = "whole trials" if settings.window is None else f"windows of {settings.window} frames"
    frames = []
    for part in PARTS:
        segments = fit.split.part(part)
        if segments:
            count = sum(segment.stop - segment.start for segment in segments)
            frames.append(
                f"{count} frames of {len(segments)} trial{'s' * (len(segments) > 1)} for "
                f"{NAMES[part]}"
            )
    return (
        f"**Inference.** Approximate posterior by the guide `{settings.guide}`, on {window}, "
        f"learning rate {settings.lr:g} ({settings.schedule} schedule), seed {settings.seed}; "
        f"the weights with the best validation loss were kept. The recording was split into "
        f"{joined(frames)}."
    )


def _analysis(analysis: Analysis) -> str:
    settings = analysis.settings
    part = settings["part"]
    frames = "all frames" if part == "all" else f"the {NAMES[part]} part"
    text = (
        f"**Analysis.** Forces, kernels and influence were computed on {frames} from "
        f"{settings['draws']} posterior draws (seed {settings['seed']}); intervals are the central "
        "90 % over draws."
    )
    if analysis.scores is not None:
        scores = analysis.scores
        horizons = joined([str(k) for k in scores["horizon"].to_numpy()])
        others = joined([str(name) for name in scores["model"].to_numpy()[1:]])
        text += (
            f" Forecasts from {scores.sizes['origin']} frames ({scores.attrs['part']} part), "
            f"{horizons} steps ahead, {scores.attrs['draws']} draws each, were compared with "
            f"{others} by the continuous ranked probability score of positions, with 90 % "
            "moving-block bootstrap intervals of paired differences."
        )
    if analysis.delays is not None:
        text += (
            " Delays between directions of movement follow Nagy et al. (2010), up to "
            f"{format_number(float(analysis.delays.attrs['max_delay']))} s."
        )
    return f"{text} Result: {analysis.verdict()}"


def _versions(analysis: Analysis, fit: Fit) -> str:
    versions = fit.provenance.get("versions") or {}
    listed = ", ".join(f"{name} {version}" for name, version in versions.items())
    digest = (fit.provenance.get("data") or {}).get("sha256", "")
    own = analysis.settings["version"]
    text = f"**Software.** Fitted with {listed}; analysed with swarmssm {own}."
    return f"{text} SHA-256 of the tracks: `{digest}`." if digest else text
