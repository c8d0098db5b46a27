r"""Sparse identification of nonlinear dynamics (SINDy) for individuals among others."""

from typing import ClassVar

import numpy as np
import numpy.typing as npt

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.library import (
    Term,
    monomials,
    polynomial_terms,
    sparse_coefficients,
)
from swarmssm.baselines.regression import compress
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

__all__ = ["SindyBoids", "SindyGeneric", "SparseAcceleration"]

#: Thresholds to choose from, the sparsest first: shares of the acceleration's root mean square.
THRESHOLDS = (0.3, 0.1, 0.03, 0.01, 0.003, 0.001, 0.0)
#: A sparser model is preferred if its rollouts are worse by no more than this share.
TOLERANCE = 0.005
ROWS_AT_ONCE = 2**14
COORDINATES = "xyz"


class SparseAcceleration(AccelerationBaseline):
    """The acceleration of an individual is a sparse combination of candidate terms.

    A subclass writes :meth:`variables`, :meth:`variable_names` and :meth:`candidates`.

    Attributes
    ----------
    terms
        The candidates that stayed, as products of variables.
    coefficients
        Shape ``(space, term)``, in the units of the tracks and seconds.
    degree
        Highest degree of the polynomials in the library.
    centre
        Mean place in the training part, from which positions are counted.
    low, high
        Least and greatest place and velocity in it. States are kept within them before they enter,
        as a polynomial means nothing beyond the data that it was fitted to.
    """

    name: ClassVar[str]
    title: ClassVar[str]
    degree: ClassVar[int] = 3

    def __init__(self) -> None:
        super().__init__()
        self.graph: GraphRule | None = None
        self.terms: list[Term] = []
        self.coefficients: Array | None = None
        self.centre = self.low = self.high = np.empty(0)

    def variables(self, states: Array) -> Array:
        """Return what terms are products of, ``(..., individual, variable)``."""
        raise TypeError(f"{type(self).__name__} must define variables(states)")

    def variable_names(self, space: int) -> list[str]:
        """Return what :meth:`equations` calls the variables."""
        raise TypeError(f"{type(self).__name__} must define variable_names(space)")

    def candidates(self, space: int) -> list[Term]:
        """Return all terms of the library."""
        raise TypeError(f"{type(self).__name__} must define candidates(space)")

    def usable(self, states: Array, fps: float) -> npt.NDArray[np.bool_]:
        """Return which steps to learn from, ``(trial, time - 1, individual)``."""
        return known(accelerations(states, fps))

    @property
    def num_parameters(self) -> int:
        """Coefficients that are not 0."""
        return 0 if self.coefficients is None else int(np.count_nonzero(self.coefficients))

    def equations(self, digits: int = 4) -> list[str]:
        """Return what was found in words that people read: one equation a coordinate."""
        coefficients = self._found()
        names = self.variable_names(len(coefficients))
        found = []
        for row, coordinate in zip(coefficients, COORDINATES, strict=False):
            parts = [
                f"{value:+.{digits}g}" + "".join(f" {names[index]}" for index in term)
                for value, term in zip(row, self.terms, strict=True)
                if value != 0.0
            ]
            found.append(f"dv{coordinate}/dt = " + (" ".join(parts) or "0"))
        return found

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Find coefficients for each threshold, and choose among them by rollouts."""
        self.begin(states, training)
        space = states.shape[-1] // 2
        early, late = learning_and_judging_parts(states, training)
        triangle = self._triangle(early, fps)
        chosen = best_of(
            (
                (threshold, self._with(sparse_coefficients(triangle, space, threshold)))
                for threshold in THRESHOLDS
            ),
            late,
            fps,
            tolerance=2.0 * np.log1p(TOLERANCE),
        )
        if early is not states:
            triangle = self._triangle(states, fps)
        self._with(sparse_coefficients(triangle, space, chosen))

    def begin(self, states: Array, training: Training) -> None:
        """Take over the graph, and see within what bounds the states are."""
        self.graph = training.graph
        rows = states[known(states)]
        self.low, self.high = rows.min(axis=0), rows.max(axis=0)
        self.centre = rows.mean(axis=0)[: states.shape[-1] // 2]

    def acceleration(self, states: Array) -> Array:
        """Return the combination of terms."""
        coefficients = self._found()
        shape = (*states.shape[:-1], len(coefficients))
        variables = self.variables(states).reshape(-1, self.num_variables(len(coefficients)))
        found = np.empty((len(variables), len(coefficients)))
        for start in range(0, len(variables), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            found[part] = monomials(variables[part], self.terms) @ coefficients.T
        return found.reshape(shape)

    def num_variables(self, space: int) -> int:
        """Return how many variables there are."""
        return len(self.variable_names(space))

    def own(self, states: Array) -> tuple[Array, Array]:
        """Return place, counted from the centre, and velocity, within what was learned from."""
        position, velocity = np.split(np.clip(states, self.low, self.high), 2, axis=-1)
        return position - self.centre, velocity

    def _found(self) -> Array:
        """Return the coefficients."""
        if self.coefficients is None:
            raise InputError(f"{self.name}: fit it first; it has learned nothing yet.")
        return self.coefficients

    def _with(self, coefficients: Array) -> "SparseAcceleration":
        """Return the baseline itself, set to coefficients of all candidates."""
        stays = (coefficients != 0.0).any(axis=0)
        candidates = self.candidates(len(coefficients))
        self.terms = [term for term, kept in zip(candidates, stays, strict=True) if kept]
        self.coefficients = coefficients[:, stays]
        return self

    def _triangle(self, states: Array, fps: float) -> Array:
        """Return the triangle of candidate terms and accelerations over all usable steps."""
        usable = self.usable(states, fps)
        if not usable.any():
            raise InputError(f"tracks: {self.name} finds no step in them to learn from.")
        variables = self.variables(states[:, :-1])[usable]
        targets = accelerations(states, fps)[usable]
        terms = self.candidates(targets.shape[-1])
        return compress(
            np.concatenate(
                [
                    monomials(variables[start : start + ROWS_AT_ONCE], terms),
                    targets[start : start + ROWS_AT_ONCE],
                ],
                axis=-1,
            )
            for start in range(0, len(variables), ROWS_AT_ONCE)
        )


class SindyBoids(SparseAcceleration):
    r"""SINDy with a library of boids terms and of polynomials of one's own state.

    .. math:: \frac{v_i(t + 1) - v_i(t)}{dt} = \Xi\,
        [C_i, S_i, A_i, 1, p_i, v_i, \ldots, \text{all products of three of } p_i, v_i,
        p_i^5, v_i / |v_i|, |v_i| v_i]

    with C, S and A as (3.16) to (3.18) of the thesis among the neighbours that the graph shows,
    exponent 1, and sparse coefficients :math:`\Xi` for each coordinate by sequentially
    thresholded least squares. The last three kinds of terms, in each coordinate, let a wall rise
    more steeply than a cube, and let speed be limited.

    Brunton et al. threshold the coefficients themselves at a level that the user sets (0.025 for
    their Lorenz system); here a term's contribution is held against the acceleration, so that units
    do not matter, and the level is chosen among ``THRESHOLDS`` by rollouts on the validation part.
    They differentiate noisy data by total variation; here the difference of velocities is taken,
    which makes it a rule for steps, as the tracks are.
    """

    name: ClassVar[str] = "sindy-boids"
    title: ClassVar[str] = "SINDy, boids terms and cubic"
    paper: ClassVar[str] = (
        "Brunton, Proctor and Kutz 2016, doi:10.1073/pnas.1517384113; "
        "pysindy, doi:10.21105/joss.03994"
    )

    def variables(self, states: Array) -> Array:
        """Return C, S, A, place, velocity, heading and speed."""
        place, velocity = self.own(states)
        speed = np.linalg.norm(velocity, axis=-1, keepdims=True)
        heading = np.divide(velocity, speed, out=np.zeros_like(velocity), where=speed != 0.0)
        social = social_terms(states, self.graph)
        return np.concatenate([social, place, velocity, heading, speed], axis=-1)

    def variable_names(self, space: int) -> list[str]:
        """Return ``Cx``, ``Cy``, ..., ``hy``, ``|v|``."""
        return [*_names(["C", "S", "A", "", "v", "h"], space), "|v|"]

    def candidates(self, space: int) -> list[Term]:
        """Return social terms by themselves, and products of what is one's own."""
        social, place, velocity, heading = (
            range(first * space, last * space) for first, last in ((0, 3), (3, 4), (4, 5), (5, 6))
        )
        return [
            *((index,) for index in (*social, *heading)),
            *polynomial_terms((*place, *velocity), self.degree),
            *((index,) * 5 for index in place),
            *((index, 6 * space) for index in velocity),
        ]


class SindyGeneric(SparseAcceleration):
    r"""SINDy with a library that knows nothing of boids: polynomials of means over the group.

    .. math:: \frac{v_i(t + 1) - v_i(t)}{dt} = \Xi\, [\text{all products of up to three of }
        p_i, v_i, \bar p - p_i, \bar v - v_i]

    with the means over all others who are there, whoever sees whom. All else is as for
    :class:`SindyBoids`.
    """

    name: ClassVar[str] = "sindy-generic"
    title: ClassVar[str] = "SINDy, group means, cubic"
    paper: ClassVar[str] = SindyBoids.paper

    def variables(self, states: Array) -> Array:
        """Return place and velocity, one's own and those of the group relative to them."""
        cohesion, _, alignment = np.split(social_terms(states, None), 3, axis=-1)
        return np.concatenate([*self.own(states), cohesion, alignment], axis=-1)

    def variable_names(self, space: int) -> list[str]:
        """Return ``x``, ``y``, ``vx``, ``vy``, ``Mx``, ..., ``Wy``."""
        return _names(["", "v", "M", "W"], space)

    def candidates(self, space: int) -> list[Term]:
        """Return all products of up to three variables."""
        return polynomial_terms(range(4 * space), self.degree)


def _names(symbols: list[str], space: int) -> list[str]:
    """Return the symbols with each coordinate."""
    return [symbol + coordinate for symbol in symbols for coordinate in COORDINATES[:space]]
