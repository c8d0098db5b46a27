"""Tracks in and out: readers of what trackers write, and our own NetCDF files.

:func:`read` tells formats apart by their content; :func:`write` writes a file that :func:`read`
gives back number for number. A mistake in a file is one sentence of
:class:`~swarmssm.errors.InputError` that names the file, the place in it and the mend.
"""

from swarmssm.io.arrays import read_arrays
from swarmssm.io.conversion import Recordings, as_tracks
from swarmssm.io.detection import detect_format
from swarmssm.io.groups import read_groups, write_groups
from swarmssm.io.idtracker import read_idtracker
from swarmssm.io.idtrackerai import read_idtrackerai
from swarmssm.io.netcdf import read_netcdf, write_dataset
from swarmssm.io.netcdf import write_tracks as write
from swarmssm.io.reading import FORMATS, read
from swarmssm.io.tables import read_table
from swarmssm.io.trex import read_trex
from swarmssm.io.trex_csv import read_trex_csv

__all__ = [
    "FORMATS",
    "Recordings",
    "as_tracks",
    "detect_format",
    "read",
    "read_arrays",
    "read_groups",
    "read_idtracker",
    "read_idtrackerai",
    "read_netcdf",
    "read_table",
    "read_trex",
    "read_trex_csv",
    "write",
    "write_dataset",
    "write_groups",
]
