r"""SINDy-PI: sparse identification of dynamics that are a ratio of two sums of terms."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import scipy

from swarmssm.analysis.scoring.baseline import Training
from swarmssm.baselines.library import monomials, sparse_coefficients
from swarmssm.baselines.regression import compress
from swarmssm.baselines.selection import learning_and_judging_parts
from swarmssm.baselines.sindy import ROWS_AT_ONCE, SindyBoids
from swarmssm.baselines.social_terms import accelerations
from swarmssm.errors import InputError
from swarmssm.metrics.masked import known
from swarmssm.tracks import Array

__all__ = ["Ratio", "SindyPI"]

THRESHOLDS = (0.1, 0.03, 0.01, 0.003, 0.001)
#: A model with fewer terms is preferred if its squared error is greater by no more than this share.
TOLERANCE = 0.01
#: At most so many steps judge the candidates.
MOST_JUDGED = 20_000
#: What multiplies the acceleration: 1, and the squares of speed, of the distance from the centre
#: and of that to the neighbours' mean.
DENOMINATORS = ("", "|v|^2", "|p|^2", "|C|^2")


@dataclass(frozen=True)
class Ratio:
    """One coordinate of the acceleration, as a ratio of sums of terms.

    Attributes
    ----------
    numerator
        Coefficients of the terms, ``(term,)``.
    denominator
        Coefficients of ``DENOMINATORS``; the one of 1 is 1 unless it is 0.
    """

    numerator: Array
    denominator: Array

    def __call__(self, terms: Array, squares: Array) -> Array:
        """Return the ratio, ``(...)``; not finite where the denominator vanishes."""
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            return np.asarray((terms @ self.numerator) / (squares @ self.denominator))

    @property
    def size(self) -> int:
        """Number of coefficients that are not 0, without that which sets the scale."""
        return int(np.count_nonzero(self.numerator) + np.count_nonzero(self.denominator)) - 1


@dataclass(frozen=True)
class Steps:
    """What one coordinate of the acceleration was in some steps, and what it is to follow from.

    Attributes
    ----------
    terms, squares
        Of numerator and denominator, ``(row, ...)``.
    truth
        Shape ``(row,)``.
    least, greatest
        What predictions are kept between.
    """

    terms: Array
    squares: Array
    truth: Array
    least: float
    greatest: float

    def error(self, ratio: Ratio) -> float:
        """Return the mean squared error of a law, infinite if it is not defined everywhere."""
        found = np.clip(ratio(self.terms, self.squares), self.least, self.greatest)
        error = float(((found - self.truth) ** 2).mean())
        return error if np.isfinite(error) else float("inf")


class SindyPI(SindyBoids):
    r"""Implicit SINDy: each coordinate of the acceleration is a ratio of sums of terms.

    .. math:: \Bigl(d_0 + d_1 |v_i|^2 + d_2 |p_i|^2 + d_3 |C_i|^2\Bigr)\, a_i = \sum_k \xi_k\,
        \theta_k(C_i, S_i, A_i, p_i, v_i)

    with the terms :math:`\theta` of :class:`~swarmssm.baselines.sindy.SindyBoids`. Every
    term of this equation in turn is taken for the left-hand side and regressed on all others by
    sequentially thresholded least squares - that is the "parallel" of Kaheman et al., which finds
    implicit laws although no term is known to be in them - and each that has the acceleration once
    more without it on the right. That equation is kept which, solved for the acceleration, predicts
    it best in the validation part, or is sparser than the best and as good within a percent; the
    authors too solve these regressions by thresholding and choose by the error on data that were
    not fitted. Beyond the original, the best law with each set of denominator terms is fitted anew
    to the accelerations before the last choice: where steps are noisy, an acceleration on the
    right-hand side carries its noise into the regressors, which biases the coefficients.

    The steps of all individuals in all trials enter one regression, and no difference is taken from
    one trial to another; pysindy's own SINDy-PI library takes one trajectory only (its issue 428).
    Accelerations are kept within those of the training part, which a vanishing denominator would
    leave. Where the training time does not suffice for all left-hand sides, those are tried first
    that have the acceleration in them.
    """

    name: ClassVar[str] = "sindy-pi"
    title: ClassVar[str] = "SINDy-PI"
    paper: ClassVar[str] = "Kaheman, Kutz and Brunton 2020, doi:10.1098/rspa.2020.0279"

    def __init__(self) -> None:
        super().__init__()
        self.ratios: list[Ratio] = []
        self.least = self.greatest = np.empty(0)

    @property
    def num_parameters(self) -> int:
        """Coefficients that are not 0."""
        return sum(ratio.size for ratio in self.ratios)

    def equations(self, digits: int = 4) -> list[str]:
        """Return what was found in words that people read: one equation a coordinate."""
        space = len(self._laws())
        coordinates, names = "xyz"[:space], self.variable_names(space)
        labels = [" ".join(names[index] for index in term) for term in self.candidates(space)]
        return [
            f"dv{coordinate}/dt = ({_sum(ratio.numerator, labels, digits)}) / "
            f"({_sum(ratio.denominator, DENOMINATORS, digits)})"
            for coordinate, ratio in zip(coordinates, self.ratios, strict=True)
        ]

    def learn(self, states: Array, fps: float, training: Training) -> None:
        """Try every left-hand side and threshold for each coordinate."""
        self.begin(states, training)
        early, late = learning_and_judging_parts(states, training)
        variables, targets = self._rows(early, fps)
        self.least, self.greatest = targets.min(axis=0), targets.max(axis=0)
        space = targets.shape[-1]
        triangle = compress(
            self._columns(
                variables[start : start + ROWS_AT_ONCE], targets[start : start + ROWS_AT_ONCE]
            )
            for start in range(0, len(variables), ROWS_AT_ONCE)
        )
        num_terms = triangle.shape[1] - space * len(DENOMINATORS)
        learned = self._some(variables, targets)
        judged = self._some(*self._rows(late, fps))
        self.ratios = []
        for axis in range(space):
            implicit = num_terms + axis + space * np.arange(len(DENOMINATORS))
            picked = triangle[:, [*range(num_terms), *implicit]]
            bounds = float(self.least[axis]), float(self.greatest[axis])
            parts = [Steps(*part[:2], part[2][:, axis], *bounds) for part in (learned, judged)]
            best: dict[tuple[bool, ...], tuple[float, Ratio]] = {}
            for ratio in _ratios(picked, num_terms):
                if best and training.progress >= (axis + 1) / space:
                    break
                error, kind = parts[1].error(ratio), tuple((ratio.denominator != 0.0).tolist())
                if kind not in best or error < best[kind][0]:
                    best[kind] = error, ratio
            laws = [law for _, ratio in best.values() for law in (ratio, _refined(ratio, parts[0]))]
            self.ratios.append(_sparsest_good(laws, parts[1]))

    def acceleration(self, states: Array) -> Array:
        """Return the ratios."""
        ratios = self._laws()
        flat = self.variables(states)
        flat = flat.reshape(-1, flat.shape[-1])
        found = np.empty((len(flat), len(ratios)))
        for start in range(0, len(flat), ROWS_AT_ONCE):
            part = slice(start, start + ROWS_AT_ONCE)
            terms, squares = self._terms_and_squares(flat[part], len(ratios))
            values = np.stack([ratio(terms, squares) for ratio in ratios], axis=-1)
            found[part] = np.clip(values, self.least, self.greatest)
        return found.reshape(*states.shape[:-1], len(ratios))

    def _laws(self) -> list[Ratio]:
        """Return the ratios."""
        if not self.ratios:
            raise InputError(f"{self.name}: fit it first; it has learned nothing yet.")
        return self.ratios

    def _rows(self, states: Array, fps: float) -> tuple[Array, Array]:
        """Return variables and accelerations of all steps of everybody, ``(row, ...)``."""
        targets = accelerations(states, fps)
        usable = known(targets)
        return self.variables(states[:, :-1])[usable], targets[usable]

    def _terms_and_squares(self, variables: Array, space: int) -> tuple[Array, Array]:
        """Return terms of the numerator, and what the denominator is made of, ``(row, ...)``."""
        # Cohesion comes first, and place and velocity after alignment.
        parts = (variables[:, first * space : (first + 1) * space] for first in (4, 3, 0))
        squares = [np.ones(len(variables)), *((part**2).sum(-1) for part in parts)]
        return monomials(variables, self.candidates(space)), np.stack(squares, axis=-1)

    def _columns(self, variables: Array, targets: Array) -> Array:
        """Return the terms, and each square times each coordinate of the acceleration."""
        terms, squares = self._terms_and_squares(variables, targets.shape[-1])
        implicit = (squares[:, :, None] * targets[:, None, :]).reshape(len(variables), -1)
        return np.concatenate([terms, implicit], axis=-1)

    def _some(self, variables: Array, targets: Array) -> tuple[Array, Array, Array]:
        """Return terms, squares and accelerations of not too many rows."""
        count = min(len(targets), MOST_JUDGED)
        picked = np.linspace(0, len(targets) - 1, count).round().astype(int)
        parts = self._terms_and_squares(variables[picked], targets.shape[-1])
        return *parts, targets[picked]


def _ratios(triangle: Array, num_terms: int) -> Iterator[Ratio]:
    """Yield the law that each left-hand side and threshold gives, where it has an acceleration.

    Those with the acceleration on the left come first: there may not be time for all.
    """
    columns = triangle.shape[1]
    for left in [*range(num_terms, columns), *range(num_terms)]:
        every = [column for column in range(columns) if column != left]
        explicit = [every[:num_terms]] if left >= num_terms else []
        for right in [every, *explicit]:
            chosen = triangle[:, [*right, left]]
            for threshold in THRESHOLDS:
                law = np.zeros(columns)
                law[left] = -1.0
                law[right] = sparse_coefficients(chosen, 1, threshold)[0]
                numerator, denominator = law[:num_terms], -law[num_terms:]
                # Any multiple says the same: the constant of the denominator is brought to 1.
                whole = denominator[0] or denominator[np.argmax(np.abs(denominator))]
                if whole != 0.0:
                    yield Ratio(numerator / whole, denominator / whole)


def _refined(ratio: Ratio, steps: Steps) -> Ratio:
    """Return the law with the same terms whose accelerations have the least squared error."""
    upper = np.flatnonzero(ratio.numerator)
    # The coefficient that is 1 sets the scale and stays.
    lower = np.flatnonzero((ratio.denominator != 0.0) & (ratio.denominator != 1.0))
    if not len(upper) or not np.isfinite(steps.error(ratio)):
        return ratio
    terms, squares = steps.terms[:, upper], steps.squares
    limits = 2.0 * steps.least - steps.greatest, 2.0 * steps.greatest - steps.least

    def law(values: Any) -> Ratio:
        numerator, denominator = np.zeros_like(ratio.numerator), ratio.denominator.copy()
        numerator[upper], denominator[lower] = values[: len(upper)], values[len(upper) :]
        return Ratio(numerator, denominator)

    def errors(values: Any) -> Array:
        return np.asarray(np.clip(law(values)(steps.terms, squares), *limits) - steps.truth)

    def slopes(values: Any) -> Array:
        now = law(values)
        ahead = now(steps.terms, squares)
        with np.errstate(all="ignore"):
            below = (squares @ now.denominator)[:, None]
            rising = -ahead[:, None] * squares[:, lower] / below
            found = np.concatenate([terms / below, rising], axis=1)
        # Beyond the limits nothing changes.
        inside = (ahead > limits[0]) & (ahead < limits[1])
        return np.asarray(np.where(inside[:, None], found, 0.0))

    begin = np.concatenate([ratio.numerator[upper], ratio.denominator[lower]])
    found = scipy.optimize.least_squares(errors, begin, slopes, x_scale="jac", max_nfev=30)
    return min((ratio, law(found.x)), key=steps.error)


def _sparsest_good(laws: list[Ratio], steps: Steps) -> Ratio:
    """Return the law with the fewest terms among those that are about as good as the best."""
    errors = [steps.error(law) for law in laws]
    # What differs from an exact fit by rounding alone is as good.
    enough = (1.0 + TOLERANCE) * min(errors) + 1e-20 * float((steps.truth**2).mean())
    good = [
        (law.size, error, k)
        for k, (law, error) in enumerate(zip(laws, errors, strict=True))
        if error <= enough
    ]
    return laws[min(good)[2]]


def _sum(values: Array, labels: tuple[str, ...] | list[str], digits: int) -> str:
    """Return a sum of terms in words."""
    parts = [
        f"{value:+.{digits}g} {label}".strip()
        for value, label in zip(values, labels, strict=True)
        if value != 0.0
    ]
    return " ".join(parts) or "0"
