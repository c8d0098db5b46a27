"""The figures that the thesis prints, printed with those found here.

They cannot be compared with them, nor with anything else: (4.2) divides a squared error by a
length, so that its value depends on the scale and the sampling rate of the states, AMD and AVD are
in the unit of the recording, and the thesis names neither.
"""

from dataclasses import dataclass

import xarray as xr

from swarmssm.errors import InputError, SwarmssmError
from swarmssm.simulate import dynamics_of

__all__ = ["FOOTNOTE", "THESIS_TABLES", "ThesisRow", "thesis_rows"]

FOOTNOTE = (
    "Printed in the thesis for its own recordings, which are not these. Its MSE depends on the "
    "scale and the sampling rate, AMD and AVD on the unit of length, and none of them is given: "
    "these rows say what was published, and compare with no other row."
)


@dataclass(frozen=True)
class ThesisRow:
    """One column of Table I or II."""

    title: str
    mse: float
    amd: float
    avd: float


THESIS_TABLES: dict[str, tuple[ThesisRow, ...]] = {
    "guppies": (
        ThesisRow("Graph VAE, thesis Table I (guppies)", 0.146, 0.96, 3.47),
        ThesisRow("DyGrEncoder, thesis Table I (guppies)", 0.902, 0.957, 2.451),
        ThesisRow("DCRNN, thesis Table I (guppies)", 0.3452, 0.902, 2.5734),
    ),
    "boids": (
        ThesisRow("Graph VAE, thesis Table II (boids)", 0.354, 0.7123, 1.542),
        ThesisRow("DyGrEncoder, thesis Table II (boids)", 0.235, 0.5642, 0.956),
        ThesisRow("DCRNN, thesis Table II (boids)", 0.415, 0.763, 1.345),
    ),
}


def thesis_rows(name: str | None) -> tuple[ThesisRow, ...]:
    """Return the printed rows for ``"boids"`` or ``"guppies"``, none for ``None``.

    Raises
    ------
    InputError
        If the name is another.
    """
    if name is None:
        return ()
    if name not in THESIS_TABLES:
        raise InputError(f"thesis: {name!r} is unknown; choose one of {', '.join(THESIS_TABLES)}.")
    return THESIS_TABLES[name]


def thesis_table_for(tracks: xr.Dataset) -> str:
    """Return which of the two tables is about such tracks: boids if simulated, else guppies."""
    try:
        dynamics_of(tracks)
    except SwarmssmError:
        return "guppies"
    return "boids"
