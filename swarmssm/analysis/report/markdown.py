"""A text of the user's as a part of a page: nothing in it is run or fetched."""

from collections.abc import Sequence
from typing import Any

from markdown_it import MarkdownIt
from markdown_it.token import Token
from markupsafe import Markup

__all__ = ["as_prose"]

#: Schemes of links that are kept: a path beside the text is not beside the page.
KEPT = ("https://", "http://", "mailto:")


def as_prose(text: str, level: int) -> Markup:
    """Return Markdown as HTML.

    HTML in the text is shown as it is written, images by their alternative text, and links to files
    by their words alone: a page that stands by itself has none of these.

    Parameters
    ----------
    text
        CommonMark, with tables.
    level
        Of the highest heading of the text.
    """
    reader = MarkdownIt("commonmark", {"html": False}).enable("table")
    tokens = reader.parse(text)
    headings = [int(token.tag[1]) for token in tokens if token.type == "heading_open"]
    down = level - min(headings, default=level)
    for token in tokens:
        if token.type in ("heading_open", "heading_close"):
            token.tag = f"h{min(6, int(token.tag[1]) + down)}"
        if token.children:
            token.children = _without_links(token.children)
    reader.add_render_rule("table_open", _opened)
    reader.add_render_rule("table_close", _closed)
    return Markup(reader.renderer.render(tokens, reader.options, {}))


def _without_links(tokens: Sequence[Token]) -> list[Token]:
    """Leave away the links to files, and put words in place of images."""
    kept: list[Token] = []
    following: list[bool] = []
    for token in tokens:
        if token.type == "link_open":
            following.append(str(token.attrGet("href") or "").startswith(KEPT))
            if following[-1]:
                kept.append(token)
        elif token.type == "link_close":
            if following.pop():
                kept.append(token)
        elif token.type == "image":
            kept.append(Token("text", "", 0, content=token.content))
        else:
            kept.append(token)
    return kept


def _opened(*_: Any) -> str:
    return '<div class="wide" tabindex="0" role="region" aria-label="Table">\n<table>\n'


def _closed(*_: Any) -> str:
    return "</table>\n</div>\n"
