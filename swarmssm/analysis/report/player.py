"""Tracks in a browser: a player that needs no network, alone on a page or as a part of one."""

from typing import Any, Unpack

import numpy as np
import xarray as xr
from markupsafe import Markup

from swarmssm.analysis.plots.frames import length_of
from swarmssm.analysis.plots.scenes.scene import (
    FLAT,
    Choice,
    Scene,
    box_of,
    decimals_of,
    pace_of,
    scenes_of,
)
from swarmssm.analysis.plots.style import individual_colours
from swarmssm.analysis.plots.tracks import TAIL
from swarmssm.analysis.report.page import Page, Player, render
from swarmssm.analysis.report.player_data import pack_scene, resolution_of
from swarmssm.errors import InputError

__all__ = ["player_fragment", "player_page"]

#: Bytes of text at most: a page that takes more opens slowly.
MAX_BYTES = 15_000_000
#: The player leaves out frames where there are more than the screen shows.
FASTEST = np.inf
SPEEDS = (0.25, 0.5, 1, 2, 4, 8)
TITLES = ("Observed", "Predicted")
DRAWN = (
    "A dart looks along the last motion; a disc has not moved yet. Behind each is its path over "
    "{tail} frames."
)
GRAPH = (
    " A line joins two who see each other; an arrow goes from who sees to who is seen, where it is "
    "not mutual."
)


def player_fragment(
    tracks: xr.Dataset,
    predicted: xr.Dataset | None = None,
    *,
    tail: int = TAIL,
    fps_out: float | None = None,
    titles: tuple[str, str] = TITLES,
    label: str = "Player of tracks",
    autoplay: bool = False,
    **choice: Unpack[Choice],
) -> Markup:
    """Return a player as a part of a page: HTML with its data; the page adds style and script.

    Parameters
    ----------
    tracks, predicted
        Tracks, and for instance a :func:`swarmssm.analysis.plots.scenes.free_run` on them.
    tail
        Frames of path behind each individual; 0 for none.
    fps_out
        Frames shown a second. Default: as it was; 25 for what has less than 4.
    titles
        Of the two pictures.
    label
        Name of the player for those who do not see it.
    autoplay
        Whether to start by itself; where the reader prefers reduced motion it does not.
    **choice
        ``trial, individuals, start, steps, every, edges, predicted_start``: what is shown, see
        :func:`swarmssm.analysis.plots.scenes.scenes_of`.

    Returns
    -------
    Markup without any name (``id``) of its own. It takes the colours of the page's ``--ink``,
    ``--soft``, ``--paper``, ``--line`` and ``--accent``, where there are, and follows light and
    dark. Its element has ``player`` with ``play()``, ``pause()``, ``seek(frame)``, ``frame`` and
    ``playing``, and ``data-state="ready"`` once it can be used.

    Raises
    ------
    InputError
        As ``scenes_of``; if ``tail`` or ``fps_out`` is out of range;
        if it would be larger than 15 MB.
    """
    scenes = scenes_of(tracks, predicted, **choice)
    return _body(scenes, tail, fps_out, titles, label, autoplay, page=False)


def player_page(
    tracks: xr.Dataset,
    predicted: xr.Dataset | None = None,
    *,
    title: str = "Tracks",
    tail: int = TAIL,
    fps_out: float | None = None,
    titles: tuple[str, str] = TITLES,
    autoplay: bool = True,
    **choice: Unpack[Choice],
) -> Page:
    """Return a page with a player alone, which has the keys of the keyboard.

    Parameters
    ----------
    title
        Heading.
    tracks, predicted, tail, fps_out, titles, autoplay, **choice
        As for :func:`player_fragment`.

    Raises
    ------
    InputError
        As :func:`player_fragment`.
    """
    scenes = scenes_of(tracks, predicted, **choice)
    body = _body(scenes, tail, fps_out, titles, title, autoplay, page=True)
    return Page(title, [Player("", "", body)])


def _body(
    scenes: list[Scene],
    tail: int,
    fps_out: float | None,
    titles: tuple[str, str],
    label: str,
    autoplay: bool,
    *,
    page: bool,
) -> Markup:
    """Return the player without style and script."""
    if tail < 0:
        raise InputError(f"tail: it must be at least 0, and it is {tail}.")
    first = scenes[0]
    pace = pace_of(first, fps_out, FASTEST)
    box, leaves = box_of(scenes)
    members = list(dict.fromkeys(name for scene in scenes for name in scene.individuals))
    colours = dict(zip(members, individual_colours(len(members)), strict=True))
    packed = [
        pack_scene(scene) | {"colours": [colours[name] for name in scene.individuals]}
        for scene in scenes
    ]
    if sum(len(one["bytes"]) for one in packed) > MAX_BYTES:
        raise InputError(
            f"tracks: {len(first.time)} frames of {len(first.individuals)} individuals make a page "
            f"of more than {MAX_BYTES // 10**6} MB. Take fewer steps, every n-th frame, fewer "
            "individuals, or no edges."
        )
    graph = any(one["graph"] for one in packed)
    ratio = pace / first.rate
    film: dict[str, Any] = {
        "frames": len(first.time),
        "first": float(first.time[0]),
        "step": 1.0 / first.rate,
        "digits": decimals_of(first),
        "pace": pace,
        "tail": tail,
        "box": box,
        "length": length_of(box, len(members)),
        "unit": first.unit,
        "scenes": packed,
        "autoplay": autoplay,
        "page": page,
    }
    unit = f" {first.unit}" if first.unit else ""
    half = max(resolution_of(scene) for scene in scenes) / 2
    notes = [f"Positions are kept to within {half:.2g}{unit}."]
    if first.flat:
        notes.append(FLAT)
    if leaves:
        notes.append(f"Some positions of “{titles[1]}” lie outside of the picture.")
    panels = [
        {"title": title, "alt": _alt(title, scene)}
        for title, scene in zip(titles, scenes, strict=False)
    ]
    return Markup(
        render(
            "player.html",
            film=film,
            label=label,
            panels=panels,
            graph=graph,
            aspect=f"{(box[1] - box[0]) / (box[3] - box[2]):.4f}",
            speeds=[(factor, f"{factor * ratio:.3g}×") for factor in SPEEDS],
            notes=[" ".join(notes)],
            drawn=DRAWN.format(tail=tail) + (GRAPH if graph else ""),
        )
    )


def _alt(title: str, scene: Scene) -> str:
    """Return what a picture shows, in words."""
    who = (
        "one individual"
        if len(scene.individuals) == 1
        else (f"{len(scene.individuals)} individuals")
    )
    return (
        f"{title}: {who}, trial {scene.trial}, {len(scene.time)} frames from "
        f"{scene.time[0]:.4g} s to {scene.time[-1]:.4g} s"
    )
