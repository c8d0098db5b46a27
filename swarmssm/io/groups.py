"""Several datasets in one NetCDF file, each in a group of its own."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import xarray as xr

from swarmssm.errors import InputError
from swarmssm.io.hdf5 import open_hdf5
from swarmssm.io.netcdf import encoded, restored, restored_attributes, writable, write_buffered
from swarmssm.io.opening import existing, reading

__all__ = ["read_groups", "write_groups"]


def write_groups(
    groups: Mapping[str, xr.Dataset],
    path: Path | str,
    *,
    attrs: Mapping[str, Any] | None = None,
    overwrite: bool = False,
) -> None:
    """Write datasets to the groups of one NetCDF-4 file, compressed and without loss.

    Other programs read it too: ``xarray.open_datatree(path)`` all of it, and
    ``xarray.open_dataset(path, group=name)`` one of them.

    Parameters
    ----------
    groups
        Name of the group -> dataset. They need not share dimensions.
    path
        The file to write. It is written beside and then renamed.
    attrs
        What is to be said of all of them, kept at the root of the file.
    overwrite
        Whether an existing file may be replaced.

    Raises
    ------
    InputError
        If a name has a slash, an attribute has no written form, or ``path`` exists or cannot be
        written to.
    WorkError
        If writing fails.
    """
    tree: dict[str, xr.Dataset] = {"/": xr.Dataset(attrs=writable(attrs or {}))}
    encoding: dict[str, Any] = {}
    for name, dataset in groups.items():
        if not name or "/" in name:
            raise InputError(f"groups: {name!r} is no name of a group; use letters and digits.")
        tree[f"/{name}"], encoding[f"/{name}"] = encoded(dataset)
    whole = xr.DataTree.from_dict(tree)
    write_buffered(
        path,
        lambda buffer: whole.to_netcdf(buffer, engine="h5netcdf", encoding=encoding),
        overwrite=overwrite,
    )


def read_groups(path: Path | str) -> tuple[dict[str, xr.Dataset], dict[str, Any]]:
    """Read what :func:`write_groups` wrote: the datasets by name, and what stands at the root.

    Raises
    ------
    InputError
        If there is no such file, or it is no whole NetCDF file.
    """
    place = existing(path)
    with open_hdf5(place, "NetCDF file"):
        pass
    with (
        reading(place, "NetCDF file"),
        xr.open_datatree(
            place, engine="h5netcdf", decode_times=False, decode_timedelta=False
        ) as opened,
    ):
        tree = opened.load()
        groups = {
            str(name): restored(child.to_dataset(inherit=False))
            for name, child in tree.children.items()
        }
        return groups, restored_attributes(tree.attrs)
