"""Neural relational inference: edges of a window, found by predicting its motion."""

from typing import ClassVar

import numpy as np
import torch
from torch import Tensor

from swarmssm.baselines.neural import Memory, Setting, StepNetwork
from swarmssm.baselines.relational import RelationalBaseline, reconstruction
from swarmssm.baselines.relational_decoders import PerceptronDecoder, RecurrentDecoder
from swarmssm.baselines.windows import Windows
from swarmssm.metrics.masked import known
from swarmssm.models.relational import (
    EdgeEncoder,
    categorical_kl,
    pairs_of,
    sample_edges,
    sparse_logits,
)
from swarmssm.tracks import Array

__all__ = ["NeuralRelationalInference", "RecurrentRelationalInference"]

#: Share of training windows of which the first frames are hidden from the encoder.
SHORTENED = 0.1


class NeuralRelationalInference(RelationalBaseline):
    r"""Neural relational inference: a type of edge for each pair, which lasts for a window.

    .. math::
        q(z_{ij} \mid x_{1:T}) = \mathrm{softmax}\, f_{enc}(x_{1:T})_{ij}, \qquad
        p(x_{t+1} \mid x_t, z) = \mathcal{N}\bigl(f_{dec}(x_t, z),\ \sigma^2 I\bigr),

    the encoder being :class:`~swarmssm.models.relational.EdgeEncoder` and the decoder
    :class:`~swarmssm.baselines.relational_decoders.PerceptronDecoder`. A forecast takes the
    probabilities of the edges from the history alone, and keeps them.

    The original: windows of 49 frames, encoder and decoder 256 wide, 500 epochs of Adam with 5e-4
    halved every 200, batches of 128, output variance 5e-5 of data scaled to [-1, 1], temperature
    0.5, errors over 10 steps, two types without a fixed one for no edge. Here 64 wide, Adam with
    2e-3 on a cosine, type 0 sends no message, layer in place of batch normalisation; the encoder is
    also given the changes from frame to frame, whose weights begin at 0; windows are
    shortened now and then, so that short histories have edges, too; and of the 48 steps of a window
    only some are decoded in each batch, over 1, 5 or 10 steps.

    Shapes
    ------
    As in :class:`NeuralBaseline`; any number of space dimensions.
    """

    name: ClassVar[str] = "nri"
    title: ClassVar[str] = "NRI, MLP decoder"
    paper: ClassVar[str] = (
        "Kipf, Fetaya, Wang, Welling and Zemel (2018), Neural relational inference for "
        "interacting systems, ICML"
    )
    learning_rate: ClassVar[float] = 2e-3
    decoder: ClassVar[type[PerceptronDecoder] | type[RecurrentDecoder]] = PerceptronDecoder

    def build(self, setting: Setting) -> StepNetwork:
        """Return encoder and decoder."""
        encoder = EdgeEncoder(
            setting.features,
            self.order,
            self.edge_types,
            self.hidden,
            change=setting.change if self.changes else None,
            relative=self.relative,
        )
        decoder = self.decoder(setting.change, self.hidden, self.edge_types)
        return _Relational(encoder, decoder, sparse_logits(self.edge_types, self.no_edge))

    def loss(self, network: StepNetwork, windows: Windows, typical: Tensor) -> Tensor:
        """Return minus the evidence lower bound, scaled."""
        assert isinstance(network, _Relational)
        past = windows.first(self.order)
        seen = _shortened(past.seen)
        logits = network.encoder(past.states, seen)
        pairs = pairs_of(seen.any(1))
        drawn = sample_edges(logits, self.temperature) * pairs.unsqueeze(-1)
        square, count, steps = network.reconstruct(self, windows, drawn)
        divergence = categorical_kl(logits, network.get_buffer("prior"))
        divergence = (divergence * pairs).sum() / seen.any(1).sum().clamp(min=1)
        frames = self.order + self.ahead - 1
        return self._bound(square, count, divergence / frames, windows.states.shape[-1], steps)

    def one_step(self, states: Array, fps: float) -> Array:
        """Predict each frame from the :attr:`order` frames before it, and their edges."""
        network, scaler = self._learned()
        *_, frames, individuals, features = states.shape
        rows = states.reshape(-1, frames, individuals, features)
        predicted = np.full(rows.shape, np.nan)
        outside = ((self.order - 1, 0), (0, 0), (0, 0))
        size = max(1, self._at_once(individuals) // 8)
        for row, target in zip(rows, predicted, strict=True):
            padded = np.pad(row[:-1], outside, constant_values=np.nan)
            for start in range(0, frames - 1, size):
                places = np.arange(start, min(start + size, frames - 1))[:, None]
                past = self._windows(padded[places + np.arange(self.order)], fps)
                with torch.no_grad():
                    expected, _ = network.remember(past.states, past.seen, past.graph)
                found = scaler.inverse(expected.double().numpy())
                found[~known(row[places[:, 0]])] = np.nan
                target[places[:, 0] + 1] = found
        return predicted.reshape(states.shape)

    def edge_probabilities(self, states: Array, fps: float) -> Array:
        """Return how likely each type of edge is.

        A recording longer than :attr:`order` frames is cut into windows of as many, the last of
        which may overlap with the one before it; each frame has the edges of its window.

        Parameters
        ----------
        states
            Shape ``(trial, time, individual, state)``.
        fps
            Frames per second.

        Returns
        -------
        Shape ``(trial, time or 1, individual, neighbor, edge_type)``, 1 if one window holds it all.
        NaN for pairs that are not two, or one of which is not there.
        """
        network, _ = self._learned()
        assert isinstance(network, _Relational)
        scaled, seen = self._scaled_windows(states, fps)
        frames = scaled.shape[1]
        found = []
        for start in range(0, frames, self.order):
            first = max(0, min(start, frames - self.order))
            part = slice(first, first + self.order)
            with torch.no_grad():
                edges = network.infer(scaled[:, part], seen[:, part])
            pairs = pairs_of(seen[:, part].any(1)).unsqueeze(-1)
            edges = torch.where(pairs, edges, torch.nan).unsqueeze(1)
            length = min(self.order, frames - start)
            found.append(edges if frames <= self.order else edges.expand(-1, length, -1, -1, -1))
        return torch.cat(found, dim=1).double().numpy()


class RecurrentRelationalInference(NeuralRelationalInference):
    """Neural relational inference with a recurrent decoder.

    As :class:`NeuralRelationalInference`, with
    :class:`~swarmssm.baselines.relational_decoders.RecurrentDecoder`, which the paper uses
    for systems whose next state does not follow from the last one. It is given the truth up to the
    last 10 frames of a window, as in the paper, and goes on by itself from there.
    """

    name: ClassVar[str] = "nri-rnn"
    title: ClassVar[str] = "NRI, RNN decoder"
    decoder: ClassVar[type[PerceptronDecoder] | type[RecurrentDecoder]] = RecurrentDecoder
    free: ClassVar[int] = 10


class _Relational(StepNetwork):
    """Encoder and decoder; the edges are part of the memory."""

    def __init__(
        self, encoder: EdgeEncoder, decoder: PerceptronDecoder | RecurrentDecoder, prior: Tensor
    ) -> None:
        super().__init__()
        self.encoder, self.decoder = encoder, decoder
        self.register_buffer("prior", prior)

    def begin(self, states: Tensor) -> Memory:
        """Return edges as likely as before any motion is seen."""
        size = states.shape[-2]
        edges = torch.softmax(self.get_buffer("prior"), dim=-1).expand(len(states), size, size, -1)
        return {"edges": edges, "hidden": self.decoder.begin(states)}

    def step(
        self, states: Tensor, mask: Tensor, graph: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        edges = memory["edges"] * pairs_of(mask).unsqueeze(-1)
        expected, hidden = self.decoder(states, edges, memory["hidden"])
        return expected, {"edges": memory["edges"], "hidden": hidden}

    def infer(self, states: Tensor, seen: Tensor) -> Tensor:
        """Return the probabilities of the types, ``(batch, individual, neighbor, edge_type)``."""
        return torch.softmax(self.encoder(states, seen), dim=-1)

    def remember(self, states: Tensor, mask: Tensor, graph: Tensor) -> tuple[Tensor, Memory]:
        """Infer the edges from the whole history, then run the decoder over it."""
        memory = {**self.begin(states[:, 0]), "edges": self.infer(states, mask)}
        first = states.shape[1] - 1 if isinstance(self.decoder, PerceptronDecoder) else 0
        for now, there in zip(states[:, first:].unbind(1), mask[:, first:].unbind(1), strict=True):
            expected, memory = self.step(now, there, graph, memory)
            hidden = torch.where(there.unsqueeze(-1), memory["hidden"], 0.0)
            memory = {**memory, "hidden": hidden}
        return expected, memory

    def reconstruct(
        self, baseline: NeuralRelationalInference, windows: Windows, edges: Tensor
    ) -> tuple[Tensor, Tensor, int]:
        """Return the sum of squared errors, of how many states, and over how many steps."""
        frames = windows.states.shape[1]
        if isinstance(self.decoder, PerceptronDecoder):
            steps, starts = baseline._draw_stretch(frames)
            found = reconstruction(self.decoder, windows, edges.unsqueeze(1), steps, starts)
            return *found, steps
        assert isinstance(baseline, RecurrentRelationalInference)
        given = max(1, frames - baseline.free)
        memory = {**self.begin(windows.states[:, 0]), "edges": edges}
        square, count = edges.new_zeros(()), edges.new_zeros(())
        for k in range(frames - 1):
            if k < given:
                states, there = windows.states[:, k], windows.seen[:, k]
            states, memory = self.step(states, there, windows.graph[:, k], memory)
            hidden = torch.where(there.unsqueeze(-1), memory["hidden"], 0.0)
            memory = {**memory, "hidden": hidden}
            here = windows.known[:, k + 1] & there
            error = (windows.states[:, k + 1] - states).square().sum(-1)
            square = square + torch.where(here, error, 0.0).sum()
            count = count + here.sum()
        return square, count, baseline.free


def _shortened(seen: Tensor) -> Tensor:
    """Hide the first frames of some windows ``(batch, time, individual)``."""
    batch, frames = seen.shape[:2]
    first = torch.randint(frames, (batch,)) * (torch.rand(batch) < SHORTENED)
    return seen & (torch.arange(frames) >= first[:, None]).unsqueeze(-1)
