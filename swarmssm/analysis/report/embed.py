"""Figures as parts of a page: vector graphics in the page's own text colour, light or dark."""

import html
import io
import re
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import resources
from typing import Any

import matplotlib
import matplotlib.style
from markupsafe import Markup
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure

__all__ = ["NAME", "as_svg", "assets", "report_style"]

#: What names inside a figure begin with; the page puts a number of the figure in its place.
NAME = "\ue000"

#: Points of width above which a figure has several panels, and is scrolled on a narrow screen.
SINGLE = 500.0
#: Pixels per inch of what is drawn as pixels inside a vector figure.
DPI = 160


@contextmanager
def report_style() -> Iterator[None]:
    """Draw figures in matplotlib's own style, and show none of them in a notebook.

    What the user's configuration says of colours would not fit the page.
    """
    with matplotlib.style.context("default"), matplotlib.rc_context({"interactive": False}):
        yield


def as_svg(figure: Figure, alt: str, name: str = NAME) -> Markup:
    """Return a figure as an SVG element to stand in a page.

    Parameters
    ----------
    figure
        What to draw. Black becomes the page's own colour of text, white the page itself.
    alt
        What the figure shows, for those who do not see it.
    name
        Names inside start with it; it must differ from that of any other figure on the page.
    """
    stream = io.StringIO()
    # Text stays text; and the same figure gives the same bytes.
    options: Any = {"svg.fonttype": "none", "svg.hashsalt": "swarmssm"}
    with matplotlib.rc_context(options), warnings.catch_warnings():
        # Text stays text, and the page's fonts have what matplotlib's own may lack.
        warnings.filterwarnings("ignore", r"Glyph .* missing from (font|current font)")
        _draw(figure, stream)
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    opening, _, rest = text.partition(">")
    box = re.search(r'viewBox="([^"]+)"', opening)
    width = float(box[1].split()[2]) if box else 0.0
    kind = "several" if width > SINGLE else "single"
    head = (
        f'<svg xmlns="http://www.w3.org/2000/svg" xmlns:xlink="http://www.w3.org/1999/xlink" '
        f'viewBox="{box[1] if box else "0 0 100 100"}" role="img" class="{kind}" '
        f'aria-label="{html.escape(alt)}" style="width: {width * 4 / 3:.0f}px">'
        f"<title>{html.escape(alt)}</title>"
    )
    rest = re.sub(r'(font(?:-family)?: *[^;"]*?)\'DejaVu Sans\'[^;"]*', r"\1sans-serif", rest)
    rest = re.sub(r"(stroke|fill): #000000", r"\1: currentColor", rest)
    rest = re.sub(r'\bid="', f'id="{name}-', rest)
    rest = re.sub(r'(href="#|url\(#)', rf"\g<1>{name}-", rest)
    return Markup(head + _each_once(rest))


def assets(moves: bool) -> Markup:
    """Return style and script of all players of a page; nothing where nothing moves."""
    if not moves:
        return Markup("")
    folder = resources.files("swarmssm.analysis.report")
    style, script = (
        folder.joinpath(name).read_text(encoding="utf-8") for name in ("player.css", "player.js")
    )
    return Markup(f"<style>\n{style}</style>\n<script>\n{script}</script>\n")


def _each_once(text: str) -> str:
    """Remove a name where it is repeated: equal pictures get equal names."""
    seen: set[str] = set()

    def first(found: re.Match[str]) -> str:
        again = found[1] in seen
        seen.add(found[1])
        return "" if again else found[0]

    return re.sub(r'\s\bid="([^"]*)"', first, text)


def _draw(figure: Figure, stream: io.StringIO) -> None:
    """Write a figure with a transparent background, as SVG.

    ``savefig`` would do the same, but draws everything a second time for its layout.
    """
    engine = figure.get_layout_engine()
    if engine is not None:
        engine.execute(figure)
    for patch in (figure.patch, *(ax.patch for ax in figure.axes)):
        patch.set(facecolor="none", edgecolor="none")
    figure.set_dpi(DPI)
    nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
    canvas: Any = FigureCanvasSVG(figure)
    figure.set_layout_engine("none")
    canvas.print_svg(stream, metadata=nothing)
