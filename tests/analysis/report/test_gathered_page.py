"""One page on several analyses: what each has is there, what one lacks is said."""

import html
import re
from dataclasses import replace

import pytest

from swarmssm.analysis.interpretation.result import Analysis
from swarmssm.analysis.report.gathered_page import gathered_page, report_gathered
from swarmssm.analysis.report.side_by_side import unit_sentence
from swarmssm.errors import InputError


@pytest.fixture(scope="module")
def page(flock, shoal, sparse):
    """The page on three sets, one of which has forces alone."""
    return gathered_page({"flock": flock, "shoal <1>": shoal, "sparse": sparse}, text="All of it.")


@pytest.fixture(scope="module")
def words(page):
    """Its text."""
    return html.unescape(page)


def section(page, anchor):
    """Return the part of the page under a heading."""
    return page.split(f'<section class="run" aria-labelledby="{anchor}">')[1].split("</section>")[0]


def test_it_needs_nothing_but_itself(page):
    for address in re.findall(r'(?:src|href)="([^"]*)"', page):
        assert address.startswith(("#", "data:image/png;base64,")), address
    for address in re.findall(r"url\(([^)]*)\)", page):
        assert address.startswith("#"), address
    assert "<script" not in page
    assert "<link" not in page
    assert len(page) < 3e6


def test_names_of_places_are_unlike_and_links_arrive(page):
    places = re.findall(r'\bid="([^"]*)"', page)
    assert len(places) == len(set(places))
    for link in re.findall(r'<a href="#([^"]*)"', page):
        assert link in places
    for used in re.findall(r'xlink:href="#([^"]*)"', page):
        assert used in places


def test_names_of_sets_are_text(page):
    assert "shoal &lt;1&gt;" in page
    assert "shoal <1>" not in page


def test_each_figure_has_a_sentence_and_an_alternative_text(page):
    # Shares of all, kernels and maps of two, scores of one.
    assert page.count("<figure>") == page.count("<figcaption>") == 1 + 2 + 2 + 1
    # A set with a factor of the direction has a third panel.
    drawn = re.findall(r'<svg [^>]*role="img"[^>]*aria-label="([^"]*)"', page)
    assert len(drawn) == 1 + 2 + 3 + 2 + 1
    assert all(len(text) > 10 for text in drawn)
    assert "<li>The baselines are told nothing.</li>" in section(page, "scores")
    assert "<li>Simulated.</li>" in page


def test_black_is_the_pages_ink(page):
    assert "#000000" not in page.split("</style>")[1]


def test_what_is_compared_is_a_column_each(page, flock):
    table = page.split('<table class="sets">')[1].split("</table>")[0]
    rows = [re.findall(r"<t[hd][^>]*>(.*?)</t[hd]>", row) for row in table.split("<tr>")[1:]]
    told = {row[0]: row[1:] for row in rows}
    assert told["set"] == ["flock", "shoal &lt;1&gt;", "sparse"]
    assert told["individuals"] == ["5"] * 3
    assert told["trials"] == ["4"] * 3
    # 60 frames at 10 a second, of which the last is 5.9 s after the first.
    assert told["frames"] == ["60, 5.90 s"] * 3
    assert told["unit of length"][1] == "cm"
    assert told["model"] == ["graph-vae"] * 3
    assert told["draws"] == ["2"] * 3


def test_units_that_differ_are_said_and_share_no_axis(words, shoal):
    assert "shoal <1>: cm" in words
    assert "No axis is shared between sets" in words
    # Two kernels of each of two sets, each with its own axis.
    kernels = section(words, "rules")
    assert kernels.count(">distance (cm)</text>") == 2
    assert kernels.count(">distance (") == 4
    assert unit_sentence({"shoal": shoal}) == ""
    assert "All lengths are in cm." in unit_sentence({"a": shoal, "b": shoal})
    pixels = replace(shoal, forces=shoal.forces.assign_attrs(unit="px"))
    assert "need not be equally long" in unit_sentence({"a": pixels, "b": pixels})


def test_numbers_of_all_sets_stand_in_one_row(words, flock):
    rules = section(words, "rules")
    share = flock.forces["share"].sel(term="alignment")
    low, middle, high = (100 * float(share.sel(quantile=q)) for q in (0.05, 0.5, 0.95))
    row = rules.split('<th scope="row">share of alignment</th>')[1].split("</tr>")[0]

    def short(value):
        return f"{value:.0f}" if value >= 10 else f"{value:.1f}"

    assert row.count(f"<td>{short(middle)} % ({short(low)} to {short(high)})") == 3
    row = rules.split('<th scope="row">neighbours</th>')[1].split("</tr>")[0]
    assert row.count("<td>") == 3
    assert row.count("<td>–</td>") == 1


def test_what_a_set_lacks_is_said_with_the_reason(words):
    assert "sparse: its analysis has no kernels of distance." in section(words, "rules")
    assert "sparse: its analysis has no force maps. The tracks have three dimensions." in section(
        words, "maps"
    )
    assert "flock and sparse have no log scores of held-out frames" in section(words, "scores")
    assert "What the latents carry</h2>" not in words


def test_without_any_scores_that_is_said_once(sparse):
    text = gathered_page({"a": sparse, "b": sparse})
    assert "None of the analyses has log scores of held-out frames" in text
    assert "a has no log scores of held-out frames" in gathered_page({"a": sparse})


def test_the_table_of_scores_has_means_over_the_starts(words):
    table = section(words, "scores").split("<table")[1]
    # -29.5 for the starts, less the step.
    row = table.split('<th scope="row">graph-vae</th>')[1].split("</tr>")[0]
    assert re.findall(r"<td>(.*?)</td>", row) == ["-30.50", "-31.50", "-34.50"]
    row = table.split('<th scope="row">constant velocity</th>')[1].split("</tr>")[0]
    assert re.findall(r"<td>(.*?)</td>", row) == ["-29.50", "-31.50", "-35.50"]


def test_a_text_stands_above(page, sparse):
    assert "<h2>In words</h2>" in page
    assert "<p>All of it.</p>" in page
    assert page.index("All of it.") < page.index("Held-out scores</h2>")
    own = gathered_page({"a": sparse}, text="# Mine\n\n## Part\n")
    assert "<h2>Mine</h2>" in own
    assert "<h3>Part</h3>" in own
    assert "In words</h2>" not in own
    assert "#text" not in gathered_page({"a": sparse})


def test_the_title_names_the_sets(words, sparse):
    assert "<h1>The rules of flock, shoal <1> and sparse</h1>" in words
    assert "<h1>The rule of a</h1>" in gathered_page({"a": sparse})
    assert "<h1>The rules of 5 sets</h1>" in gathered_page(dict.fromkeys("abcde", sparse))
    assert "<h1>Mine</h1>" in gathered_page({"a": sparse}, "Mine")


def test_nothing_makes_no_page(flock, tmp_path):
    with pytest.raises(InputError, match="nothing to gather"):
        gathered_page({})
    with pytest.raises(InputError, match="b: there is nothing in this analysis"):
        gathered_page({"a": flock, "b": Analysis()})
    with pytest.raises(InputError, match="b: there is nothing"):
        report_gathered({"b": Analysis()}, tmp_path / "a.html")
    assert not list(tmp_path.iterdir())


def test_an_existing_file_is_kept(sparse, tmp_path):
    path = tmp_path / "a.html"
    path.write_text("precious")
    with pytest.raises(InputError, match="exists already"):
        report_gathered({"a": sparse}, path)
    assert path.read_text() == "precious"
    assert report_gathered({"a": sparse}, path, overwrite=True) == path
    assert path.read_text(encoding="utf-8").startswith("<!DOCTYPE html>")
