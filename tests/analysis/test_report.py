"""The report is one whole page: readable, honest, and nobody else's code."""

import html.parser
import itertools
import re
from dataclasses import replace
from functools import partial

import numpy as np
import pandas as pd
import pytest
from markupsafe import Markup

from swarmssm import inference
from swarmssm.analysis import (
    build_report,
    evaluate,
    full_section,
    horizon_table,
    plots,
    report_run,
    write_report,
)
from swarmssm.analysis.report import build, panels, section_of, sections
from swarmssm.analysis.report.embed import as_svg
from swarmssm.errors import InputError
from swarmssm.inference import Fit

VOID = {"area", "br", "col", "hr", "img", "input", "link", "meta", "source", "wbr"}
FEW = {"horizons": (1, 5), "free_run_steps": 10, "draws": 2, "starts": 2, "origins": 10}
BRIEF = {"checks": 0, "forces": False, "player": False}
EVIL = "<script>alert('&')</script>\"'><img src=x>$\\frac"


class Page(html.parser.HTMLParser):
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
        self.text.append((self.open[-1] if self.open else "", data))

    def named(self, name):
        return [attrs for tag, attrs, _ in self.tags if tag == name]

    def words(self):
        return " ".join(" ".join(text for tag, text in self.text if tag != "style").split())


@pytest.fixture(scope="module")
def evaluation(quick_fit, boids):
    return evaluate(quick_fit, boids, **FEW)


@pytest.fixture(scope="module")
def page_text(quick_fit, boids, evaluation):
    both = [
        section_of("First", quick_fit, boids, evaluation, anchor="run1"),
        section_of("Second", quick_fit, boids, evaluation, anchor="run2"),
    ]
    return build_report(both, "Both")


@pytest.fixture(scope="module")
def page(page_text):
    return Page(page_text)


@pytest.fixture
def no_pictures(monkeypatch):
    """Leave figures out where only words are looked at."""
    monkeypatch.setattr(sections, "_pictures", lambda anchor, evaluation: [])


def test_nothing_comes_from_elsewhere(page_text, page):
    for _, attrs, _ in page.tags:
        for name in ("src", "href", "xlink:href", "srcset", "action", "data"):
            value = attrs.get(name) or "#"
            assert value.startswith(("#", "data:image/png;base64,")), (name, value[:80])
    for address in re.findall(r"url\(([^)]*)\)", page_text):
        assert address.startswith("#"), address
    assert "@import" not in page_text
    assert not page.named("script")
    assert not page.named("link")


def test_what_is_linked_to_is_there(page):
    places = [attrs["id"] for _, attrs, _ in page.tags if "id" in attrs]
    assert len(places) == len(set(places))
    for _, attrs, _ in page.tags:
        for name in ("href", "xlink:href", "clip-path", "aria-labelledby"):
            value = attrs.get(name, "")
            if value.startswith(("#", "url(#")) or name == "aria-labelledby":
                target = value.removeprefix("url(").removesuffix(")").removeprefix("#")
                assert target in places or not value, value


def test_each_figure_has_words_for_those_who_do_not_see_it(page):
    pictures = page.named("svg")
    # Of eleven figures of a run training has three panels, and errors ahead two.
    assert len(pictures) == 28
    for attrs in pictures:
        assert attrs["role"] == "img"
        assert len(attrs["aria-label"]) > 20
    assert len(page.named("figcaption")) == 22
    for attrs in page.named("img"):
        assert attrs.get("alt")
    titles = [data for tag, data in page.text if tag == "title"]
    assert len(titles) == 29


@pytest.mark.usefixtures("no_pictures")
def test_one_run_has_its_title_once(quick_fit, boids, evaluation):
    page = Page(build_report([section_of("Only", quick_fit, boids, evaluation)], "Only"))
    check_headings(page)
    titles = [data for tag, data in page.text if re.fullmatch(r"h[1-6]", tag)]
    assert titles.count("Only") == 1
    assert "Findings" in titles


def test_headings_go_down_one_by_one(page):
    check_headings(page)
    assert page.named("html")[0]["lang"] == "en"
    assert page.named("meta")[1]["name"] == "viewport"


def check_headings(page):
    levels = [int(tag[1]) for tag, _, _ in page.tags if re.fullmatch(r"h[1-6]", tag)]
    assert levels[0] == 1
    assert levels.count(1) == 1
    assert all(after <= before + 1 for before, after in itertools.pairwise(levels))


def test_tables_name_their_rows_and_columns(page):
    for attrs in page.named("th"):
        assert attrs["scope"] in ("row", "col")
    assert len(page.named("caption")) == len(page.named("table")) == 14


def test_it_has_the_log_scores_and_the_posterior_of_named_parameters(
    page, evaluation, boids, monkeypatch
):
    row = horizon_table(evaluation, "log_score")[0]
    assert set(row.values()) - {"graph-vae"} <= set(page.words().split())
    assert "Log score of positions" in page.words()
    assert "Prior and posterior of the named parameters, with" not in page.words()
    gains = pd.DataFrame(
        {"mean": 0.4321, "sd": 0.01, "low": 0.41, "high": 0.45},
        index=["cohesion_gain", *(f"weight[{i}]" for i in range(30))],
    )
    monkeypatch.setattr(sections, "_pictures", lambda anchor, evaluation: [])
    monkeypatch.setattr(Fit, "summary", lambda fit, entries: gains)
    fit = inference.fit("graph-vae", boids, guide="encoder", epochs=1, seed=0)
    words = Page(build_report([section_of("Run", fit, boids, evaluation)])).words()
    assert "Prior and posterior of the named parameters, with" in words
    assert "cohesion_gain" in words
    assert "0.432" in words
    assert words.count("weight: 30 numbers") == 1
    assert "weight[3]" not in words


def test_figures_take_the_ink_of_the_page(page_text):
    assert len(page_text) < 6_000_000
    assert "currentColor" in page_text
    assert "#000000" not in page_text.split("</style>")[1]
    assert "prefers-color-scheme: dark" in page_text
    assert "@media print" in page_text


def test_it_says_what_was_found(page, evaluation, quick_fit):
    words = page.words()
    assert "Both" in words
    assert "Constant velocity has the lower one-step error" in words
    assert "thesis Table II (boids)" in words
    assert "compare with no other row" in words
    assert f"{quick_fit.num_parameters}" in words
    assert quick_fit.provenance["data"]["sha256"] in words
    assert quick_fit.provenance["versions"]["torch"] in words
    for note in evaluation.notes:
        assert note in words


@pytest.mark.usefixtures("no_pictures")
def test_the_verdict_flips_with_the_numbers(planted, quick_fit, boids):
    def page_of(**scores):
        evaluation = planted(**scores)
        return Page(build_report([section_of("Run", quick_fit, boids, evaluation)])).words()

    good = page_of(mse=(0.02, 0.13, 0.2), squared_error=(0.1, 1.0, 1.0))
    assert "graph-vae beats the best of the simple rivals" in good
    assert "graph-vae has the lower one-step error: MSE 0.0200 against 0.130" in good
    bad = page_of(mse=(0.13, 0.2, 0.02), squared_error=(2.0, 1.0, 1.0))
    assert "graph-vae beats" not in bad
    assert "does worse than" in bad
    assert "Constant velocity has the lower one-step error: MSE 0.0200 against 0.130" in bad


def test_where_all_are_linked_nothing_is_said_of_predicting_graphs(
    planted, quick_fit, boids, monkeypatch
):
    # Which figures there are counts, not what they look like.
    monkeypatch.setattr(panels, "as_svg", lambda figure, name, alt: Markup("<svg></svg>"))

    def chapters(density):
        evaluation = planted()
        edges = evaluation.edges.assign(density=(("trial", "time"), density))
        found = section_of("Run", quick_fit, boids, replace(evaluation, edges=edges))
        words = Page(build_report([found])).words()
        pictures = [
            block.title for one in found.chapters for block in one.blocks if block.kind == "picture"
        ]
        return found.reasons, words, pictures

    shape = planted().edges["accuracy"].isel(predictor=0).shape
    reasons, words, pictures = chapters(np.full(shape, 0.3))
    assert "Accuracy of the next graph" in pictures
    assert any("of the next graph" in reason for reason in reasons)
    for density in (1.0, 0.0):
        reasons, words, pictures = chapters(np.full(shape, density))
        assert "no graph is to be predicted" in words
        assert "Accuracy of the next graph" not in pictures
        assert "Who sees whom, true and predicted" not in pictures
        assert not any("graph" in reason.replace("graph-vae", "") for reason in reasons)


def test_hostile_names_stay_text(planted, quick_fit, boids):
    names = [f"{EVIL}{i}" for i in range(5)]
    tracks = boids.assign_coords(individual=names, neighbor=names)
    tracks = tracks.assign_coords(trial=[f"{EVIL}{i}" for i in range(4)])
    for name in ("unit", "source_file", "species", "license"):
        tracks.attrs[name] = EVIL
    evaluation = planted(unit=EVIL, notes=(EVIL,))
    provenance = quick_fit.provenance | {"platform": EVIL, "data": {"file": EVIL}}
    fit = replace(quick_fit, provenance=provenance)
    text = build_report([section_of(EVIL, fit, tracks, evaluation, anchor=EVIL)], EVIL)
    page = Page(text)
    assert "<script" not in text
    assert not page.named("script")
    assert not page.named("img")
    assert page.words().count("<script>alert('&')</script>") >= 8


def test_glyphs_that_matplotlib_lacks_are_no_trouble(planted):
    figure, _ = plots.plot_collective(planted().collective, unit="厘米")
    assert "AMD (厘米)" in as_svg(figure, "f", "学校")


@pytest.mark.usefixtures("no_pictures")
def test_the_tracks_of_others_need_no_attribution(planted, quick_fit, boids):
    def facts(tracks):
        chapters = section_of("Run", quick_fit, tracks, planted()).chapters
        assert chapters[0].heading == "Data"
        return chapters[0].blocks[0].rows

    assert "license" not in dict(facts(boids))
    credited = boids.assign_attrs(license="CC BY 4.0", attribution="Someone (2020)")
    assert ("license", "CC BY 4.0") in facts(credited)
    assert ("attribution", "Someone (2020)") in facts(credited)


@pytest.mark.usefixtures("no_pictures")
def test_a_report_is_written_whole_and_not_over_another(tmp_path, quick_fit, boids, evaluation):
    path = tmp_path / "r.html"
    assert report_run(quick_fit, boids, path, evaluation=evaluation, **BRIEF) == path
    text = path.read_text(encoding="utf-8")
    Page(text)
    assert "<h1>graph-vae on tracks</h1>" in text
    with pytest.raises(InputError, match="exists already"):
        report_run(quick_fit, boids, path, evaluation=evaluation)
    assert path.read_text(encoding="utf-8") == text
    again = {"title": "Other", "evaluation": evaluation, "overwrite": True}
    report_run(quick_fit, boids, path, **again, **BRIEF)
    assert "<h1>Other</h1>" in path.read_text(encoding="utf-8")
    assert [p.name for p in tmp_path.iterdir()] == ["r.html"]


@pytest.mark.usefixtures("no_pictures")
def test_many_runs_share_a_page(tmp_path, quick_fit, boids, evaluation):
    path = tmp_path / "r.html"
    several = [
        full_section("One", quick_fit, boids, anchor="one", evaluation=evaluation, **BRIEF),
        full_section("Two", quick_fit, boids, anchor="two", **BRIEF, **FEW),
    ]
    write_report(several, path, title="All")
    page = Page(path.read_text(encoding="utf-8"))
    headings = {data.strip() for tag, data in page.text if tag == "h2"}
    assert {"In short", "One", "Two"} <= headings
    assert page.words().count("graph-vae is right on") == 2


@pytest.mark.usefixtures("no_pictures")
def test_mistakes_are_told(tmp_path, quick_fit, boids, planted):
    with pytest.raises(InputError, match="nothing to report"):
        build_report([])
    section = section_of("Run", quick_fit, boids, planted())
    with pytest.raises(InputError, match="anchors must differ"):
        build_report([section, section])
    with pytest.raises(InputError, match="does not exist"):
        write_report([section], tmp_path / "none" / "r.html")


@pytest.fixture(scope="module")
def whole(boids, tmp_path_factory):
    """A report with all chapters, of a model of forces, and what was told while it was made."""
    # Few steps are enough: what is tested is that each chapter is there, not what it says.
    simple = {"limits": False, "walls": False}
    fit = inference.fit(
        "boids",
        boids,
        guide="linearized",
        model_options=simple,
        steps=5,
        guide_options={"globals": "multivariate"},
    )
    rival = inference.fit("graph-vae", boids, guide="encoder", epochs=1)
    told = []
    path = tmp_path_factory.mktemp("whole") / "whole.html"
    with pytest.MonkeyPatch.context() as patch:
        quick = {
            "FORCE_DRAWS": 2,
            "PLAYED": 10,
            "one_step_pit": partial(build.one_step_pit, draws=10, origins=8),
            "score": partial(build.score, draws=10, origins=5, horizons=(1, 5)),
        }
        for name, value in quick.items():
            patch.setattr(build, name, value)
        options = {"checks": 12, "progress": told.append, **FEW}
        report_run(fit, boids, path, rivals={"vae": rival}, **options)
    return path.read_text(encoding="utf-8"), told


def test_a_whole_report_has_checks_forces_comparison_and_a_player(whole):
    text, told = whole
    page = Page(text)
    check_headings(page)
    headings = [data.strip() for tag, data in page.text if tag == "h2"]
    for name in ("Data", "Model", "Training", "Forecasts", "Checks", "Forces and kernels"):
        assert headings.count(name) == 1, name
    assert headings.index("Checks") < headings.index("Comparison") < headings.index("Provenance")
    words = page.words()
    assert not re.findall("Left out: .{100}", words)
    assert "LogNormal" in words
    assert "vae" in words
    assert len(page.named("canvas")) == 2
    assert text.count("<script") - text.count('type="application/json"') == 1
    places = [attrs["id"] for _, attrs, _ in page.tags if "id" in attrs]
    assert len(places) == len(set(places))
    assert len(told) == 6
    assert len(text) < 15_000_000


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_in_a_browser_it_is_quiet_plays_and_fits_a_telephone(visit, whole, scheme):
    narrow = {"width": 420, "height": 800}
    page = visit(whole[0], viewport=narrow, color_scheme=scheme)
    player = page.locator(".swarm-player")
    player.wait_for()
    page.locator('.swarm-player[data-state="ready"]').wait_for()
    player.locator('[data-part="play"]').click()
    for _ in range(100):
        if player.evaluate("own => own.player.frame") > 0:
            break
        page.wait_for_timeout(100)
    assert player.evaluate("own => own.player.frame") > 0
    # What is wider than a telephone scrolls by itself, not the page with it.
    assert page.evaluate("document.documentElement.scrollWidth") <= narrow["width"]


@pytest.mark.usefixtures("no_pictures")
def test_what_cannot_be_had_is_said(quick_fit, boids, evaluation, monkeypatch):
    def refuse(*args, **kwargs):
        raise InputError("statistics: there are none.")

    monkeypatch.setattr(build, "check", refuse)
    monkeypatch.setattr(build, "one_step_pit", refuse)
    section = full_section(
        "Run", quick_fit, boids, evaluation=evaluation, forces=False, player=False
    )
    text = build_report([section])
    assert "Left out: simulating swarms. statistics: there are none." in text
    assert not any(chapter.heading == "Checks" for chapter in section.chapters)
