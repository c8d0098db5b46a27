"""What the relational baselines share: they find out who moves whom by predicting motion."""

import dataclasses
from typing import ClassVar

import torch
from torch import Tensor

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.neural import NeuralBaseline
from swarmssm.baselines.relational_decoders import PerceptronDecoder, RecurrentDecoder
from swarmssm.baselines.windows import Trials, Windows
from swarmssm.errors import InputError
from swarmssm.models.relational import pairs_of
from swarmssm.tracks import Array

__all__ = ["RelationalBaseline", "reconstruction"]


class RelationalBaseline(NeuralBaseline):
    r"""A baseline that is given no graph, and gives each ordered pair a type of edge.

    It is trained by the evidence lower bound of the states in a window,

    .. math::
        \sum_{t, i} \frac{|x_{t+1, i} - \hat x_{t+1, i}|^2}{2 \sigma^2} +
        \sum_{ij} \mathrm{KL}\bigl(q(z_{ij}) \,\|\, p(z)\bigr),

    here per feature, individual and frame. The output variance is fixed as in the paper, except
    that it is never below the mean square of recent errors: as long as the decoder is bad, these
    would else decide on the edges before they can tell. From randomly chosen frames the decoder
    goes on by itself over a number of steps that is drawn anew for each batch; at first it is one.
    The graph of :class:`~swarmssm.analysis.scoring.baseline.Training` is not looked at.

    Attributes
    ----------
    edge_types
        Number of types; type 0 is no edge, and sends no message.
    no_edge
        Prior probability of type 0; ``None``: all types are equally likely.
    variance
        Of the output, in units of the standardised states. The paper's 5e-5 is in those of data
        scaled to [-1, 1], whose standard deviation is some third: 5e-4 here.
    temperature
        Of the relaxed draws of edges while training.
    stretches
        Numbers of steps over which the decoder goes on by itself, of which one is drawn: the first
        in the first part of the training, then of the first two, and so on.
    decoded
        Steps of each window that are decoded in one batch, all stretches together.
    hidden
        Width of encoder and decoder.
    changes
        Whether the encoder is also given what each state changed by since the frame before.
    relative
        Whether the encoder is also given relative positions and velocities of each pair.
    """

    order: int = 49
    ahead: ClassVar[int] = 1
    edge_types: ClassVar[int] = 2
    no_edge: ClassVar[float | None] = None
    variance: ClassVar[float] = 5e-4
    temperature: ClassVar[float] = 0.5
    stretches: ClassVar[tuple[int, ...]] = (1, 5, 10)
    decoded: ClassVar[int] = 10
    hidden: ClassVar[int] = 64
    changes: ClassVar[bool] = True
    relative: ClassVar[bool] = False
    pairwise: ClassVar[bool] = True
    rows: ClassVar[int] = 640
    pairs: ClassVar[int] = 6400

    def __init__(self) -> None:
        super().__init__()
        self._errors: dict[int, float] = {}

    def edge_probabilities(self, states: Array, fps: float) -> Array:
        """Return how likely each type of edge is, looking back and ahead.

        Parameters
        ----------
        states
            Shape ``(trial, time, individual, state)``.
        fps
            Frames per second.

        Returns
        -------
        Shape ``(trial, time or 1, individual, neighbor, edge_type)``: what type of edge the
        neighbor has upon the individual. NaN for pairs that are not two, or never seen together.
        """
        raise TypeError(f"{type(self).__name__} must define edge_probabilities(states, fps)")

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Train the network; the graph is for it to find out."""
        self._errors = {}
        super().learn(states, fps, dataclasses.replace(training, graph=None))

    def _trials(self, states: Array, fps: float, after: int) -> Trials:
        """Cut windows with a whole history where there are any, and to train on up to the end.

        To train on, a trial counts as at least one window: so many origins are there for each.
        """
        trials = super()._trials(states, fps, after)
        late = trials.origins[trials.origins[:, 1] >= self.order - 1]
        if after != self.ahead:
            trials.origins = late if len(late) else trials.origins
            return trials
        there = trials.known[:, self.order - 1 : trials.known.shape[1] - after].any(-1).long()
        last = there.shape[1] - 1 - there.flip(1).argmax(1)
        counts = torch.bincount(late[:, 0], minlength=len(last))
        copies = (self.order + self.ahead - counts).clamp(min=1) * (last > 0)
        ends = torch.stack([torch.arange(len(last)), last], dim=-1)
        trials.origins = torch.cat([late, ends.repeat_interleave(copies, dim=0)])
        return trials

    def _bound(
        self, square: Tensor, count: Tensor, divergence: Tensor, features: int, steps: int
    ) -> Tensor:
        """Return minus the evidence lower bound of a feature of a state, without its constant.

        Parameters
        ----------
        square, count
            Sum of squared errors, and of how many states.
        divergence
            Of the posterior from the prior, for each individual and frame.
        features
            Of a state.
        steps
            Over which the decoder went on by itself.
        """
        mean = square / (features * count.clamp(min=1))
        now = float(mean.detach())
        recent = self._errors[steps] = 0.95 * self._errors.get(steps, now) + 0.05 * now
        return mean / (2.0 * max(self.variance, recent)) + divergence / features

    def _scaled_windows(self, states: Array, fps: float) -> tuple[Tensor, Tensor]:
        """Return scaled states and who is seen, of whole trials."""
        if states.ndim != 4:
            raise InputError(
                "states: their shape must be (trial, time, individual, state), and it is "
                f"{states.shape}."
            )
        windows = self._windows(states, fps)
        return windows.states, windows.seen

    def _draw_stretch(self, frames: int) -> tuple[int, Tensor]:
        """Return over how many steps the decoder goes on by itself, and from which frames."""
        allowed = self.stretches[: 1 + int(self.done * len(self.stretches))]
        possible = [steps for steps in allowed if steps < frames] or [1]
        steps = possible[int(torch.randint(len(possible), ()))]
        count = max(1, self.decoded // steps)
        return steps, torch.randint(frames - steps, (count,))


def reconstruction(
    decoder: PerceptronDecoder | RecurrentDecoder,
    windows: Windows,
    edges: Tensor,
    steps: int,
    starts: Tensor,
) -> tuple[Tensor, Tensor]:
    """Return the sum of squared errors of stretches, and the number of states in it.

    Parameters
    ----------
    decoder
        Without memory.
    windows
        A batch.
    edges
        Weights of the types, ``(batch, time, individual, neighbor, edge_type)``, or 1 for time.
    steps
        Over which the decoder goes on by itself.
    starts
        Frames from which it does, ``(stretch,)``.
    """
    states = windows.states[:, starts].flatten(0, 1)
    there = windows.seen[:, starts].flatten(0, 1)
    pairs = pairs_of(there).unsqueeze(-1).to(edges.dtype)
    hidden = decoder.begin(states)
    square, count = states.new_zeros(()), states.new_zeros(())
    for k in range(steps):
        fixed = edges.shape[1] == 1
        now = edges.expand(-1, len(starts), -1, -1, -1) if fixed else edges[:, starts + k]
        now = now.flatten(0, 1) * pairs
        states, hidden = decoder(states, now, hidden)
        target = windows.states[:, starts + k + 1].flatten(0, 1)
        here = windows.known[:, starts + k + 1].flatten(0, 1) & there
        square = square + torch.where(here, (target - states).square().sum(-1), 0.0).sum()
        count = count + here.sum()
    return square, count
