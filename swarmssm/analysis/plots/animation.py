"""Tracks in motion: an animation, and its film as mp4 or gif."""

import io
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any, Unpack

import matplotlib
import numpy as np
import xarray as xr
from matplotlib.animation import AbstractMovieWriter, FuncAnimation, writers
from matplotlib.artist import Artist
from matplotlib.figure import Figure
from PIL import Image

from swarmssm.analysis.plots.frames import FramePicture
from swarmssm.analysis.plots.scenes.scene import (
    FASTEST,
    FLAT,
    Choice,
    box_of,
    decimals_of,
    pace_of,
    scenes_of,
)
from swarmssm.analysis.plots.tracks import TAIL
from swarmssm.errors import InputError, WorkError
from swarmssm.files import check_output, write_beside
from swarmssm.jobs import Progress

__all__ = ["FASTEST", "FASTEST_GIF", "WRITERS", "animate", "check_film", "write_animation"]

#: Frames a second beyond which browsers slow a gif down.
FASTEST_GIF = 50.0
#: Frames of a gif at most: all of them are held in memory until it is written.
MAX_GIF = 2000
#: How a frame gets its 256 colours: exactly, if it has no more.
COLOURS, PLAIN = Image.Quantize.MAXCOVERAGE, Image.Dither.NONE
GIF, MP4 = "swarmssm-gif", "ffmpeg"
WRITERS = {".gif": GIF, ".mp4": MP4}


def animate(
    tracks: xr.Dataset,
    predicted: xr.Dataset | None = None,
    *,
    tail: int = TAIL,
    fps_out: float | None = None,
    fastest: float = FASTEST,
    titles: tuple[str, str] = ("observed", "predicted"),
    **choice: Unpack[Choice],
) -> FuncAnimation:
    """Return tracks as an animation, a prediction beside them.

    Parameters
    ----------
    tracks, predicted
        Tracks, and for instance a :func:`swarmssm.analysis.plots.scenes.free_run` on them.
    tail
        Frames of path behind each individual; 0 for none.
    fps_out
        Frames shown a second. Default: as it was, if that is 4 to ``fastest``; else 25 for what is
        slower, and ``fastest`` for what is faster.
    fastest
        Frames a second that a film shows by default at most; of a gif, browsers show no more than
        50.
    titles
        Of the two pictures.
    **choice
        ``trial, individuals, start, steps, every, edges, predicted_start``: what is shown, see
        :func:`swarmssm.analysis.plots.scenes.scenes_of`.

    Returns
    -------
    An animation: keep it, or write it with :func:`write_animation`; in a notebook,
    ``HTML(animation.to_jshtml())``. Who has no heading is a disc; edges are drawn as
    :func:`swarmssm.analysis.plots.tracks.plot_tracks` does.

    Raises
    ------
    InputError
        As ``scenes_of``, and if ``tail`` or ``fps_out`` is out of
        range.
    """
    if tail < 0:
        raise InputError(f"tail: it must be at least 0, and it is {tail}.")
    scenes = scenes_of(tracks, predicted, **choice)
    pace = pace_of(scenes[0], fps_out, fastest)
    box, leaves = box_of(scenes)
    shape = (box[3] - box[2]) / (box[1] - box[0])
    width = 4.8 * min(1.0, 1.0 / shape)
    figure = Figure(figsize=(width * len(scenes) + 0.4, width * shape + 0.8), layout="constrained")
    axes = figure.subplots(1, len(scenes), squeeze=False)[0]
    pictures = [
        FramePicture(ax, scene, box, tail=tail) for ax, scene in zip(axes, scenes, strict=True)
    ]
    for ax in axes[1:]:
        ax.set_ylabel("")
        ax.tick_params(labelleft=False)
    notes = []
    if scenes[0].flat:
        notes.append(FLAT)
    if leaves:
        notes.append(f"Some {titles[1]} positions lie outside of the picture.")
    ratio = pace / scenes[0].rate
    if not 0.99 < ratio < 1.01:
        notes.append(f"Shown {ratio:.3g} times as fast as it was.")
    if notes:
        figure.supxlabel(" ".join(notes), fontsize=8, parse_math=False)
    times = scenes[0].time
    digits = decimals_of(scenes[0])

    def show(row: int) -> list[Artist]:
        moved: list[Artist] = []
        for ax, picture, title in zip(axes, pictures, titles, strict=False):
            moved += picture.show(row)
            moved.append(ax.set_title(f"{title}, {times[row]:.{digits}f} s", fontsize=10))
        return moved

    show(0)
    # Nothing of the layout changes from here on; to look for it anew took longer than the drawing.
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    return FuncAnimation(
        figure, show, frames=len(times), interval=1000.0 / pace, blit=False, cache_frame_data=False
    )


def check_film(path: str | Path, *, overwrite: bool = False) -> str:
    """Refuse a film that cannot be written, before any work is done; return its writer's name.

    Raises
    ------
    InputError
        If the name ends neither in .gif nor in .mp4, what writes mp4 is not installed, or as
        :func:`swarmssm.files.check_output`.
    """
    path = Path(path)
    writer = WRITERS.get(path.suffix.lower())
    if writer is None:
        raise InputError(f"{path}: a film is a .gif or .mp4 file. Give the name one of these.")
    if not writers.is_available(writer):
        raise InputError(
            f"{path}: matplotlib's mp4 writer needs the program ffmpeg, which is not installed. "
            "Install it, or name a .gif file, which needs nothing."
        )
    check_output(path, overwrite=overwrite)
    return writer


def write_animation(
    animation: FuncAnimation,
    path: str | Path,
    *,
    dpi: float = 100.0,
    overwrite: bool = False,
    progress: Callable[[Progress], object] | None = None,
) -> Path:
    """Write an animation as a film, beside and renamed, through matplotlib's writers.

    Parameters
    ----------
    animation
        From :func:`animate`, or any other of matplotlib. It is shown with its own frames a second.
    path
        File ending in .gif (written by Pillow) or .mp4 (by ffmpeg, which has to be installed). A
        gif knows hundredths of a second: each frame lasts so many that the whole keeps its pace.
    dpi
        Pixels per inch of the figure.
    overwrite
        Whether an existing file may be replaced.
    progress
        Called with the number of the frame and of all frames.

    Returns
    -------
    The path.

    Raises
    ------
    InputError
        As :func:`check_film`, and if a gif would have more than 2000 frames, or frames shown for
        less than a hundredth of a second.
    WorkError
        If ffmpeg fails, or the file cannot be written.
    """
    path = Path(path)
    writer = check_film(path, overwrite=overwrite)

    def tell(number: int, total: int | None) -> None:
        if writer == GIF and number >= MAX_GIF:
            raise InputError(
                f"{path}: a gif has at most {MAX_GIF} frames. Take fewer steps or each so many-th "
                "frame, or name an .mp4 file."
            )
        if progress is not None:
            progress(Progress(number + 1, total or 0))

    extra = ["-f", "mp4", "-movflags", "faststart"] if writer == MP4 else None
    with write_beside(path, overwrite=overwrite) as temporary, _own_style():
        try:
            animation.save(
                str(temporary), writer=writer, dpi=dpi, extra_args=extra, progress_callback=tell
            )
        except subprocess.CalledProcessError as error:
            raise WorkError(f"{path}: ffmpeg failed with status {error.returncode}.") from error
    return path


@writers.register(GIF)
class _GifWriter(AbstractMovieWriter):
    """Frames in 256 colours each, one byte a pixel in memory, and times that add up."""

    @classmethod
    def isAvailable(cls) -> bool:
        """Return that it is: matplotlib needs Pillow itself."""
        return True

    def setup(self, fig: Figure, outfile: Any, dpi: float | None = None) -> None:
        """Begin."""
        super().setup(fig, outfile, dpi=dpi)
        if self.fps > 100.0:
            raise InputError(f"fps_out: a gif shows at most 100 frames a second, not {self.fps:g}.")
        self._pictures: list[Image.Image] = []

    def grab_frame(self, **savefig_kwargs: Any) -> None:
        """Keep a frame."""
        stream = io.BytesIO()
        self.fig.savefig(stream, **{**savefig_kwargs, "format": "rgba", "dpi": self.dpi})
        whole = Image.frombuffer("RGBA", self.frame_size, stream.getvalue(), "raw", "RGBA", 0, 1)
        self._pictures.append(whole.convert("RGB").quantize(method=COLOURS, dither=PLAIN))

    def finish(self) -> None:
        """Write the file."""
        ends = np.round(np.arange(len(self._pictures) + 1) * 100.0 / self.fps)
        first, *others = self._pictures
        first.save(
            self.outfile,
            format="GIF",
            save_all=True,
            append_images=others,
            duration=[int(10 * length) for length in np.diff(ends)],
            loop=0,
        )


def _own_style() -> Any:
    """Return a context in which a film is saved as it was drawn."""
    return matplotlib.rc_context({"savefig.facecolor": "auto", "savefig.transparent": False})
