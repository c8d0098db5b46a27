"""Gaussian and particle filters of a swarm's joint state, at given parameters."""

from swarmssm.inference.filtering.affine import AffineMap, AffineSwarm, Linearizer, Taylor
from swarmssm.inference.filtering.evidence import (
    Points,
    collapsed_evidence,
    linearization_points,
)
from swarmssm.inference.filtering.importance import WeightedPaths, weigh_paths
from swarmssm.inference.filtering.iterated import Iterated, iterated_smoother
from swarmssm.inference.filtering.kalman import (
    Filtered,
    Smoothed,
    extended_kalman,
    filter_with,
    kalman,
    smooth,
)
from swarmssm.inference.filtering.particles import ParticleCloud, bootstrap_particle_filter
from swarmssm.inference.filtering.paths import draw_paths, path_log_density
from swarmssm.inference.filtering.sigma_points import SigmaPoints, unscented_kalman

__all__ = [
    "AffineMap",
    "AffineSwarm",
    "Filtered",
    "Iterated",
    "Linearizer",
    "ParticleCloud",
    "Points",
    "SigmaPoints",
    "Smoothed",
    "Taylor",
    "WeightedPaths",
    "bootstrap_particle_filter",
    "collapsed_evidence",
    "draw_paths",
    "extended_kalman",
    "filter_with",
    "iterated_smoother",
    "kalman",
    "linearization_points",
    "path_log_density",
    "smooth",
    "unscented_kalman",
    "weigh_paths",
]
