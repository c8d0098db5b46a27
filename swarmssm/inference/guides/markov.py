"""A guide in which each state, given the one before, is an affine Gaussian."""

from collections.abc import Callable, Mapping
from typing import Any, ClassVar

import torch
from torch import Tensor, nn

from swarmssm.graphs import EdgeList, Graph, degree, neighbor_sum
from swarmssm.inference.guides.base import MEAN_DRAWS
from swarmssm.inference.guides.chains import NeighborTerm
from swarmssm.inference.guides.following import ModelInformedGuide
from swarmssm.models import SwarmBatch
from swarmssm.models.markov import StepInputs
from swarmssm.models.state_space import StateSpaceModel

__all__ = ["MarkovGuide"]


class MarkovGuide(ModelInformedGuide):
    r"""Affine Gaussian steps, which keep the correlation in time.

    .. math::
        q(z_{1:T} \mid x) = \prod_i q(z_{1,i} \mid x)
        \prod_{t>1} N\bigl(f_{t,i};\; A_{t,i} (z_{t-1,i} - m_{t-1,i})
        + B_{t,i} (\bar z_{t-1,\mathcal{N}_i} - \bar m_{t-1,\mathcal{N}_i}) + b_{t,i},\;
        S_{t,i}\bigr)

    where f are the features that noise moves, m is a reference path, and bars are means over
    neighbours. Gains, offsets and covariances are those of the exact smoother of an individual that
    goes where the model says it goes from the reference, seen as noisily as the model says, all of
    it corrected by a network (``ModelInformedGuide``). For a
    linear-Gaussian swarm without interaction the exact posterior is in the family; with
    interaction, all but the correlation between individuals within one step.

    Parameters
    ----------
    model, parameters, hidden, passes
        See :class:`~swarmssm.inference.guides.following.ModelInformedGuide`.
    coupling
        Whether the states of neighbours just before enter the mean.
    """

    differentiates_law: ClassVar[bool] = True

    def __init__(
        self,
        model: StateSpaceModel,
        parameters: str = "multivariate",
        hidden: int = 32,
        passes: int = 2,
        coupling: bool = True,
    ) -> None:
        super().__init__(model, parameters, hidden, passes)
        self.options: dict[str, Any] = {**self.options, "coupling": coupling}
        self.coupling = coupling
        if self.is_kinematic:
            # What position and velocity of the neighbours do, on each axis.
            self.neighbor_gain = nn.Parameter(torch.zeros(2))

    def path(self, batch: SwarmBatch, values: Mapping[str, Tensor]) -> tuple[Tensor, Tensor]:
        """Draw a path for each window; see :meth:`PathGuide.path`."""
        return self._drawing(batch, values)()

    def last_state(self, batch: SwarmBatch, values: Mapping[str, Tensor], draws: int) -> Tensor:
        """Draw the state of the last frame; see :meth:`PathGuide.last_state`."""
        if not draws:
            return super().last_state(batch, values, draws)
        draw = self._drawing(batch, values)
        return torch.stack([draw()[0][:, -1] for _ in range(draws)])

    def mean_path(self, batch: SwarmBatch, values: Mapping[str, Tensor]) -> Tensor:
        """Return the mean of the path; see :meth:`PathGuide.mean_path`."""
        draw = self._drawing(batch, values)
        total = draw()[0]
        for _ in range(MEAN_DRAWS - 1):
            total = total + draw()[0]
        return total / MEAN_DRAWS

    def _drawing(
        self, batch: SwarmBatch, values: Mapping[str, Tensor]
    ) -> Callable[[], tuple[Tensor, Tensor]]:
        """Return what draws paths with their density: the network is asked but once for all."""
        known = self.setting(batch, values)
        steps = self.chain.steps(known.sightings, known.law, known.start, batch.present)
        log_scale_correction = known.correction
        free_stretch = self.model.transition.stochastic_features(log_scale_correction)[:, 1:]
        pull = None
        if self.coupling and known.graph is not None and batch.num_times > 1:
            pull = self._pull(known.graph, log_scale_correction)

        def draw() -> tuple[Tensor, Tensor]:
            off, density = steps.draw(log_scale_correction, free_stretch, pull)
            return known.reference + off, density

        return draw

    def _pull(self, graph: Graph, like: Tensor) -> NeighborTerm:
        """Return what the neighbours of a step add to the mean."""
        if isinstance(graph, EdgeList):
            frames = StepInputs(graph)
            graphs = [frames.at(t).adjacency for t in range(graph.leading[-1])]
        else:
            graphs = list(graph.to(like.dtype).unbind(1))
        counts = degree(like[:, 1:], graph)
        each = torch.where(counts > 0, 1.0 / counts.clamp(min=1e-12), 0.0).unbind(1)

        def pull(step: int, state: Tensor) -> Tensor:
            known = graphs[step]
            assert known is not None
            if self.is_kinematic:
                p, v = state.chunk(2, -1)
                told = self.neighbor_gain[0] * p + self.neighbor_gain[1] * v
            else:
                told = state @ self.neighbor_gain.mT
            return each[step] * neighbor_sum(told, known)

        return pull
