"""Other runs that one is compared with."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from swarmssm.errors import InputError

if TYPE_CHECKING:
    from swarmssm.inference import Fit

__all__ = ["Against", "load_rivals"]

Against = Annotated[
    list[Path] | None,
    typer.Option(metavar="RUN", help="Another run to score held-out forecasts beside; repeatable."),
]


def load_rivals(paths: Sequence[Path] | None, fitted: "Fit", trust_code: bool) -> dict[str, "Fit"]:
    """Read runs, each named by its folder, or by its path if the fit's model has that name.

    Raises
    ------
    InputError
        If one cannot be read, or two have one name.
    """
    from swarmssm.inference import Fit

    rivals: dict[str, Fit] = {}
    for path in paths or []:
        name = path.resolve().name
        name = str(path) if name == fitted.settings.model else name
        if name in rivals:
            raise InputError(f"--against: two runs are called {name}. Rename the folder of one.")
        rivals[name] = Fit.load(path, trust_code=trust_code)
    return rivals
