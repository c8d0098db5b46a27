"""``swarmssm import`` and ``swarmssm info``: tracks in, and a look at them."""

from pathlib import Path
from typing import Annotated

import typer

from swarmssm.cli.console import print_json, print_table, say
from swarmssm.cli.options import Format, Overwrite, TableFormat
from swarmssm.files import check_output

__all__ = ["import_tracks", "info"]


def import_tracks(
    path: Annotated[Path, typer.Argument(help="File or folder of a tracker.")],
    out: Annotated[
        Path | None,
        typer.Option(help="NetCDF file to write. Default: the name of PATH with .nc, here."),
    ] = None,
    format: Annotated[
        str, typer.Option("--format", help="auto, or one of the formats of swarmssm.io.FORMATS.")
    ] = "auto",
    fps: Annotated[
        float | None, typer.Option(help="Frames per second, where the file does not tell.")
    ] = None,
    unit: Annotated[
        str | None, typer.Option(help="Unit of length, where the file does not tell.")
    ] = None,
    y_axis: Annotated[
        str | None,
        typer.Option(help="up or down: where y grows. Default: down for trackers and pixels."),
    ] = None,
    empty: Annotated[
        str | None,
        typer.Option(help="Individuals without any position: refuse, drop or keep."),
    ] = None,
    centroid: Annotated[
        str | None, typer.Option(help="TRex: wcentroid, pcentroid, centroid or head.")
    ] = None,
    video: Annotated[
        str | None, typer.Option(help="TRex: which video, if the folder holds several.")
    ] = None,
    visual_field: Annotated[
        bool | None,
        typer.Option(help="TRex: read visual fields into the adjacency. Default: if present."),
    ] = None,
    keypoint: Annotated[
        str | None, typer.Option(help="NetCDF: which keypoint stands for an individual.")
    ] = None,
    pad_trials: Annotated[
        bool | None,
        typer.Option(help="Tables: accept trials with other individuals, padding the missing."),
    ] = None,
    allow_pickle: Annotated[
        bool | None,
        typer.Option("--allow-pickle", help="idtracker.ai: read an npy file, which is a pickle."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Read the files of a tracker and write them as tracks."""
    from swarmssm import io
    from swarmssm.tracks.summary import summarize

    target = out or Path(f"{path.resolve().name.removesuffix(path.suffix)}.nc")
    tracks = io.read(
        path,
        format,
        fps,
        unit=unit,
        y_axis=y_axis,  # type: ignore[arg-type]
        empty=empty,  # type: ignore[arg-type]
        centroid=centroid,
        video=video,
        visual_field=visual_field,
        keypoint=keypoint,
        pad_trials=pad_trials,
        allow_pickle=allow_pickle,
    )
    check_output(target, overwrite=overwrite)
    io.write(tracks, target, overwrite=overwrite)
    summary = summarize(tracks)
    say(
        f"{target}: {summary['individuals']} individuals, {summary['frames']} frames at "
        f"{summary['fps']:g} per second, {100 * summary['observed']:.1f} % observed."
    )


def info(
    path: Annotated[Path, typer.Argument(help="NetCDF file, or any file that import can read.")],
    format: Format = TableFormat.text,
    fps: Annotated[float | None, typer.Option(help="As for import.")] = None,
) -> None:
    """Say what is in a file of tracks: who, how long, how well tracked, how it moves."""
    from swarmssm import io
    from swarmssm.tracks.summary import describe, summarize

    summary = summarize(io.read(path, fps=fps))
    if format is TableFormat.json:
        print_json({"file": str(path), **summary})
        return
    print_table(str(path), ("", ""), describe(summary))
