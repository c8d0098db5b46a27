"""A report is one whole page that stands by itself: its answer first, the rest folded."""

import html.parser
import itertools
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
import xarray as xr
from markupsafe import Markup
from matplotlib.figure import Figure as Drawing

from swarmssm import inference
from swarmssm.analysis import evaluate, run_page, run_section
from swarmssm.analysis.report import (
    Grid,
    Note,
    Page,
    Player,
    Prose,
    Section,
    Table,
    Verdict,
    contents,
    figure,
    run,
)
from swarmssm.analysis.report.answer import trust_verdict
from swarmssm.analysis.report.embed import as_svg
from swarmssm.errors import InputError

VOID = {"area", "br", "col", "hr", "img", "input", "link", "meta", "source", "wbr"}
UNSEEN = {"style", "script", "title", "noscript", "option"}
FEW = {"horizons": (1, 5), "free_run_steps": 10, "draws": 2, "starts": 2, "origins": 10}
BRIEF = {"checks": 0, "forces": False, "player": False}
EVIL = "<script>alert('&')</script>\"'><img src=x>$\\frac"
#: Of a report, for one model.
MOST_WORDS, MOST_BYTES = 600, 3_000_000


class Read(html.parser.HTMLParser):
    """Reads a page; fails on tags that are not closed in their order."""

    def __init__(self, text):
        super().__init__()
        self.open, self.tags, self.text = [], [], []
        self.feed(text)
        self.close()
        assert self.open == []

    def handle_starttag(self, tag, attrs):
        self.tags.append((tag, dict(attrs), tuple(self.open)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag, attrs):
        self.tags.append((tag, dict(attrs), tuple(self.open)))

    def handle_endtag(self, tag):
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data):
        self.text.append((tuple(self.open), data))

    def named(self, name):
        return [attrs for tag, attrs, _ in self.tags if tag == name]

    def words(self, *, folded=True):
        seen = (
            text
            for path, text in self.text
            if not UNSEEN & set(path) and (folded or "details" not in path)
        )
        return " ".join(" ".join(seen).split())


def check_whole(text):
    """Nothing comes from elsewhere, names are unique, links arrive, headings go down in turn."""
    page = Read(text)
    places = [attrs["id"] for _, attrs, _ in page.tags if "id" in attrs]
    assert len(places) == len(set(places))
    for _, attrs, _ in page.tags:
        for name in ("src", "href", "xlink:href", "srcset", "action", "data"):
            value = attrs.get(name) or "data:,"
            assert value.startswith(("#", "data:")), (name, value[:80])
            assert not value.startswith("#") or value[1:] in places
    for address in re.findall(r"url\(([^)]*)\)", text):
        assert address.removeprefix("#") in places
    assert "@import" not in text
    assert "#000000" not in text.split("</style>")[1]
    levels = [int(tag[1]) for tag, _, _ in page.tags if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))
    for attrs in page.named("th"):
        assert attrs["scope"] in ("row", "col")
    assert len(page.named("caption")) == len(page.named("table"))
    for attrs in page.named("svg"):
        assert attrs["role"] == "img"
        assert attrs["aria-label"]
    return page


def drawn():
    figure = Drawing()
    figure.add_subplot().plot([0, 1], [0, 1], color="black")
    return figure


def test_each_block_stands_on_the_page_in_its_place():
    frame = pd.DataFrame(
        {"number": [1.23456, np.nan], "text": ["a", EVIL]}, pd.Index(["x", "y"], name="row")
    )
    page = Page("Title", subtitle="Below").add(
        Verdict("Question:", "answer."),
        Grid([[Table("Caption", frame, "foot")], [figure("Drawn", "How to read it.", drawn())]]),
        Section("Open", [Section("Folded", [Prose("inside"), Note(["remark"])], folded=True)]),
        figure("Twice", "Two panels.", [drawn(), drawn()], "4.1"),
        Table("Without rows", frame.iloc[:0]),
        Player("Moving", "Left and right.", Markup("<p>canvas</p>")),
    )
    text = page.html()
    read = check_whole(text)
    words = read.words()
    cells = [data for path, data in read.text if {"td", "th"} & set(path)]
    assert cells == ["row", "number", "text", "x", "1.23", "a", "y", "–", EVIL]
    assert "Without rows" not in words
    assert len(read.named("svg")) == 3
    assert "inside" in words
    assert "inside" not in read.words(folded=False)
    assert "Open" in read.words(folded=False)
    # All players share one script.
    assert text.count("<script>") == 1
    assert "currentColor" in text
    assert "prefers-color-scheme: dark" in text


def test_a_page_is_written_whole_and_not_over_another(tmp_path):
    path = tmp_path / "r.html"
    page = Page("One", [Prose("text")])
    assert page.write(path) == path
    with pytest.raises(InputError, match="exists already"):
        page.write(path)
    Page("Other", [Prose("text")]).write(path, overwrite=True)
    assert "<h1>Other</h1>" in path.read_text(encoding="utf-8")
    with pytest.raises(InputError, match="nothing to report"):
        Page("Empty").write(tmp_path / "empty.html")
    with pytest.raises(InputError, match="does not exist"):
        page.write(tmp_path / "none" / "r.html")
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


def test_glyphs_that_matplotlib_lacks_are_no_trouble():
    one = drawn()
    one.axes[0].set_xlabel("厘米")
    assert "厘米" in as_svg(one, "学校")


def test_captions_are_fixed_and_sections_known():
    for one in contents.CONTENTS:
        assert one.section in contents.HEADINGS
        assert one.caption
        assert not re.search(r"[{}]", one.caption)


@pytest.fixture(scope="module")
def evaluation(quick_fit, boids):
    return evaluate(quick_fit, boids, **FEW)


def headings(blocks):
    return [one.heading for one in blocks if isinstance(one, Section)]


@pytest.fixture(scope="module")
def whole(boids, tmp_path_factory):
    """A report with all sections, of a model of forces, and what was told while it was made."""
    # Few steps are enough: what is tested is that each section is there, not what it says.
    fit = inference.fit(
        "boids",
        boids,
        guide="linearized",
        model_options={"limits": False, "walls": False},
        steps=5,
        guide_options={"globals": "multivariate"},
    )
    other = inference.fit("graph-vae", boids, guide="encoder", epochs=1)
    told = []
    with pytest.MonkeyPatch.context() as patch:
        quick = {
            "FORCE_DRAWS": 2,
            "PLAYED": 10,
            "one_step_pit": partial(run.one_step_pit, draws=10, origins=8),
        }
        for name, value in quick.items():
            patch.setattr(run, name, value)
        page = run_page(
            fit, boids, checks=12, against={"vae": other}, progress=told.append, **FEW, futures=10
        )
    return page.html(), page, told, fit


def test_a_whole_report_is_short_until_it_is_unfolded(whole):
    text, page, told, fit = whole
    read = check_whole(text)
    assert len(text.encode()) <= MOST_BYTES
    assert len(read.words(folded=False).split()) <= MOST_WORDS
    assert [one.label for one in page.blocks if isinstance(one, Verdict)] == [
        "What moves the animals:",
        "How far to trust it:",
    ]
    (grid,) = [one for one in page.blocks if isinstance(one, Grid)]
    kinds = [type(one).__name__ for cell in grid.cells for one in cell]
    assert kinds == ["Table", "Table", "Figure", "Player"]
    expected = ["forces", "kernels", "force_maps", "forecasts", "comparison", "checks", "model"]
    expected += ["training", "data", "provenance"]
    names = [contents.HEADINGS[name] for name in expected]
    assert headings(page.blocks) == [*names, "Glossary"]
    words = read.words()
    assert not re.findall("Left out: .{100}", words)
    assert "LogNormal" in words
    assert "vae" in words
    assert fit.provenance["data"]["sha256"] in words
    assert len(read.named("canvas")) == 2
    assert len(told) == 5


def test_the_numbers_of_the_first_screen_are_those_of_the_results(whole):
    _, page, _, _ = whole
    (grid,) = [one for one in page.blocks if isinstance(one, Grid)]
    forces, trust = (one for cell in grid.cells for one in cell if isinstance(one, Table))
    assert set(forces.frame.columns) >= {"strength", "90 % interval", "share", "R² with truth"}
    assert {"cohesion", "separation", "alignment"} <= set(forces.frame.index)
    assert (np.diff(forces.frame["strength"]) <= 0).all()
    assert list(trust.frame.index) == ["skill", "90 % interval", "coverage"]
    assert list(trust.frame.columns) == ["1 step", "5 steps"]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("size", [(1400, 900), (400, 800)])
def test_the_first_screen_has_the_answer_and_plays(visit, whole, scheme, size):
    view = {"width": size[0], "height": size[1]}
    page = visit(whole[0], viewport=view, color_scheme=scheme)
    player = page.locator(".swarm-player")
    page.locator('.swarm-player[data-state="ready"]').wait_for()
    for verdict in page.locator(".verdict").all():
        box = verdict.bounding_box()
        assert box["y"] + box["height"] < view["height"]
    first = page.locator("table").first.bounding_box()
    assert first["y"] < view["height"]
    if size[0] > 1000:
        for one in (page.locator("figure svg").first, player.locator("canvas").first):
            assert one.bounding_box()["y"] < view["height"] / 2
    player.locator('[data-part="play"]').click()
    for _ in range(100):
        if player.evaluate("own => own.player.frame") > 0:
            break
        page.wait_for_timeout(100)
    assert player.evaluate("own => own.player.frame") > 0
    # What is wider than a telephone scrolls by itself, not the page with it.
    assert page.evaluate("document.documentElement.scrollWidth") <= view["width"]


def test_checks_that_fail_are_counted():
    checks = xr.Dataset(
        {"verdict": ("statistic", ["mismatch", "mismatch", "consistent", "unknown"])}
    )
    assert "in 2 of 3 statistics" in trust_verdict(None, checks)
    assert "not known" in trust_verdict(None)


def test_graphs_are_shown_only_where_they_vary(planted, monkeypatch):
    monkeypatch.setattr(contents, "figure", lambda title, *_: Prose(title))

    def titles(density):
        evaluation = planted()
        edges = evaluation.edges.assign(density=(("trial", "time"), density))
        found = contents.sections({"evaluation": replace(evaluation, edges=edges)}, ["forecasts"])
        return [one.text for one in found[0].blocks if isinstance(one, Prose)]

    shape = planted().edges["accuracy"].isel(predictor=0).shape
    assert "Accuracy of the next graph" in titles(np.full(shape, 0.3))
    for density in (1.0, 0.0):
        assert "Accuracy of the next graph" not in titles(np.full(shape, density))


def test_hostile_names_stay_text(planted, quick_fit, boids):
    names = [f"{EVIL}{i}" for i in range(5)]
    tracks = boids.assign_coords(individual=names, neighbor=names)
    tracks = tracks.assign_coords(trial=[f"{EVIL}{i}" for i in range(4)])
    for name in ("unit", "source_file", "species", "license"):
        tracks.attrs[name] = EVIL
    evaluation = planted(unit=EVIL, notes=(EVIL,))
    provenance = quick_fit.provenance | {"platform": EVIL, "data": {"file": EVIL}}
    fit = replace(quick_fit, provenance=provenance)
    text = run_page(fit, tracks, title=EVIL, evaluation=evaluation, **BRIEF).html()
    page = check_whole(text)
    assert "<script" not in text
    assert not page.named("img")
    assert page.words().count("<script>alert('&')</script>") >= 8


def test_several_runs_share_a_page(quick_fit, boids, evaluation):
    several = [
        run_section(name, quick_fit, boids, evaluation=evaluation, **BRIEF)
        for name in ("One", "Two")
    ]
    read = check_whole(Page("Both", several).html())
    assert {"One", "Two"} <= {text.strip() for path, text in read.text if path[-1:] == ("h2",)}
    # The thesis's printed numbers stand beside its model, and are no scores of the same frames.
    assert "thesis Table II (boids)" in read.words()
    assert "compare with no other row" in read.words()
    for note in evaluation.notes:
        assert note in read.words()


def test_what_is_not_available_is_named(quick_fit, boids, evaluation, monkeypatch):
    def refuse(*args, **kwargs):
        raise InputError("statistics: there are none.")

    monkeypatch.setattr(run, "check", refuse)
    monkeypatch.setattr(run, "one_step_pit", refuse)
    section = run_section(
        "Run", quick_fit, boids, evaluation=evaluation, forces=False, player=False
    )
    notes = [line for one in section.blocks if isinstance(one, Note) for line in one.lines]
    assert "Left out: simulating swarms. statistics: there are none." in notes
    assert contents.HEADINGS["checks"] not in headings(section.blocks)


def test_the_tracks_of_others_are_attributed(quick_fit, boids, evaluation):
    def data(tracks):
        section = run_section("Run", quick_fit, tracks, evaluation=evaluation, **BRIEF)
        (found,) = [
            one
            for one in section.blocks
            if getattr(one, "heading", "") == contents.HEADINGS["data"]
        ]
        (table,) = [one for one in found.blocks if isinstance(one, Table)]
        return dict(table.frame.to_numpy())

    assert "license" not in data(boids)
    credited = data(boids.assign_attrs(license="CC BY 4.0", attribution="Someone (2020)"))
    assert credited["license"] == "CC BY 4.0"
    assert credited["attribution"] == "Someone (2020)"
