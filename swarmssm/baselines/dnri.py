"""Dynamic neural relational inference: edges that may change at every step."""

from typing import ClassVar

import torch
from torch import Tensor

from swarmssm.baselines.neural import Memory, Setting, StepNetwork
from swarmssm.baselines.relational import RelationalBaseline, reconstruction
from swarmssm.baselines.relational_decoders import PerceptronDecoder
from swarmssm.baselines.windows import Windows
from swarmssm.models.relational import (
    DynamicEdgeEncoder,
    EdgeMemory,
    categorical_kl,
    pairs_of,
    sample_edges,
    sparse_logits,
)
from swarmssm.tracks import Array

__all__ = ["DynamicRelationalInference"]


class DynamicRelationalInference(RelationalBaseline):
    r"""Dynamic neural relational inference: a type of edge for each pair and step.

    .. math::
        p(x_{1:T}, z_{1:T}) = \prod_t p(z_t \mid x_{\le t})\,
        \mathcal{N}\bigl(x_{t+1};\ f_{dec}(x_t, z_t),\ \sigma^2 I\bigr), \qquad
        q(z_{1:T}) = \prod_t q(z_t \mid x_{1:T}),

    prior and posterior from :class:`~swarmssm.models.relational.DynamicEdgeEncoder`, the decoder is
    :class:`~swarmssm.baselines.relational_decoders.PerceptronDecoder`. The prior is learned
    and looks back only: a forecast goes on with it, over its own predictions, too. As a prior that
    learns would as well learn to find one type everywhere, half of the divergence is from one that
    is fixed, as in the published code.

    The original: encoder and decoder 256 wide, recurrences 64, heads of three layers 128 wide, 200
    epochs of Adam with 5e-4, batches of 16, errors over one step, both terms of the bound divided
    by the number of their entries. Here 64 wide and recurrences 32, Adam with 2e-3 on a cosine,
    batches of some 80 individuals, and the bound itself, with errors over 1, later over up to 10
    steps; the encoder is also given the changes from frame to frame, whose weights begin at 0.

    Shapes
    ------
    As in :class:`NeuralBaseline`; any number of space dimensions.
    """

    name: ClassVar[str] = "dnri"
    title: ClassVar[str] = "dNRI"
    paper: ClassVar[str] = "Graber and Schwing (2020), Dynamic neural relational inference, CVPR"
    learning_rate: ClassVar[float] = 2e-3
    recurrent: ClassVar[int] = 32
    rows: ClassVar[int] = 80
    decoded: ClassVar[int] = 50

    def build(self, setting: Setting) -> StepNetwork:
        """Return encoder and decoder."""
        encoder = DynamicEdgeEncoder(
            setting.features,
            self.edge_types,
            self.hidden,
            recurrent=self.recurrent,
            head=self.hidden,
            change=setting.change if self.changes else None,
            relative=self.relative,
        )
        decoder = PerceptronDecoder(setting.change, self.hidden, self.edge_types)
        return _Dynamic(encoder, decoder)

    def loss(self, network: StepNetwork, windows: Windows, typical: Tensor) -> Tensor:
        """Return minus the evidence lower bound, scaled."""
        assert isinstance(network, _Dynamic)
        prior, posterior = network.encoder(windows.states, windows.seen)
        drawn = sample_edges(posterior, self.temperature)
        frames = windows.states.shape[1]
        steps, starts = self._draw_stretch(frames)
        square, count = reconstruction(network.decoder, windows, drawn, steps, starts)
        pairs = pairs_of(windows.seen[:, :-1])
        late, early = posterior[:, :-1], sparse_logits(self.edge_types, self.no_edge)
        apart = 0.5 * (categorical_kl(late, prior[:, :-1]) + categorical_kl(late, early))
        divergence = (apart * pairs).sum()
        divergence = divergence / windows.seen[:, :-1].sum().clamp(min=1)
        return self._bound(square, count, divergence, windows.states.shape[-1], steps)

    def edge_probabilities(self, states: Array, fps: float) -> Array:
        """Return how likely each type of edge is in each frame, looking back and ahead.

        Parameters
        ----------
        states
            Shape ``(trial, time, individual, state)``.
        fps
            Frames per second.

        Returns
        -------
        Shape ``(trial, time, individual, neighbor, edge_type)``: of the edges that carry the group
        from this frame to the next. NaN for pairs that are not two, or not both there.
        """
        network, _ = self._learned()
        assert isinstance(network, _Dynamic)
        scaled, seen = self._scaled_windows(states, fps)
        found = []
        for some, there in zip(torch.split(scaled, 16), torch.split(seen, 16), strict=True):
            with torch.no_grad():
                _, posterior = network.encoder(some, there)
            edges = torch.softmax(posterior, dim=-1)
            found.append(torch.where(pairs_of(there).unsqueeze(-1), edges, torch.nan))
        return torch.cat(found).double().numpy()


class _Dynamic(StepNetwork):
    """Encoder and decoder; the memory is that of the encoder's forward recurrence."""

    def __init__(self, encoder: DynamicEdgeEncoder, decoder: PerceptronDecoder) -> None:
        super().__init__()
        self.encoder, self.decoder = encoder, decoder

    def begin(self, states: Tensor) -> Memory:
        """Return a memory of no motion at all."""
        size = states.shape[-2]
        empty = states.new_zeros((len(states), size, size, self.encoder.recurrent))
        nobody = states.new_zeros((*states.shape[:-1], states.shape[-1] + 1))
        return {"edge_hidden": empty, "edge_cell": empty, "last": nobody}

    def step(
        self, states: Tensor, mask: Tensor, graph: Tensor, memory: Memory
    ) -> tuple[Tensor, Memory]:
        expected, memory = self._advance(states.unsqueeze(1), mask.unsqueeze(1), memory)
        return expected[:, 0], memory

    def run(self, states: Tensor, mask: Tensor, graph: Tensor) -> tuple[Tensor, Memory]:
        """Go over known frames, all of them at once."""
        return self._advance(states, mask, self.begin(states[:, 0]))

    def _advance(self, states: Tensor, mask: Tensor, memory: Memory) -> tuple[Tensor, Memory]:
        """Return the expected state after each frame, by the prior's edges."""
        before = EdgeMemory(memory["edge_hidden"], memory["edge_cell"], memory["last"])
        prior, after = self.encoder.filter(states, mask, before)
        edges = torch.softmax(prior, dim=-1) * pairs_of(mask).unsqueeze(-1)
        flat = states.flatten(0, 1)
        expected, _ = self.decoder(flat, edges.flatten(0, 1), self.decoder.begin(flat))
        remembered = {"edge_hidden": after.hidden, "edge_cell": after.cell, "last": after.last}
        return expected.view(states.shape), remembered
