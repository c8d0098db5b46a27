"""From a template of this folder to a file that needs no network."""

from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import jinja2

import swarmssm
from swarmssm.files import write_beside

__all__ = ["render", "write_page"]


def render(template: str, **values: Any) -> str:
    """Return a page of this folder, filled."""
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


def write_page(page: str, path: Path, *, overwrite: bool) -> Path:
    """Write a page, beside and renamed; return its path."""
    with write_beside(path, overwrite=overwrite) as temporary:
        temporary.write_text(page, encoding="utf-8")
    return path
