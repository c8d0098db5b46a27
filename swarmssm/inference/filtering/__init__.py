"""Gaussian filters and smoothers of a swarm's states, at given parameters.

Which is for what:

* ``collapsed_evidence`` (:mod:`~swarmssm.inference.filtering.evidence`): the log evidence of
  windows and its gradient, to fit parameters with. Of a kinematic transition it is an integral over
  positions (:mod:`~swarmssm.inference.filtering.positions`, whose precision is a band,
  :mod:`~swarmssm.inference.filtering.banded`, with a hand-written derivative,
  :mod:`~swarmssm.inference.filtering.integral`); of others a Kalman filter with a hand-written
  adjoint (:mod:`~swarmssm.inference.filtering.adjoint`).
* ``extended_kalman``, ``kalman``, ``smooth`` (:mod:`~swarmssm.inference.filtering.kalman`):
  filtered and smoothed moments of all frames with the system that they come from, to draw paths
  from (``draw_paths``) and to score these (``path_log_density``). ``filtered_at`` keeps a few
  frames alone, from which forecasts go on.
* :mod:`~swarmssm.inference.filtering.layouts`: the states of a swarm in one vector, or, above 30
  individuals, each on its own (:mod:`~swarmssm.inference.filtering.blocks`).
"""

from swarmssm.inference.filtering.affine import AffineMap, AffineSwarm, Linearizer, Taylor
from swarmssm.inference.filtering.evidence import (
    Points,
    collapsed_evidence,
    linearization_points,
)
from swarmssm.inference.filtering.kalman_filter import (
    Filtered,
    Smoothed,
    extended_kalman,
    filter_with,
    kalman,
    smooth,
)
from swarmssm.inference.filtering.paths import draw_paths, path_log_density

__all__ = [
    "AffineMap",
    "AffineSwarm",
    "Filtered",
    "Linearizer",
    "Points",
    "Smoothed",
    "Taylor",
    "collapsed_evidence",
    "draw_paths",
    "extended_kalman",
    "filter_with",
    "kalman",
    "linearization_points",
    "path_log_density",
    "smooth",
]
