r"""Ridge regression on the terms that a boid would look at."""

from typing import ClassVar

import numpy as np

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.regression import AffineMap, ridge_maps
from swarmssm.baselines.selection import best_of, learning_and_judging_parts
from swarmssm.baselines.social_terms import (
    AccelerationBaseline,
    accelerations,
    social_terms,
)
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["RidgeBoids"]


class RidgeBoids(AccelerationBaseline):
    r"""The change of velocity is an affine function of boids terms, own velocity and place.

    .. math:: \frac{v_i(t + 1) - v_i(t)}{dt} = b + B\, [C_i, S_i, A_i, v_i, p_i, p_i^3] \qquad
        p_i(t + 1) = p_i(t) + dt\, v_i(t + 1)

    C, S and A are (3.16) to (3.18) of the thesis among the neighbours that the graph shows, with
    exponent 1, the cube is taken of each coordinate, and *p* is counted from the mean place of the
    training part: *p* and its cube stand for walls that have no known place. One *b* and *B* for
    everybody; ridge penalty as for
    :class:`~swarmssm.baselines.autoregression.AR5`. Places and velocities are
    kept within what the training part holds before they enter, so that the cube cannot carry a
    rollout off.
    """

    name: ClassVar[str] = "ridge-boids"
    title: ClassVar[str] = "ridge on boids terms"
    paper: ClassVar[str] = (
        "Hoerl and Kennard 1970, doi:10.1080/00401706.1970.10488634; terms after Reynolds 1987, "
        "doi:10.1145/37402.37406"
    )

    def __init__(self) -> None:
        super().__init__()
        self.graph: GraphRule | None = None
        self.force: AffineMap | None = None
        self.low = self.high = self.centre = np.empty(0)

    @property
    def num_parameters(self) -> int:
        """Coefficients and intercepts."""
        return 0 if self.force is None else self.force.size

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Fit the affine map, choosing the penalty by rollouts."""
        self.graph = training.graph
        rows = states[known(states)]
        self.low, self.high = rows.min(axis=0), rows.max(axis=0)
        self.centre = rows.mean(axis=0)[: states.shape[-1] // 2]
        early, late = learning_and_judging_parts(states, training)
        chosen = best_of(
            ((index, self._with(force)) for index, force in enumerate(self._maps(early, fps))),
            late,
            fps,
        )
        self.force = self._maps(states, fps)[chosen]

    def acceleration(self, states: Array) -> Array:
        """Return the affine function of the features."""
        if self.force is None:
            raise InputError(f"{self.name}: fit it first; it has learned nothing yet.")
        return self.force(self._features(states))

    def _with(self, force: AffineMap) -> "RidgeBoids":
        """Return the baseline itself, set to a candidate."""
        self.force = force
        return self

    def _maps(self, states: Array, fps: float) -> list[AffineMap]:
        """Return one affine map for each penalty."""
        targets = accelerations(states, fps)
        usable = known(targets)
        return ridge_maps(self._features(states[:, :-1])[usable], targets[usable])

    def _features(self, states: Array) -> Array:
        """Return what the regression is on, ``(..., individual, 6 * space)``."""
        position, velocity = np.split(np.clip(states, self.low, self.high), 2, axis=-1)
        position = position - self.centre
        parts = [social_terms(states, self.graph), velocity, position, position**3]
        return np.concatenate(parts, axis=-1)
