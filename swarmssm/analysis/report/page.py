"""One page of blocks: headings, verdicts, figures, tables, folded parts, players and notes."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from itertools import count
from pathlib import Path
from typing import Any, ClassVar

import jinja2
import numpy as np
import pandas as pd
from markupsafe import Markup
from matplotlib.figure import Figure as Drawing

import swarmssm
from swarmssm.analysis.report.embed import NAME, as_svg, assets
from swarmssm.analysis.scoring.table import format_number
from swarmssm.errors import InputError
from swarmssm.files import check_output, write_beside

__all__ = [
    "Block",
    "Figure",
    "Grid",
    "Note",
    "Page",
    "Player",
    "Prose",
    "Section",
    "Table",
    "Verdict",
    "figure",
    "render",
]


@dataclass(frozen=True)
class Verdict:
    """One sentence that answers a question, with what it answers."""

    label: str
    text: str
    kind: ClassVar[str] = "verdict"


@dataclass(frozen=True)
class Figure:
    """Vector graphics with a title and a fixed caption, see :func:`figure`."""

    title: str
    caption: str
    panels: tuple[Markup, ...]
    thesis: str = ""
    kind: ClassVar[str] = "figure"


@dataclass(frozen=True)
class Table:
    """A table: its columns, and its index where that has a name; without rows it is left out."""

    caption: str
    frame: pd.DataFrame
    footnote: str = ""
    kind: ClassVar[str] = "table"

    @property
    def head(self) -> list[str]:
        """Titles of the columns."""
        return [str(name) for name in self._named().columns]

    @property
    def rows(self) -> list[list[str]]:
        """The cells as text."""
        return [[_cell(value) for value in row] for row in self._named().to_numpy(object)]

    def _named(self) -> pd.DataFrame:
        return self.frame.reset_index() if self.frame.index.name else self.frame


@dataclass(frozen=True)
class Player:
    """Tracks that move, see :func:`swarmssm.analysis.report.player.player_fragment`."""

    title: str
    caption: str
    markup: Markup
    kind: ClassVar[str] = "player"


@dataclass(frozen=True)
class Note:
    """A list of remarks."""

    lines: Sequence[str]
    kind: ClassVar[str] = "note"


@dataclass(frozen=True)
class Prose:
    """A paragraph; or markup, as it is."""

    text: str | Markup
    kind: ClassVar[str] = "prose"


@dataclass(frozen=True)
class Grid:
    """Blocks side by side, one below the other where the page is narrow."""

    cells: Sequence[Sequence["Block"]]
    kind: ClassVar[str] = "grid"


@dataclass(frozen=True)
class Section:
    """A heading with what stands under it, which may be folded."""

    heading: str
    blocks: Sequence["Block"]
    folded: bool = False
    kind: ClassVar[str] = "section"


Block = Verdict | Figure | Table | Player | Note | Prose | Grid | Section


@dataclass
class Page:
    """A page that needs no network: HTML with its style, figures and players inside.

    Attributes
    ----------
    title
        Heading.
    blocks
        What stands on it, in this order.
    subtitle
        A line below the heading.
    """

    title: str
    blocks: list[Block] = field(default_factory=list)
    subtitle: str = ""

    def add(self, *blocks: Block) -> "Page":
        """Put blocks at the end, and return the page."""
        self.blocks.extend(blocks)
        return self

    def html(self) -> str:
        """Return the page as HTML.

        Raises
        ------
        InputError
            If there is nothing on it.
        """
        if not self.blocks:
            raise InputError("page: there is nothing to report.")
        numbers = count(1)

        def own_names(panel: Markup) -> Markup:
            return Markup(panel.replace(NAME, f"f{next(numbers)}"))

        return render("page.html", page=self, own_names=own_names, assets=assets(self._moves()))

    def write(self, path: str | Path, *, overwrite: bool = False) -> Path:
        """Write the page to a temporary file and rename it, so that it is never half-written.

        Raises
        ------
        InputError
            If there is nothing on it, or the file exists and may not be replaced.
        WorkError
            If it cannot be written; an earlier file is then unchanged.
        """
        path = check_output(Path(path), overwrite=overwrite)
        text = self.html()
        with write_beside(path, overwrite=overwrite) as temporary:
            temporary.write_text(text, encoding="utf-8")
        return path

    def _moves(self) -> bool:
        return any(isinstance(one, Player) for one in every_block(self.blocks))


def every_block(blocks: Sequence[Block]) -> list[Block]:
    """Return all blocks, those inside of others too."""
    found: list[Block] = []
    for one in blocks:
        found.append(one)
        if isinstance(one, Section):
            found += every_block(one.blocks)
        elif isinstance(one, Grid):
            found += [inner for cell in one.cells for inner in every_block(cell)]
    return found


def figure(
    title: str, caption: str, drawn: Drawing | Sequence[Drawing], thesis: str = ""
) -> Figure:
    """Return drawn figures as a block; they can be let go of.

    Parameters
    ----------
    title
        What the figure shows, in a few words.
    caption
        How to read it: true of any data, without a number of these.
    drawn
        One figure, or several that stand in a row where there is room.
    thesis
        Figures of the thesis that it reproduces.
    """
    several = [drawn] if isinstance(drawn, Drawing) else list(drawn)
    named = [one.axes[0].get_title() if len(several) > 1 else "" for one in several]
    panels = (
        as_svg(one, ": ".join(filter(None, (title, name))))
        for one, name in zip(several, named, strict=True)
    )
    return Figure(title, caption, tuple(panels), thesis)


def render(template: str, **values: Any) -> str:
    """Return a template of this folder, filled in."""
    environment = jinja2.Environment(
        loader=jinja2.PackageLoader("swarmssm.analysis.report", "."),
        autoescape=True,
        trim_blocks=True,
        lstrip_blocks=True,
        undefined=jinja2.StrictUndefined,
    )
    return environment.get_template(template).render(
        version=swarmssm.__version__,
        written=datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
        **values,
    )


def _cell(value: Any) -> str:
    """Return a value as text, a number with three digits."""
    if isinstance(value, bool | np.bool_):
        return "yes" if value else "no"
    if isinstance(value, int | np.integer):
        return str(value)
    if isinstance(value, float | np.floating):
        return format_number(float(value))
    return str(value)
