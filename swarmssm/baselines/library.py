"""Candidate terms of a sparse regression, and the regression itself."""

import itertools
import warnings
from collections.abc import Sequence

import numpy as np
from pysindy.optimizers import STLSQ

from swarmssm.tracks import Array

__all__ = ["Term", "monomials", "polynomial_terms", "sparse_coefficients"]

#: A product of variables by their number, with repetition; the empty one is the constant 1.
Term = tuple[int, ...]

#: Ridge penalty inside the thresholding, for columns of unit length; the coefficients that stay are
#: then fitted anew without one.
RIDGE = 1e-16
MOST_ROUNDS = 50


def polynomial_terms(variables: Sequence[int], degree: int) -> list[Term]:
    """Return all products of at most so many of the variables, the constant first."""
    return [
        term
        for count in range(degree + 1)
        for term in itertools.combinations_with_replacement(variables, count)
    ]


def monomials(variables: Array, terms: Sequence[Term]) -> Array:
    """Return products of variables ``(..., variable)``, one a term: ``(..., term)``."""
    made: dict[Term, Array] = {(): np.ones(variables.shape[:-1])}

    def product(term: Term) -> Array:
        if term not in made:
            made[term] = product(term[:-1]) * variables[..., term[-1]]
        return made[term]

    if not terms:
        return np.empty((*variables.shape[:-1], 0))
    return np.stack([product(term) for term in terms], axis=-1)


def sparse_coefficients(triangle: Array, targets: int, threshold: float) -> Array:
    """Regress the last columns on the others, dropping small terms again and again.

    Sequentially thresholded least squares (Brunton et al. 2016) by pysindy's ``STLSQ``.

    Parameters
    ----------
    triangle
        Rows, or what :func:`~swarmssm.baselines.regression.compress` made of them,
        ``(row, term + target)``.
    targets
        Number of target columns.
    threshold
        A term goes if it contributes less than this share of the target's root mean square.

    Returns
    -------
    Shape ``(target, term)``.
    """
    inputs, outputs = triangle[:, :-targets], triangle[:, -targets:]
    lengths = np.linalg.norm(inputs, axis=0)
    # A column of zeros has nothing to contribute; infinite length makes its coefficient 0.
    lengths = np.where(lengths > 0.0, lengths, np.inf)
    heights = np.linalg.norm(outputs, axis=0)
    heights = np.where(heights > 0.0, heights, 1.0)
    # Terms may be nearly alike: a singular value decomposition does not square their likeness.
    optimizer = STLSQ(
        threshold=threshold, alpha=RIDGE, max_iter=MOST_ROUNDS, ridge_kw={"solver": "svd"}
    )
    with warnings.catch_warnings():
        # That a threshold leaves no term is a candidate like others.
        warnings.simplefilter("ignore")
        optimizer.fit(inputs / lengths, outputs / heights)
    found: Array = np.asarray(optimizer.coef_) / lengths * heights[:, None]
    return found
