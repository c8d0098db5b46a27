"""At which distances neighbours are, and how many."""

from dataclasses import dataclass

import numpy as np
import torch

from swarmssm.analysis.interpretation.forces.frames import frames_of, seen_graph
from swarmssm.analysis.posterior.accelerations import PosteriorPaths
from swarmssm.analysis.posterior.intervals import QUANTILES
from swarmssm.errors import InputError
from swarmssm.inference import Fit
from swarmssm.tracks import Array

__all__ = ["PairDistances", "pair_distances"]

#: Narrow bins in which distances are counted.
BINS = 4000


@dataclass(frozen=True)
class PairDistances:
    """Distances of neighbours in posterior paths, those that are seen by halves counting by halves.

    Attributes
    ----------
    edges
        ``(bin + 1,)``, from 0 to the longest distance.
    counts
        ``(bin,)``, over all draws.
    neighbors
        ``(draw,)``: mean number of neighbours.
    neighbors_spread
        ``(quantile,)``: quantiles of the number over draws, frames and individuals.
    """

    edges: Array
    counts: Array
    neighbors: Array
    neighbors_spread: Array

    def quantile(self, share: float) -> float:
        """Return the distance within which such a share of the neighbours is."""
        total = np.concatenate([[0.0], self.counts.cumsum()])
        return float(np.interp(share, total / total[-1], self.edges))

    def density(self, distances: Array) -> Array:
        """Return the density at given distances, each averaged halfway to the next ones."""
        between = 0.5 * (distances[:-1] + distances[1:])
        first = max(0.0, 2 * distances[0] - between[0])
        borders = np.concatenate([[first], between, [2 * distances[-1] - between[-1]]])
        total = np.concatenate([[0.0], self.counts.cumsum()]) / self.counts.sum()
        return np.asarray(np.diff(np.interp(borders, self.edges, total)) / np.diff(borders))


def pair_distances(fit: Fit, paths: PosteriorPaths) -> PairDistances:
    """Count the distances of neighbours in the model's own graph and view.

    Parameters
    ----------
    fit
        A fit.
    paths
        Draws of its paths.

    Raises
    ------
    InputError
        If nobody has a neighbour.
    """
    with torch.no_grad():
        longest = max(
            (
                float(_distances(frames.positions)[_pairs(frames.present)].amax().item())
                for draw in range(paths.draws)
                for frames in frames_of(paths, draw)
                if bool(_pairs(frames.present).any())
            ),
            default=0.0,
        )
        edges = np.linspace(0.0, longest or 1.0, BINS + 1)
        counts, means, numbers = np.zeros(BINS), [], []
        for draw in range(paths.draws):
            own = []
            for frames in frames_of(paths, draw):
                graph = seen_graph(fit, frames)
                there = graph > 0
                distance = _distances(frames.positions)[there].numpy()
                counts += np.histogram(distance, edges, weights=graph[there].numpy())[0]
                own.append(graph.sum(-1)[frames.present].numpy())
            numbers.append(np.concatenate(own))
            means.append(numbers[-1].mean() if numbers[-1].size else 0.0)
    if not counts.sum() > 0:
        raise InputError(
            "tracks: nobody has a neighbour, so there is nothing to see of interactions. Fit with "
            "another graph, for instance radius or k-nearest."
        )
    spread = np.quantile(np.concatenate(numbers), QUANTILES)
    return PairDistances(edges, counts, np.array(means), spread)


def _distances(positions: torch.Tensor) -> torch.Tensor:
    # Differences, not products: these would lose the digits of who is near.
    return torch.cdist(positions, positions, compute_mode="donot_use_mm_for_euclid_dist")


def _pairs(present: torch.Tensor) -> torch.Tensor:
    """Return which pairs are there, ``(frame, individual, individual)``, nobody with itself."""
    there = present.unsqueeze(-1) & present.unsqueeze(-2)
    return there & ~torch.eye(present.shape[-1], dtype=torch.bool)
