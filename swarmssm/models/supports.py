"""Which values a parameter may have, compared and put into words."""

import math
from typing import Any

import torch
from torch.distributions import constraints

__all__ = ["covers", "describe", "usual_constraint"]


def covers(required: Any, given: Any) -> bool:
    """Return whether all values that one constraint lets through satisfy another.

    An end of an interval counts as part of it: no density notices.

    Parameters
    ----------
    required, given
        Of ``torch.distributions.constraints``; dimensions of an event are looked through.
    """
    required, given = _inner(required), _inner(given)
    if given.is_discrete:
        return bool(required.is_discrete)
    wide = _bounds(required)
    if wide == (-math.inf, math.inf):
        return True
    narrow = _bounds(given)
    if wide is None or narrow is None:
        return type(required) is type(given)
    return wide[0] <= narrow[0] and narrow[1] <= wide[1]


def usual_constraint(support: Any) -> Any:
    """Return what the support of a prior says of its parameter: a sign, a structure, or nothing.

    A uniform prior from 0.5 to 2 says that its parameter is positive, but not that a better prior
    must keep to the same interval.
    """
    bounds = _bounds(_inner(support))
    if bounds is None:
        return support
    return constraints.positive if bounds[0] >= 0 else constraints.real


def describe(constraint: Any) -> str:
    """Return a constraint in words that follow ``must be``."""
    inner = _inner(constraint)
    if inner.is_discrete:
        return "whole numbers"
    bounds = _bounds(inner)
    if bounds is None:
        names = {
            "_LowerCholesky": "a lower triangular matrix with a positive diagonal",
            "_CorrCholesky": "the Cholesky factor of a correlation matrix",
            "_PositiveDefinite": "a positive definite matrix",
            "_Simplex": "fractions that sum to 1",
        }
        return names.get(type(inner).__name__, str(inner))
    low, high = bounds
    if math.isinf(low) and math.isinf(high):
        return "of either sign"
    if math.isinf(high):
        if low == 0:
            return "positive" if isinstance(inner, type(constraints.positive)) else "0 or more"
        return f"greater than {low:g}"
    if math.isinf(low):
        return f"less than {high:g}"
    return f"between {low:g} and {high:g}"


def _inner(constraint: Any) -> Any:
    """Return the constraint of one number, or of a structure that is none of numbers each."""
    while hasattr(constraint, "base_constraint"):
        constraint = constraint.base_constraint
    return constraint


def _bounds(constraint: Any) -> tuple[float, float] | None:
    """Return the interval of a constraint of one number; ``None`` for structures."""
    if constraint is constraints.real:
        return -math.inf, math.inf
    if not hasattr(constraint, "lower_bound") and not hasattr(constraint, "upper_bound"):
        return None
    low = torch.as_tensor(getattr(constraint, "lower_bound", -math.inf)).min()
    high = torch.as_tensor(getattr(constraint, "upper_bound", math.inf)).max()
    return float(low), float(high)
