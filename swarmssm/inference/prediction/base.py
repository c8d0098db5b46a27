"""What every fitted model can say of frames it has not seen."""

import contextlib
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ParamSpec, TypeVar

import torch

from swarmssm.inference.data import Prepared
from swarmssm.models.edges import EdgeState
from swarmssm.models.pyro_modules import own_parameters

__all__ = ["InitialCondition", "PredictiveMixture", "Predictor", "Trajectory", "owning", "seeded"]

P = ParamSpec("P")
R = TypeVar("R")


@dataclass(frozen=True)
class InitialCondition:
    """Frames from which a model goes on.

    Attributes
    ----------
    states
        Scaled, ``(..., origin, individual, state)``; what stands at absent individuals is ignored.
        A first dimension of draws is there where the states are drawn.
    adjacency
        ``(..., origin, individual, individual)``: the graph of the next step.
    present
        ``(..., origin, individual)`` of bool: who takes part; the others stay absent throughout.
    unscaled
        The states in the tracks' own units, NaN where absent.
    parameters
        For each draw the values of the parameters that have a posterior; ``None``: the middle of
        the posterior.
    edges
        What is known of edges whose types are inferred; ``None`` for other edges.
    """

    states: torch.Tensor
    adjacency: torch.Tensor
    present: torch.Tensor
    unscaled: torch.Tensor
    parameters: tuple[Mapping[str, torch.Tensor], ...] | None = None
    edges: EdgeState | None = None


@dataclass(frozen=True)
class Trajectory:
    """Forecast steps.

    Attributes
    ----------
    states
        ``(..., step, individual, state)``, scaled; NaN where nobody is.
    edge_probability
        ``(..., step, individual, individual)``: that the edge is there after the step.
    adjacency
        Same shape, of bool: the graph on which the step after it runs.
    edge_types
        Types of inferred edges on which the step itself ran, ``(..., step, individual, individual,
        type)``; ``None`` for other edges.
    """

    states: torch.Tensor
    edge_probability: torch.Tensor
    adjacency: torch.Tensor
    edge_types: torch.Tensor | None = None


@dataclass(frozen=True)
class PredictiveMixture:
    """Where sampled futures expect the next sighting, before its own noise is drawn.

    Attributes
    ----------
    location, variance
        ``(draw, origin, step, individual, space)``, scaled: mean and variance of the position seen
        after the step, given the sampled state before it.
    degrees
        Degrees of freedom, if the step is a Student's t; else infinite.
    """

    location: torch.Tensor
    variance: torch.Tensor
    degrees: float


class Predictor(ABC):
    """A fitted model and guide, on tensors. States are scaled as the model sees them."""

    @abstractmethod
    def posterior(
        self, prepared: Prepared, draws: int
    ) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor | None]:
        """Return mean and standard deviation of the latent states, and draws of them.

        Shapes ``(trial, time, individual, latent)`` and ``(draw, ...)``; NaN where the latent state
        is not defined. All frames are used for each, those after it too.
        """

    @abstractmethod
    def paths(
        self, prepared: Prepared, draws: int
    ) -> tuple[torch.Tensor, tuple[Mapping[str, torch.Tensor], ...]]:
        """Draw physical states of every frame, each path with the parameters it goes with.

        Parameters
        ----------
        prepared
            Tracks as the model sees them.
        draws
            How many, at least 1.

        Returns
        -------
        States ``(draw, trial, time, individual, state)``, scaled, NaN where they are not known;
        and for each draw the parameters that have a prior, by full name.
        """

    @abstractmethod
    def one_step(self, prepared: Prepared, *, sample: bool) -> tuple[torch.Tensor, torch.Tensor]:
        """Predict from each frame, and those before it, the frame after.

        Returns
        -------
        States ``(trial, time, individual, state)`` and edge probabilities, those of row t being of
        frame t + 1; NaN where nothing can be said. Drawn, or at the mean.
        """

    @abstractmethod
    def begin(
        self,
        prepared: Prepared,
        trials: torch.Tensor,
        rows: torch.Tensor,
        draws: int,
        *,
        carry: bool = False,
    ) -> InitialCondition:
        """Return where a model stands at given frames, knowing these and those before alone.

        Parameters
        ----------
        prepared
            Tracks as the model sees them.
        trials, rows
            ``(origin,)``.
        draws
            Number of draws, in front; 0 for the mean.
        carry
            Whether individuals take part that are not seen in the frame itself, but were at most
            :data:`swarmssm.inference.starting.MAX_CARRY` frames before.
        """

    @abstractmethod
    def begin_at(self, states: torch.Tensor, adjacency: torch.Tensor) -> InitialCondition:
        """Return a beginning at given states, all present.

        Parameters
        ----------
        states
            ``(origin, individual, state)`` in the tracks' own units.
        adjacency
            ``(origin, individual, individual)``.
        """

    @abstractmethod
    def run(self, beginning: InitialCondition, steps: int, *, sample: bool) -> Trajectory:
        """Go on freely.

        Parameters
        ----------
        beginning
            Where from.
        steps
            How many.
        sample
            Whether all that is random is drawn, or takes its mean.
        """

    def kernels(self, beginning: InitialCondition, steps: int) -> PredictiveMixture | None:
        """Draw futures, and return what each expects of its next sighting.

        ``None`` for a model that has no distribution of one step to tell.
        """
        return None


def owning(method: Callable[P, R]) -> Callable[P, R]:
    """Let a method of a predictor use the parameters of its own model and guide."""

    @functools.wraps(method)
    def run(*args: P.args, **kwargs: P.kwargs) -> R:
        predictor: Any = args[0]
        with own_parameters(predictor.model, predictor.guide):
            return method(*args, **kwargs)

    return run


@contextlib.contextmanager
def seeded(seed: int | torch.Generator) -> Iterator[None]:
    """Make torch's draws follow a seed or generator, and leave its global state as it was.

    A generator is advanced, so that two calls with the same one differ.
    """
    if isinstance(seed, torch.Generator):
        seed = int(torch.randint(2**62, (), generator=seed, device=seed.device))
    with torch.random.fork_rng():
        torch.manual_seed(seed)
        yield
