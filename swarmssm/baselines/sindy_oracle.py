r"""SINDy that knows the true forms of the forces, and finds the gains only."""

from dataclasses import dataclass
from typing import ClassVar, Self

import numpy as np
import numpy.typing as npt
import torch
import xarray as xr

from swarmssm import forces
from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.library import Term
from swarmssm.baselines.sindy import SindyBoids, SparseAcceleration
from swarmssm.baselines.social_terms import social_terms
from swarmssm.errors import InputError
from swarmssm.graphs import GraphRule
from swarmssm.simulate import Boids, dynamics_of
from swarmssm.tracks import Array

__all__ = ["BoidsForms", "SindyOracle"]

#: How near to a limit a speed is at it: recordings are rounded to single precision.
AT_THE_LIMIT = 1e-5
UNKNOWN = (
    "sindy-oracle: it can only run where the true forms are known, that is on simulated boids in "
    "acceleration form with a radius graph"
)


@dataclass(frozen=True)
class BoidsForms:
    """What simulated boids obey, but for the gains.

    Attributes
    ----------
    radius
        How far an individual sees.
    wall
        Half the side of the box around the origin; ``None``: there is no wall.
    min_speed, max_speed
        Limits that speeds are brought between after each step.
    exponent
        *n* of the separation (3.17).
    """

    radius: float
    wall: float | None = None
    min_speed: float = 0.0
    max_speed: float = float("inf")
    exponent: float = 1.0

    @classmethod
    def of(cls, tracks: xr.Dataset) -> "BoidsForms":
        """Return the forms that simulated tracks say they follow.

        Raises
        ------
        InputError
            If the tracks were not simulated, or by another law.
        """
        if "simulation" not in tracks.attrs:
            raise InputError(f"{UNKNOWN}. These tracks do not say that they were simulated.")
        law = dynamics_of(tracks)
        if (
            not isinstance(law, Boids)
            or law.form != "acceleration"
            or law.graph.radius is None
            or law.graph.box is not None
            or law.relaxation_gain > 0.0
            or law.attention is not None
        ):
            raise InputError(f"{UNKNOWN}. These tracks follow another law.")
        wall = law.half_width if law.wall_gain > 0.0 else None
        return cls(law.graph.radius, wall, law.min_speed, law.max_speed, law.exponent)


class SindyOracle(SparseAcceleration):
    r"""SINDy that knows all that simulated boids obey, save the gains.

    .. math:: v_i(t + 1) = \operatorname{clamp}\bigl(v_i(t) + dt\, \Xi\, [C_i, S_i, A_i, W_i]\bigr)

    It knows the radius of sight, the exponent of the separation, the place of the wall *W* and
    the limits of speed. Steps that end at a limit say little of the forces, and are left out. It
    shows how far regression gets with the right library: no other method is given as much, and
    tables mark it as an oracle. All else is as for
    :class:`~swarmssm.baselines.sindy.SindyBoids`.

    Parameters
    ----------
    forms
        What it knows. Absent, :meth:`fit` asks the tracks, which know it if they were simulated.
    """

    name: ClassVar[str] = "sindy-oracle"
    title: ClassVar[str] = "SINDy, oracle of the true forms"
    paper: ClassVar[str] = SindyBoids.paper
    knows_true_form: ClassVar[bool] = True

    def __init__(self, forms: BoidsForms | None = None) -> None:
        super().__init__()
        self.forms = forms

    @classmethod
    def for_tracks(cls, tracks: xr.Dataset) -> Self:
        """Return the method with the forms that simulated tracks follow."""
        return cls(BoidsForms.of(tracks))

    def fit(
        self,
        tracks: xr.Dataset,
        *,
        validation: xr.Dataset | None = None,
        graph: GraphRule | str | None = None,
        seconds: float | None = None,
        seed: int = 0,
    ) -> Self:
        """Learn the gains, as :meth:`Baseline.fit` does.

        Raises
        ------
        InputError
            Also if no forms were given and the tracks do not know them.
        """
        if self.forms is None:
            self.forms = BoidsForms.of(tracks)
        return super().fit(tracks, validation=validation, graph=graph, seconds=seconds, seed=seed)

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Find the gains."""
        self._known_forms()
        super().learn(states, fps, training)

    def variables(self, states: Array) -> Array:
        """Return C, S, A and, if there is one, the push of the wall."""
        known_forms = self._known_forms()
        rule = GraphRule("radius", radius=known_forms.radius)
        terms = social_terms(states, rule, known_forms.exponent)
        if known_forms.wall is None:
            return terms
        position = torch.from_numpy(np.split(states, 2, axis=-1)[0].copy())
        return np.concatenate([terms, forces.wall(position, known_forms.wall).numpy()], axis=-1)

    def variable_names(self, space: int) -> list[str]:
        """Return ``Cx``, ``Cy``, ..., ``Wy``."""
        symbols = "CSA" if self._known_forms().wall is None else "CSAW"
        return [symbol + coordinate for symbol in symbols for coordinate in "xyz"[:space]]

    def candidates(self, space: int) -> list[Term]:
        """Return each variable by itself."""
        return [(index,) for index in range(self.num_variables(space))]

    def usable(self, states: Array, fps: float) -> npt.NDArray[np.bool_]:
        """Return the steps that do not end at a limit of speed."""
        known_forms = self._known_forms()
        space = states.shape[-1] // 2
        speed = np.linalg.norm(states[:, 1:, :, space:], axis=-1)
        between = speed > known_forms.min_speed * (1.0 + AT_THE_LIMIT)
        below = speed < known_forms.max_speed * (1.0 - AT_THE_LIMIT)
        return np.asarray(super().usable(states, fps) & between & below)

    def velocity_after(self, velocity: Array, acceleration: Array, fps: float) -> Array:
        """Return the velocity one step on, its length between the limits."""
        known_forms = self._known_forms()
        moved = velocity + acceleration / fps
        speed = np.linalg.norm(moved, axis=-1, keepdims=True)
        allowed = np.clip(speed, known_forms.min_speed, known_forms.max_speed)
        # Who would stand still goes on in the old direction.
        before = np.linalg.norm(velocity, axis=-1, keepdims=True)
        old = np.divide(velocity, before, out=np.zeros_like(velocity), where=before > 0.0)
        heading = np.divide(moved, speed, out=old, where=speed > 0.0)
        return np.asarray(np.where(allowed == speed, moved, allowed * heading))

    def _known_forms(self) -> BoidsForms:
        """Return what it knows."""
        if self.forms is None:
            raise InputError(f"{UNKNOWN}. Give it BoidsForms.")
        return self.forms
