"""How observed positions are laid out for ArviZ: on a grid if none is missing, else in a row."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
import xarray as xr

from swarmssm.tracks import Array

__all__ = ["Layout"]

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True)
class Layout:
    """How positions are laid out: on a grid if none is missing, else in a row.

    Attributes
    ----------
    source
        Tracks with trials.
    scored
        ``(trial, time, individual)``: which positions are in.
    """

    source: xr.Dataset
    scored: Mask

    @property
    def rows(self) -> Mask:
        """Frames with anything in them."""
        frames: Mask = np.logical_or.reduce(self.scored, axis=(0, 2))
        return frames

    @property
    def stacked(self) -> bool:
        """Whether one is missing among those frames."""
        return not bool(self.scored[:, self.rows].all())

    def dataset(
        self,
        name: str,
        values: Array,
        spatial: bool,
        words: str,
        *,
        units: str | None = None,
        what: str = "",
        drawn: bool = True,
    ) -> xr.Dataset:
        """Return a group of one variable.

        Parameters
        ----------
        name
            Of the variable.
        values
            ``([draw,] trial, time, individual[, space])``.
        spatial
            Whether there is a last dimension ``space``.
        words, units, what
            ``long_name``; ``units``, absent those of length; ``how``.
        drawn
            Whether there is a first dimension of draws, which gets one of chains.
        """
        lead: tuple[Any, ...] = (slice(None),) * drawn
        source = self.source
        coords: dict[str, Any] = {}
        dims: tuple[str, ...] = ("chain", "draw") if drawn else ()
        if self.stacked:
            place = np.nonzero(self.scored)
            own = values[(*lead, *place)]
            dims += ("observation",)
            coords["observation"] = np.arange(len(place[0]))
            for dim, index in zip(("trial", "time", "individual"), place, strict=True):
                coords[dim] = ("observation", source[dim].to_numpy()[index])
        else:
            own = values[(*lead, slice(None), self.rows)]
            dims += ("trial", "time", "individual")
            for dim in ("trial", "individual"):
                coords[dim] = source[dim].to_numpy()
            coords["time"] = source["time"].to_numpy()[self.rows]
        if spatial:
            dims += ("space",)
            coords["space"] = source["space"].to_numpy()
        if drawn:
            coords |= {"chain": [0], "draw": np.arange(len(values))}
            own = own[None]
        length = str(source.attrs.get("unit", ""))
        attrs = {"long_name": words, "units": length if units is None else units}
        if what:
            attrs["how"] = what
        group = xr.Dataset({name: (dims, np.ascontiguousarray(own), attrs)}, coords)
        group["time"].attrs["units"] = "s"
        return group
