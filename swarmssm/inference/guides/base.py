"""What every guide offers."""

from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Self

import pyro
import pyro.distributions as dist
import torch

from swarmssm.inference.guides.edges import EdgeGuide
from swarmssm.inference.guides.parameters import GlobalGuide
from swarmssm.models import InferredEdges, StateSpaceModel, SwarmBatch, SwarmModel
from swarmssm.models.pyro_modules import LocalPyroModule, keep_own_parameters

__all__ = ["OneStepGuide", "ParameterGuide", "PathGuide", "SwarmGuide"]


#: Draws that stand for a mean.
MEAN_DRAWS = 20


class SwarmGuide(LocalPyroModule):
    """A Pyro guide over the latent sites of a :class:`swarmssm.models.SwarmModel`.

    A subclass writes :meth:`for_model`, which builds it, and :meth:`forward`, a Pyro guide that
    samples the site ``"states"`` and every parameter that has a prior.
    """

    #: Frames in a window unless the user says otherwise; ``None``, whole trials.
    window: ClassVar[int | None] = 20

    def __init__(self) -> None:
        super().__init__()
        keep_own_parameters(self)

    @classmethod
    def for_model(cls, model: SwarmModel, **options: Any) -> Self:
        """Return a guide that fits the model's latent states."""
        raise TypeError(f"{cls.__name__} must define for_model(model, **options)")

    def forward(self, batch: SwarmBatch) -> None:
        """Sample the latent sites for a batch of windows; to be run under a Pyro handler."""
        raise TypeError(f"{type(self).__name__} must define forward(batch)")


class OneStepGuide(SwarmGuide):
    """A guide of a :class:`swarmssm.models.OneStepModel`, each frame for itself."""

    def encode(self, states: torch.Tensor, adjacency: torch.Tensor) -> dist.Normal:
        """Return q(z | x, A) of each frame.

        Parameters
        ----------
        states
            Scaled, ``(..., individual, state)``.
        adjacency
            ``(..., individual, individual)``.

        Returns
        -------
        Normal of batch shape ``(..., individual, latent)``.
        """
        raise TypeError(f"{type(self).__name__} must define encode(states, adjacency)")


class PathGuide(SwarmGuide):
    r"""A guide of a :class:`swarmssm.models.StateSpaceModel`:
    :math:`q(\theta)\, q(z_{1:T} \mid x_{1:T}, \theta)`.

    Where the model's edges are inferred, an
    :class:`~swarmssm.inference.guides.edges.EdgeGuide` draws them first, and all that follows is
    given windows that have edges. A subclass writes :meth:`path`.

    Parameters
    ----------
    model
        Its model.
    parameters
        Guide of the parameters with a prior, see
        :class:`swarmssm.inference.guides.GlobalGuide`.
    """

    window: ClassVar[int | None] = 50

    def __init__(self, model: StateSpaceModel, parameters: str = "multivariate") -> None:
        super().__init__()
        # In a list, or the model would be a part of the guide and saved and trained twice.
        self._model = [model]
        self.parameters_guide = GlobalGuide(model, parameters)
        self.has_edges = isinstance(model.edges, InferredEdges)
        if isinstance(model.edges, InferredEdges):
            self.edges_guide = EdgeGuide(model.edges)

    @classmethod
    def for_model(cls, model: SwarmModel, **options: Any) -> Self:
        """Return a guide that fits the model's latent states."""
        if not isinstance(model, StateSpaceModel):
            raise TypeError(f"a {cls.__name__} needs a StateSpaceModel")
        return cls(model, **options)

    @property
    def model(self) -> StateSpaceModel:
        """The model whose posterior this is."""
        return self._model[0]

    def with_edges(self, batch: SwarmBatch, *, sample: bool = True) -> SwarmBatch:
        """Return windows with inferred edges, as all other methods want them.

        Parameters
        ----------
        batch
            Windows; those of a model with other edges are left as they are.
        sample
            Whether edges are drawn, or have the probabilities of their types.
        """
        return self.edges_guide.draw(batch, sample=sample) if self.has_edges else batch

    def path(
        self, batch: SwarmBatch, values: Mapping[str, torch.Tensor]
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """Draw a path for each window, differentiably.

        Parameters
        ----------
        batch
            Windows. Only these are looked at: a posterior of the last frame of a window is one that
            uses the past alone.
        values
            Drawn parameters, by full name.

        Returns
        -------
        States ``(batch, time, individual, state)``, 0 where nobody is present, and their
        log-density ``(batch,)`` over the features that noise moves
        (``stochastic_features``; all of them in the frame where an individual
        enters).
        """
        raise TypeError(f"{type(self).__name__} must define path(batch, values)")

    def paths(
        self, batch: SwarmBatch, values: Sequence[Mapping[str, torch.Tensor]]
    ) -> torch.Tensor:
        """Draw a path of each window with each of some draws of the parameters.

        Parameters
        ----------
        batch
            As in :meth:`path`.
        values
            Drawn parameters, by full name, one draw after the other.

        Returns
        -------
        ``(draw, batch, time, individual, state)``.
        """
        return torch.stack([self.path(batch, drawn)[0] for drawn in values])

    def last_state(
        self, batch: SwarmBatch, values: Mapping[str, torch.Tensor], draws: int
    ) -> torch.Tensor:
        """Draw the state of the last frame of each window, which it ends with.

        Parameters
        ----------
        batch, values
            As in :meth:`path`.
        draws
            How many; 0 for the mean.

        Returns
        -------
        ``(draw, batch, individual, state)``; ``(batch, individual, state)`` of the mean.
        """
        if not draws:
            return self.mean_path(batch, values)[:, -1]
        many = batch.select(torch.arange(len(batch), device=batch.mask.device).repeat(draws))
        states, _ = self.path(many, values)
        return torch.unflatten(states[:, -1], 0, (draws, len(batch)))

    def last_states(
        self, batch: SwarmBatch, values: Sequence[Mapping[str, torch.Tensor]]
    ) -> torch.Tensor:
        """Draw the last state of each window once with each of some draws of the parameters.

        Parameters
        ----------
        batch, values
            As in :meth:`paths`.

        Returns
        -------
        ``(draw, batch, individual, state)``.
        """
        return torch.stack([self.last_state(batch, drawn, 1)[0] for drawn in values])

    def mean_path(self, batch: SwarmBatch, values: Mapping[str, torch.Tensor]) -> torch.Tensor:
        """Return the mean of the path of each window, ``(batch, time, individual, state)``.

        Here that of :data:`MEAN_DRAWS` draws; a subclass that knows it says it at once.

        Parameters
        ----------
        batch, values
            As in :meth:`path`.
        """
        many = batch.select(torch.arange(len(batch), device=batch.mask.device).repeat(MEAN_DRAWS))
        states, _ = self.path(many, values)
        return torch.unflatten(states, 0, (MEAN_DRAWS, len(batch))).mean(0)

    def forward(self, batch: SwarmBatch) -> None:
        """Sample the parameters, the edges if they are inferred, and the paths."""
        values = self.parameters_guide()
        if self.model.emission.is_exact and not self.has_edges:
            return
        rows = torch.arange(len(batch), device=batch.mask.device)
        with (
            pyro.plate("windows", batch.population, subsample=rows, dim=-1),
            pyro.poutine.scale(scale=batch.window_weight),
        ):
            if self.has_edges:
                batch = self.edges_guide(batch)
            if self.model.emission.is_exact:
                return
            states, log_density = self.path(batch, values)
            pyro.sample("states", dist.Delta(states, log_density=log_density, event_dim=3))


class ParameterGuide(PathGuide):
    """The guide of a model whose states are observed exactly: there are only parameters to guess.

    Raises
    ------
    ValueError
        If the model has an emission, so that states are hidden.
    """

    window: ClassVar[int | None] = 50

    def __init__(self, model: StateSpaceModel, parameters: str = "multivariate") -> None:
        if not model.emission.is_exact:
            raise ValueError("the model's states are hidden: choose a guide that draws them")
        super().__init__(model, parameters)
