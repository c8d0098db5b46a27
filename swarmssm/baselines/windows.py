"""Windows of tracks to learn from, with the places of what is unknown in them."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
from torch import Tensor

from swarmssm.graphs import GraphRule
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array
from swarmssm.tracks.scaling import Scaler

__all__ = ["Trials", "Windows", "carried_forward", "graphs_of", "standardiser"]

Mask = npt.NDArray[np.bool_]

#: Entries of the graphs of all frames that are made once and kept; more are made window by window.
GRAPHS_KEPT = 100_000_000


def standardiser(states: Array) -> Scaler:
    """Return the scaler to mean 0 and standard deviation 1 of each feature.

    A feature that never changes is only shifted.

    Parameters
    ----------
    states
        Shape ``(..., state)``, NaN where unknown; each feature is known somewhere.
    """
    rows = states.reshape(-1, states.shape[-1])
    rows = rows[np.isfinite(rows).all(-1)]
    offset, scale = rows.mean(0), rows.std(0)
    scale[~(scale > 1e-12 * np.abs(rows).max(0))] = 1.0
    return Scaler("standard", tuple(offset.tolist()), tuple(scale.tolist()))


def carried_forward(states: Array, fps: float, most: int) -> tuple[Array, Mask]:
    """Fill gaps from what was known before them, at constant velocity.

    Parameters
    ----------
    states
        Shape ``(..., time, individual, state)``, NaN where unknown, ordered ``[x, y, vx, vy]``.
    fps
        Frames per second.
    most
        Length of a gap, in frames, up to which it is filled.

    Returns
    -------
    Filled states, 0 where there is nothing to fill with, and where they are known or filled
    ``(..., time, individual)``. Nothing is taken from later frames.
    """
    here = known(states)
    frames = np.arange(states.shape[-3])[:, None]
    last = np.maximum.accumulate(np.where(here, frames, -1), axis=-2)
    age = frames - last
    seen = (last >= 0) & (age <= most)
    filled = np.take_along_axis(np.where(here[..., None], states, 0.0), last[..., None], axis=-3)
    half = states.shape[-1] // 2
    filled[..., :half] += filled[..., half:] * (age / fps)[..., None]
    return np.where(seen[..., None], filled, 0.0), seen


def graphs_of(states: Tensor, mask: Tensor, rule: GraphRule | None) -> Tensor:
    """Return who sees whom.

    Parameters
    ----------
    states
        In the tracks' units, ``(..., individual, state)``.
    mask
        Who is there, ``(..., individual)``.
    rule
        How the graph follows from positions and velocities; ``None``: everybody sees everybody.

    Returns
    -------
    Shape ``(..., individual, individual)``, bool; nobody who is not there sees or is seen.
    """
    if rule is None:
        own = torch.eye(mask.shape[-1], dtype=torch.bool)
        return mask[..., :, None] & mask[..., None, :] & ~own
    position, velocity = torch.where(mask[..., None], states, torch.nan).chunk(2, dim=-1)
    return rule(position, velocity).bool()


@dataclass(frozen=True)
class Windows:
    """Windows of several frames, cut out of trials.

    Attributes
    ----------
    states
        Scaled, gaps filled by :func:`carried_forward`, 0 elsewhere: float32
        ``(window, time, individual, state)``.
    known
        Where the state was really known: ``(window, time, individual)``. Only these are scored.
    seen
        Where it was known or a gap was filled.
    graph
        Who saw whom, as float32 0 and 1: ``(window, time, individual, individual)``; of the known
        alone.
    """

    states: Tensor
    known: Tensor
    seen: Tensor
    graph: Tensor

    def __len__(self) -> int:
        """Return how many windows there are."""
        return len(self.states)

    def first(self, frames: int) -> "Windows":
        """Return the first frames of each window."""
        parts = (self.states, self.known, self.seen, self.graph)
        return Windows(*(part[:, :frames] for part in parts))


class Trials:
    """Scaled trials, from which windows about any frame can be cut.

    Parameters
    ----------
    states
        In the tracks' units, ``(trial, time, individual, state)``, NaN where unknown.
    fps
        Frames per second.
    scaler
        Of the training part.
    rule
        Of the graph.
    before
        Frames of a window up to its origin, that included.
    after
        Frames after the origin.
    """

    def __init__(
        self,
        states: Array,
        fps: float,
        scaler: Scaler,
        rule: GraphRule | None,
        before: int,
        after: int,
    ) -> None:
        self.before, self.after = before, after
        self.rule, self.scaler = rule, scaler
        outside = ((0, 0), (before - 1, after), (0, 0), (0, 0))
        padded = np.pad(states, outside, constant_values=np.nan)
        filled, seen = carried_forward(padded, fps, before)
        self.seen = torch.from_numpy(seen)
        self.known = torch.from_numpy(known(padded))
        scaled = np.where(seen[..., None], scaler.transform(filled), 0.0)
        self.states = torch.from_numpy(scaled).float()
        here = known(states)
        # An origin is a frame from which somebody's next state is known.
        trial, frame = np.nonzero((here[:, :-1] & here[:, 1:]).any(-1))
        self.origins = torch.from_numpy(np.stack([trial, frame], axis=-1))
        few = self.known.numel() * states.shape[-2] <= GRAPHS_KEPT
        self.graph = self._graphs(self.states, self.known) if few else None

    def _graphs(self, scaled: Tensor, here: Tensor) -> Tensor:
        parts = [
            graphs_of(self.scaler.inverse_tensor(rows), mask, self.rule)
            for rows, mask in zip(torch.split(scaled, 1), torch.split(here, 1), strict=True)
        ]
        return torch.cat(parts)

    def windows(self, origins: Tensor) -> Windows:
        """Cut the windows about origins ``(window, 2)``: numbers of trial and frame."""
        frames = origins[:, 1:] + torch.arange(self.before + self.after)
        trial = origins[:, :1]
        states, here = self.states[trial, frames], self.known[trial, frames]
        graph = (
            self._graphs(states, here) if self.graph is None else self.graph[trial, frames]
        ).float()
        return Windows(states, here, self.seen[trial, frames], graph)
