"""One page on several analyses: what each has is there, what one lacks is named."""

import html
import re
from dataclasses import replace

import pytest

from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.report import Grid, Note, Section, Table, Verdict, comparison_page
from swarmssm.analysis.report.compare import unit_note
from swarmssm.errors import InputError


@pytest.fixture(scope="module")
def page(flock, shoal, sparse):
    """The page on three sets, one of which has forces alone."""
    return comparison_page({"flock": flock, "shoal <1>": shoal, "sparse": sparse}, text="All.")


@pytest.fixture(scope="module")
def text(page):
    """Its text."""
    return page.html()


def tables(page):
    return {one.caption: one.frame for one in page.blocks if isinstance(one, Table)}


def notes(page):
    return [line for one in page.blocks if isinstance(one, Note) for line in one.lines]


def test_it_needs_nothing_but_itself(text):
    for address in re.findall(r'(?:src|href)="([^"]*)"', text):
        assert address.startswith(("#", "data:")), address
    assert "<script" not in text
    assert len(text) < 3e6
    places = re.findall(r'\bid="([^"]*)"', text)
    assert len(places) == len(set(places))
    for used in re.findall(r'xlink:href="#([^"]*)"', text):
        assert used in places


def test_names_of_sets_are_text(text):
    assert "shoal &lt;1&gt;" in text
    assert "shoal <1>" not in text


def test_each_set_has_its_verdict_and_its_figures(page, text):
    verdicts = [one.label for one in page.blocks if isinstance(one, Verdict)]
    assert verdicts == ["flock:", "shoal <1>:", "sparse:"]
    kernels, scores = (one.cells for one in page.blocks if isinstance(one, Grid))
    assert len(kernels) == 2
    assert len(scores) == 1
    folded = [one.heading for one in page.blocks if isinstance(one, Section)]
    assert folded[1:-1] == verdicts_without_colon(verdicts)
    drawn = re.findall(r'<svg [^>]*role="img"[^>]*aria-label="([^"]*)"', text)
    assert len(drawn) > 10
    assert all(drawn)
    assert text.count("<figure>") == text.count("<figcaption>")


def verdicts_without_colon(verdicts):
    return [one.removesuffix(":") for one in verdicts]


def test_what_is_compared_is_a_column_each(page):
    (section,) = [one for one in page.blocks if getattr(one, "heading", "").startswith("Record")]
    frame = section.blocks[0].frame
    assert list(frame.columns) == ["flock", "shoal <1>", "sparse"]
    assert list(frame.loc["individuals"]) == ["5"] * 3
    assert list(frame.loc["trials"]) == ["4"] * 3
    # 60 frames at 10 a second, of which the last is 5.9 s after the first.
    assert list(frame.loc["frames"]) == ["60, 5.90 s"] * 3
    assert frame.loc["unit of length", "shoal <1>"] == "cm"
    assert list(frame.loc["model"]) == ["graph-vae"] * 3


def test_what_may_be_compared_follows_from_the_units(page, shoal):
    assert any("shoal <1>: cm" in note for note in notes(page))
    assert unit_note({"shoal": shoal}) == ""
    assert unit_note({"a": shoal, "b": shoal}) == "All lengths are in cm."
    pixels = replace(shoal, forces=shoal.forces.assign_attrs(unit="px"))
    assert "within a set only" in unit_note({"a": pixels, "b": pixels})


def test_numbers_of_all_sets_stand_in_one_row(page, flock):
    (frame,) = tables(page).values()
    share = flock.forces["share"].sel(term="alignment")
    low, middle, high = (100 * float(share.sel(quantile=q)) for q in (0.05, 0.5, 0.95))

    def short(value):
        return f"{value:.0f}" if value >= 10 else f"{value:.1f}"

    expected = f"{short(middle)} % ({short(low)} to {short(high)})"
    (label,) = [name for name in frame.index if "share of alignment" in name]
    assert list(frame.loc[label]) == [expected] * 3
    label = "kernels: neighbours"
    assert list(frame.loc[label])[2] == "–"


def test_what_a_set_lacks_is_named_with_the_reason(page):
    said = notes(page)
    assert "sparse: its analysis has no kernels of distance." in said
    assert "sparse: its analysis has no force maps. The tracks have three dimensions." in said
    assert "flock: its analysis has no held-out scores." in said
    assert not any(note.startswith("shoal") for note in said)


def test_a_text_of_ones_own_stands_first(text, sparse):
    assert text.index("<p>All.</p>") < text.index("Main results")
    own = comparison_page({"a": sparse}, text="# Mine\n\n## Part\n").html()
    assert "<h2>Mine</h2>" in own
    assert "<h3>Part</h3>" in own


def test_the_title_names_the_sets(text, sparse):
    assert "<h1>Comparison of flock, shoal <1> and sparse</h1>" in html.unescape(text)
    assert "5 sets" in comparison_page(dict.fromkeys("abcde", sparse)).title
    assert comparison_page({"a": sparse}, "Mine").title == "Mine"


def test_nothing_makes_no_page(flock):
    with pytest.raises(InputError, match="nothing to compare"):
        comparison_page({})
    with pytest.raises(InputError, match="b: there is nothing in this analysis"):
        comparison_page({"a": flock, "b": Analysis()})
