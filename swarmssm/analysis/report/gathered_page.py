"""One page on analyses of several sets: their rules, maps and held-out scores side by side."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import xarray as xr

from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.plots.gathered import plot_gathered_shares, plot_log_scores
from swarmssm.analysis.posterior.joining import joined
from swarmssm.analysis.report import analysis_sentences
from swarmssm.analysis.report.embed import as_svg, report_style
from swarmssm.analysis.report.held_out import (
    CAUTION,
    own_model,
    score_rows,
    score_sentence,
    shown_models,
)
from swarmssm.analysis.report.markdown import as_prose
from swarmssm.analysis.report.page import render, write_page
from swarmssm.analysis.report.panels import (
    as_panels,
    kernel_figures,
    map_figure,
    modulation_figure,
    modulation_varies,
)
from swarmssm.analysis.report.sections import Picture
from swarmssm.analysis.report.side_by_side import (
    Row,
    fact_rows,
    finding_rows,
    unit_sentence,
)
from swarmssm.errors import InputError
from swarmssm.files import check_output

__all__ = ["gathered_page", "report_gathered"]

HEADINGS = {
    "scores": "Held-out scores",
    "rules": "Rules side by side",
    "maps": "What goes with a neighbour's place",
    "influence": "Who moves whom",
    "latents": "What the latents carry",
    "words": "What the words mean",
}
PROSE = "In words"
#: What a dataset is called where it is missing; also in the notes of an analysis.
CALLED = {"forces": "forces", "kernels": "kernels of distance", "force_maps": "force maps"}
#: Sets that a title names at most.
NAMED = 4


@dataclass(frozen=True)
class Chapter:
    """What is shown and said of one set."""

    name: str
    anchor: str
    pictures: list[Picture]
    sentences: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)
    rows: list[dict[str, str]] = field(default_factory=list)


def gathered_page(
    analyses: Mapping[str, Analysis], title: str | None = None, *, text: str | None = None
) -> str:
    """Return the page as HTML; it needs no network.

    Parameters
    ----------
    analyses
        Name of the set -> what :func:`swarmssm.analysis.interpretation.analyze` returned, or
        :meth:`swarmssm.analysis.Analysis.read` read. What one of them lacks is said.
    title
        Heading; default names the sets.
    text
        A text of one's own to stand above the figures, in Markdown: what the sets show together.

    Raises
    ------
    InputError
        If there is no analysis, or one holds nothing.
    """
    if not analyses:
        raise InputError("analyses: there is nothing to gather.")
    for name, analysis in analyses.items():
        if not analysis.datasets.keys() - {"parameters"}:
            raise InputError(f"{name}: there is nothing in this analysis to report.")
    prose = (text or "").strip()
    # What starts with a heading of its own needs no other.
    headed = prose.startswith("#")
    told = [
        (which, [(name, a.verdict()) for name, a in analyses.items() if _told(a, which)])
        for which in ("influence", "latents")
    ]
    told = [(which, sentences) for which, sentences in told if sentences]
    contents = [("text", PROSE)] if prose else []
    contents += [(anchor, HEADINGS[anchor]) for anchor in ("scores", "rules", "maps")]
    contents += [(anchor, HEADINGS[anchor]) for anchor, _ in told]
    contents.append(("words", HEADINGS["words"]))
    with report_style():
        return render(
            "gathered.html",
            title=title or _title(list(analyses)),
            names=list(analyses),
            facts=fact_rows(analyses),
            units=unit_sentence(analyses),
            contents=contents,
            headings=HEADINGS,
            prose=as_prose(prose, 2 if headed else 3),
            prose_headed=headed,
            prose_heading=PROSE,
            held_out=_held_out(analyses),
            scores_missing=_scores_missing(analyses),
            caution=CAUTION,
            findings=_grouped(finding_rows(analyses)),
            shares=_shares(analyses),
            shares_missing=_missing(analyses, "forces"),
            rules=_rules(analyses),
            maps=_maps(analyses),
            maps_missing=_missing(analyses, "force_maps"),
            told=told,
        )


def report_gathered(
    analyses: Mapping[str, Analysis],
    path: str | Path,
    *,
    title: str | None = None,
    text: str | None = None,
    overwrite: bool = False,
) -> Path:
    """Write the page, beside and renamed.

    Parameters
    ----------
    analyses, title, text
        As for :func:`gathered_page`.
    path
        The file to write.
    overwrite
        Whether an existing file may be replaced.

    Returns
    -------
    The path.

    Raises
    ------
    InputError
        As :func:`gathered_page`, or if the file exists and may not be replaced.
    WorkError
        If it cannot be written; what was there before is then unchanged.
    """
    path = check_output(Path(path), overwrite=overwrite)
    return write_page(gathered_page(analyses, title, text=text), path, overwrite=overwrite)


def _title(names: list[str]) -> str:
    """Return a heading from the names of the sets."""
    if len(names) == 1:
        return f"The rule of {names[0]}"
    if len(names) <= NAMED:
        return f"The rules of {joined(names)}"
    return f"The rules of {len(names)} sets"


def _told(analysis: Analysis, which: str) -> bool:
    """Return whether something is said of a question."""
    return getattr(analysis, which) is not None


def _grouped(rows: list[Row]) -> dict[str, list[Row]]:
    """Return rows by where they come from."""
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row.group, []).append(row)
    return groups


def _missing(analyses: Mapping[str, Analysis], which: str) -> list[str]:
    """Say of each set that lacks a dataset that it does, and why if that is known."""
    called = CALLED[which]
    sentences = []
    for name, analysis in analyses.items():
        if getattr(analysis, which) is not None:
            continue
        left = f"Left out: {called}. "
        why = next((n.removeprefix(left) for n in analysis.notes if n.startswith(left)), "")
        sentences.append(f"{name}: its analysis has no {called}. {why}".rstrip())
    return sentences


def _scores_missing(analyses: Mapping[str, Analysis]) -> list[str]:
    """Say which sets have no scores, in one sentence."""
    names = [name for name, analysis in analyses.items() if analysis.scores is None]
    if not names:
        return []
    which = "None of the analyses" if len(names) == len(analyses) > 1 else joined(names)
    verb = "has" if len(names) == 1 or which.startswith("None") else "have"
    # Of one set or all there is nothing to hold the rule against.
    return [
        f"{which} {verb} {'' if which.startswith('None') else 'no '}log scores of held-out frames: "
        "whether the rule forecasts better than no rule is not told here."
    ]


def _held_out(analyses: Mapping[str, Analysis]) -> list[Chapter]:
    """Draw log scores against the horizon, one colour a model in all sets."""
    scored = {name: a.scores for name, a in analyses.items() if a.scores is not None}
    models = list(
        dict.fromkeys(model for found in scored.values() for model in shown_models(found))
    )
    chapters = []
    for name, found in scored.items():
        analysis = analyses[name]
        own = own_model(found, str(analysis.settings.get("model", "")))
        text = score_sentence(found, own)
        told = analysis.verdict()
        index = list(analyses).index(name)
        title = f"{name}: log score ahead"
        drawn = plot_log_scores(found, models=models)[0]
        svg = as_svg(drawn, f"s{index}-scores", f"{title}. {text}")
        picture = Picture(title, "", f"{text} {told}".strip(), svg)
        notes = [str(note) for note in found.attrs.get("notes", ())]
        chapters.append(
            Chapter(name, f"s{index}-scores", [picture], notes=notes, rows=score_rows(found))
        )
    return chapters


def _shares(analyses: Mapping[str, Analysis]) -> list[Picture]:
    """Draw the shares of the forces of all sets that have them."""
    there = {name: a.forces for name, a in analyses.items() if a.forces is not None}
    if not there:
        return []
    title = "How large each force is"
    said = " ".join(f"{name}: {analyses[name].verdict()}" for name in there)
    text = (
        "A force's share of the sum of the mean strengths, with 90 % intervals, which hold if the "
        "model's terms are the right ones."
    )
    return [
        Picture(
            title, "", text, as_svg(plot_gathered_shares(there)[0], "shares", f"{title}. {said}")
        )
    ]


def _rules(analyses: Mapping[str, Analysis]) -> list[Chapter]:
    """Draw the kernels of each set, or say that there are none."""
    chapters = []
    for index, (name, analysis) in enumerate(analyses.items()):
        found = analysis.kernels
        pictures = [] if found is None else [_kernels(f"s{index}-rule", name, found, analysis)]
        sentences = _missing({name: analysis}, "kernels")
        if _told(analysis, "forces"):
            sentences.append(analysis.verdict())
        chapters.append(Chapter(name, f"s{index}-rules", pictures, sentences, list(analysis.notes)))
    return chapters


def _kernels(anchor: str, name: str, found: xr.Dataset, analysis: Analysis) -> Picture:
    """Draw the kernels of one set, with the factor of the direction if there is one."""
    figures = kernel_figures(found)
    text = analysis.verdict()
    if modulation_varies(found):
        figures.append(modulation_figure(found))
        text = f"{text} {analysis_sentences.modulation(found)}".strip()
    title = "What a neighbour does at each distance"
    return Picture(title, "", text, as_panels(figures, anchor, f"{name}. {title}. {text}"))


def _maps(analyses: Mapping[str, Analysis]) -> list[Picture]:
    """Draw the force maps of each set that has them, the model beside the raw data."""
    pictures = []
    for index, (name, analysis) in enumerate(analyses.items()):
        if analysis.force_maps is None:
            continue
        text = ""
        alt = f"{name}. Force maps. {text}"
        svg = as_svg(map_figure(analysis.force_maps), f"s{index}-maps", alt)
        pictures.append(Picture(name, "", text, svg))
    return pictures
