"""A user's text: formatted, and neither run nor fetched."""

from swarmssm.analysis.report.markdown import as_prose


def test_paragraphs_lists_and_emphasis():
    text = str(as_prose("One *two* **three**.\n\n- four\n- five\n", 3))
    assert "<p>One <em>two</em> <strong>three</strong>.</p>" in text
    assert text.count("<li>") == 2


def test_headings_go_below_those_of_the_page():
    assert str(as_prose("## A\n\n### B\n", 3)) == "<h3>A</h3>\n<h4>B</h4>\n"
    assert str(as_prose("### A\n", 2)) == "<h2>A</h2>\n"
    assert str(as_prose("# A\n\n###### B\n", 4)) == "<h4>A</h4>\n<h6>B</h6>\n"


def test_html_is_text():
    assert "<script" not in as_prose("<script>alert(1)</script>\n\na <b onclick=x>b</b>", 3)
    assert "&lt;b onclick=x&gt;" in as_prose("a <b onclick=x>b</b>", 3)


def test_links_to_files_are_their_words_and_images_their_alternative_text():
    text = str(as_prose("[results](../RESULTS.md), ![fish](fish.png), [site](https://a.b/c)", 3))
    assert text == '<p>results, fish, <a href="https://a.b/c">site</a></p>\n'
    assert "href" not in as_prose("[x](javascript:alert(1)) [y](data:text/html,z)", 3)


def test_a_table_is_scrolled_by_itself():
    text = str(as_prose("| a | b |\n|---|---|\n| 1 | 2 |\n", 3))
    assert text.startswith('<div class="wide"')
    assert "<td>1</td>" in text
    assert text.endswith("</table>\n</div>\n")


def test_nothing_is_nothing():
    assert as_prose("", 3) == ""
