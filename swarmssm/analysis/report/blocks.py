"""What a page is built of: chapters of facts, tables, figures, notes and text, in any order."""

from dataclasses import dataclass, field
from typing import ClassVar

from markupsafe import Markup

__all__ = ["Block", "Chapter", "Facts", "Fragment", "Notes", "Picture", "Rows", "Table", "Text"]

#: Rows of a table, column title to text.
Rows = list[dict[str, str]]


@dataclass(frozen=True)
class Facts:
    """A list of labels, each with its text."""

    caption: str
    rows: list[tuple[str, str]]
    kind: ClassVar[str] = "facts"


@dataclass(frozen=True)
class Table:
    """A table; it is left away if it has no rows.

    ``style`` is ``""`` for scores, whose first row stands out, and ``"plain"`` for any other.
    ``footnote`` stands below, and the table is scrolled where the page is too narrow for it.
    """

    caption: str
    rows: Rows
    style: str = ""
    footnote: str = ""
    kind: ClassVar[str] = "table"


@dataclass(frozen=True)
class Picture:
    """A figure with its title, what is to be seen, and the thesis's figures that it redoes."""

    title: str
    thesis: str
    sentence: str
    svg: Markup
    kind: ClassVar[str] = "picture"


@dataclass(frozen=True)
class Notes:
    """A list of sentences."""

    lines: list[str]
    kind: ClassVar[str] = "notes"


@dataclass(frozen=True)
class Text:
    """A paragraph."""

    text: str
    kind: ClassVar[str] = "text"


@dataclass(frozen=True)
class Fragment:
    """A part that brings its own HTML, with a title and what it shows."""

    title: str
    sentence: str
    markup: Markup
    kind: ClassVar[str] = "fragment"


Block = Facts | Table | Picture | Notes | Text | Fragment


@dataclass(frozen=True)
class Chapter:
    """A heading and what stands under it; ``anchor`` is its place within its section."""

    anchor: str
    heading: str
    blocks: list[Block] = field(default_factory=list)
