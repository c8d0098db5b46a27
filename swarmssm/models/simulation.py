"""What a model makes up: parameters, paths and observations, as tensors."""

import contextlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import pyro
import torch
import xarray as xr

from swarmssm.errors import InputError
from swarmssm.graphs import EdgeList, Graph, dense
from swarmssm.models.batch import SwarmBatch
from swarmssm.models.markov import StepInputs
from swarmssm.tracks import make_tracks

__all__ = [
    "Simulation",
    "fitting",
    "generator",
    "seeded",
    "stack",
    "two_sizes",
    "without_last",
]


@dataclass(frozen=True)
class Simulation:
    """Swarms drawn from a model.

    Attributes
    ----------
    parameters
        Full name -> value of every parameter with a prior.
    states
        ``(batch, time, individual, state)``; 0 where nobody is present.
    observations
        ``(batch, time, individual, observation)``; 0 where nobody is present.
    present
        ``(batch, time, individual)`` of bool.
    adjacency
        ``(batch, time, individual, individual)`` of 0 and 1, or a list of edges: the graph that
        the states moved on; ``None`` where there was none.
    controls
        ``(batch, time, control)``, or ``None``.

    Those of several draws of the parameters (:meth:`swarmssm.models.StateSpaceModel.sample_prior`)
    have a leading dimension ``draw``, but for ``present`` and ``controls``, which are given.
    """

    parameters: dict[str, torch.Tensor]
    states: torch.Tensor
    observations: torch.Tensor
    present: torch.Tensor
    adjacency: Graph | None
    controls: torch.Tensor | None = None

    def draw(self, index: int) -> "Simulation":
        """Return one of several draws."""
        graph = self.adjacency
        if isinstance(graph, EdgeList):
            graph = graph[torch.tensor([index])].squeeze(0)
        elif graph is not None:
            graph = graph[index]
        return Simulation(
            {name: value[index] for name, value in self.parameters.items()},
            self.states[index],
            self.observations[index],
            self.present,
            graph,
            self.controls,
        )

    def to_tracks(self, dt: float, *, with_graph: bool = True) -> xr.Dataset:
        """Return the observations as tracks, one trial for each swarm.

        Parameters
        ----------
        dt
            Seconds from one frame to the next.
        with_graph
            Whether the tracks hold the graph, as adjacency.

        Raises
        ------
        InputError
            If observations are neither positions nor positions and velocities.
        """
        space = self.states.shape[-1] // 2
        seen = self.observations.masked_fill(~self.present.unsqueeze(-1), torch.nan).numpy()
        if seen.shape[-1] not in (space, 2 * space):
            raise InputError(
                f"model: it observes {seen.shape[-1]} features of each individual, which are "
                "neither positions nor positions and velocities: no tracks."
            )
        graph = self.adjacency if with_graph else None
        return make_tracks(
            seen[..., :space],
            velocity=seen[..., space:] if seen.shape[-1] > space else None,
            adjacency=None if graph is None else dense(graph).numpy(),
            fps=1.0 / dt,
            source_software="swarmssm",
        )

    def batch(self) -> SwarmBatch:
        """Return the observations as data for a model; everybody present was seen.

        Raises
        ------
        InputError
            If there are several draws: choose one first (:meth:`draw`).
        """
        if self.observations.dim() != 4:
            raise InputError("simulation: it holds several draws. Choose one, .draw(0).batch().")
        graph = self.adjacency
        if graph is None:
            count = self.present.shape[-1]
            graph = self.observations.new_zeros(*self.present.shape, count)
        weight = self.observations.new_ones(len(self.present))
        return SwarmBatch(
            self.observations,
            self.present,
            graph,
            weight,
            len(weight),
            self.present,
            self.controls,
        )


def stack(parts: Sequence[Simulation]) -> Simulation:
    """Put draws of the same swarm together, with a leading dimension."""
    first = parts[0]
    graph = first.adjacency
    graphs: list[Any] = [part.adjacency for part in parts]
    if isinstance(graph, EdgeList):
        graph = EdgeList(
            torch.cat([own.receiver + place * own.num_nodes for place, own in enumerate(graphs)]),
            torch.cat([own.sender + place * own.num_nodes for place, own in enumerate(graphs)]),
            (len(parts), *graph.leading),
            graph.individuals,
        )
    elif graph is not None:
        graph = torch.stack(graphs)
    return Simulation(
        {name: torch.stack([part.parameters[name] for part in parts]) for name in first.parameters},
        torch.stack([part.states for part in parts]),
        torch.stack([part.observations for part in parts]),
        first.present,
        graph,
        first.controls,
    )


def generator(seed: int | torch.Generator) -> torch.Generator:
    """Return a generator from a seed.

    Raises
    ------
    InputError
        If the seed is no whole number from 0 and no generator.
    """
    if isinstance(seed, torch.Generator):
        return seed
    if isinstance(seed, bool) or not isinstance(seed, int) or not 0 <= seed < 2**63:
        raise InputError(f"seed: it must be a whole number from 0 or a generator, not {seed!r}.")
    return torch.Generator().manual_seed(seed)


@contextlib.contextmanager
def seeded(seed: int | torch.Generator) -> Iterator[None]:
    """Let Pyro draw from a seed of its own, and leave nothing behind: no draws, no parameters.

    Parameters
    ----------
    seed
        See :func:`generator`; one that is given is moved on.
    """
    number = int(torch.randint(2**62, (), generator=generator(seed)))
    with (
        torch.random.fork_rng(),
        torch.no_grad(),
        # In Pyro's own store, models with parts of the same names would share their parameters.
        pyro.settings.context(module_local_params=True),
    ):
        torch.manual_seed(number)
        yield


def two_sizes(sizes: Any) -> tuple[int, int]:
    """Return a number of frames and one of individuals."""
    if not isinstance(sizes, tuple | list) or len(sizes) != 2:
        raise InputError(
            "sample_prior: like must be a batch of windows or (num_steps, num_individuals), not "
            f"{sizes!r}."
        )
    return sizes[0], sizes[1]


def without_last(inputs: StepInputs) -> StepInputs:
    """Return the inputs of the steps from those of the frames, ``(batch, time, ...)``."""
    graph = inputs.adjacency
    if isinstance(graph, EdgeList):
        graph = graph.select(1, 0, graph.leading[1] - 1)
    elif graph is not None:
        graph = graph[:, :-1]
    controls = None if inputs.controls is None else inputs.controls[:, :-1]
    return StepInputs(
        graph,
        controls,
        None if inputs.present is None else inputs.present[:, :-1],
        None if inputs.edge_types is None else inputs.edge_types[:, :-1],
    )


def fitting(name: str, value: Any, shape: tuple[int, ...]) -> torch.Tensor:
    """Return a tensor that may lack the dimension of the windows in full shape."""
    tensor: torch.Tensor = torch.as_tensor(value)
    given = tuple(tensor.shape)
    if given not in (shape, shape[1:], (1, *shape[1:])):
        raise InputError(f"{name}: its shape must be {shape}, and it is {given}.")
    return tensor.expand(shape)
