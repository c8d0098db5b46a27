"""A perception radius summed out over a grid, for states that are known exactly."""

from collections.abc import Mapping, Sequence

import pyro
import torch
from pyro.nn import PyroModule
from torch import Tensor

from swarmssm.errors import InputError
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.edges import Edges
from swarmssm.models.parameters import assign
from swarmssm.models.state_space import StateSpaceModel
from swarmssm.models.transitions.boids import BoidsTransition

__all__ = ["RadiusGridModel"]


class RadiusGridModel(StateSpaceModel):
    r"""Boids of one unknown radius of sight, sharp, out of K that are possible.

    .. math::
        p(z, \theta) = p(\theta) \sum_{k=1}^K \pi_k \prod_{w} p(z_{1:T,w} \mid \theta, r_k)

    The density is not continuous in a sharp radius, so that no gradient finds it; here it is
    summed out, and the posterior of the radius is exact at each :math:`\theta`
    (:meth:`radius_posterior`).

    It works where states are observed exactly, since only then can the transition be scored
    directly, and with **all windows in one batch**, because the radius is common to all: of a
    mini-batch the logarithm of the sum would be biased. A forward pass holds K times the memory of
    one radius. For hidden states give :class:`~swarmssm.models.transitions.BoidsTransition` a
    ``radius_width`` instead.

    Parameters
    ----------
    initial
        As in :class:`~swarmssm.models.StateSpaceModel`.
    transition
        With a ``radius``, whose value does not matter, and without ``radius_width``.
    radii
        :math:`r_k`.
    weights
        :math:`\pi_k`, up to a factor; absent, all are equal.
    edges
        Candidates, among which those within the radius are seen; absent, the observed ones.

    Raises
    ------
    InputError
        If the transition has no radius or a soft one, or the grid is empty or not positive.
    """

    def __init__(
        self,
        initial: PyroModule,
        transition: BoidsTransition,
        radii: Sequence[float] | Tensor,
        *,
        weights: Sequence[float] | Tensor | None = None,
        edges: Edges | None = None,
    ) -> None:
        super().__init__(initial, transition, None, edges)
        if not transition.has_radius or not transition.is_sharp:
            raise InputError("transition: it must have a radius, and no radius_width.")
        grid = torch.as_tensor(radii, dtype=torch.get_default_dtype())
        if grid.dim() != 1 or not len(grid) or not bool((grid > 0).all()):
            raise InputError("radii: they must be one or more positive numbers.")
        given = torch.ones_like(grid) if weights is None else torch.as_tensor(weights).to(grid)
        if given.shape != grid.shape or not bool((given > 0).all()):
            raise InputError(f"weights: they must be {len(grid)} positive numbers, one a radius.")
        assign(transition, "radius", float(grid[0]))
        self.register_buffer("radii", grid)
        self.register_buffer("log_weights", given.log() - given.sum().log())

    def radius_log_densities(self, batch: SwarmBatch, values: Mapping[str, Tensor]) -> Tensor:
        """Return the log-density of all windows for each radius, ``(radius,)``.

        Parameters
        ----------
        batch
            Windows, which count as their weights and the population say.
        values
            Of the parameters with a prior, by full name.
        """
        scale = batch.window_weight * (batch.population / len(batch))
        kept = self.transition._buffers["radius"]
        found = []
        try:
            for radius in self.radii:
                self.transition._buffers["radius"] = radius
                found.append((self.chain(batch, values).log_prob(batch.observations) * scale).sum())
        finally:
            self.transition._buffers["radius"] = kept
        return torch.stack(found)

    def radius_posterior(self, batch: SwarmBatch, values: Mapping[str, Tensor]) -> Tensor:
        """Return the probability of each radius given the other parameters, ``(radius,)``."""
        with torch.no_grad():
            densities: Tensor = self.radius_log_densities(batch, values) + self.log_weights
            return densities.softmax(0)

    def forward(self, batch: SwarmBatch) -> Tensor:
        """Score all windows; to be run under a Pyro handler. Returns the paths."""
        values = self.sample_globals()
        self._check_features(batch, self.state_dim)
        densities = self.radius_log_densities(batch, values) + self.log_weights
        pyro.factor("states", densities.logsumexp(0))
        return batch.observations
