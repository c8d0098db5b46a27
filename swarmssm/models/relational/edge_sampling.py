"""Drawing types of edges so that gradients pass, and what it costs to differ from a prior."""

import torch
from torch import Tensor

from swarmssm.errors import InputError

__all__ = ["categorical_kl", "sample_edges", "sparse_logits"]


def sample_edges(
    logits: Tensor,
    temperature: float = 0.5,
    *,
    hard: bool = False,
    generator: torch.Generator | None = None,
) -> Tensor:
    r"""Draw a type for each edge, relaxed so that gradients reach the logits.

    .. math::
        z = \mathrm{softmax}\bigl((\ell + g) / \tau\bigr), \qquad g = -\log(-\log u),\
        u \sim U(0, 1),

    a draw from the concrete (Gumbel-softmax) distribution.

    Parameters
    ----------
    logits
        Shape ``(..., edge_type)``.
    temperature
        *tau*; towards 0 a draw comes to be one of the types.
    hard
        Return the type drawn, exactly 0 and 1, whose gradient is that of the relaxed draw
        (straight-through). Its distribution is exactly categorical at any temperature.
    generator
        Of the draws; the global one of torch if absent.

    Returns
    -------
    Same shape; sums to 1 along the last axis.

    Raises
    ------
    InputError
        If the temperature is not above 0.

    References
    ----------
    Jang, Gu and Poole (2017), Categorical reparameterization with Gumbel-softmax, ICLR; Maddison,
    Mnih and Teh (2017), The concrete distribution, ICLR.
    """
    if not temperature > 0.0:
        raise InputError(f"temperature: it must be above 0, and it is {temperature!r}.")
    uniform = torch.rand(
        logits.shape, dtype=logits.dtype, device=logits.device, generator=generator
    )
    # -log(1 - u) in place of -log(u): u may be 0, and is never 1.
    exponential = (-torch.log1p(-uniform)).clamp(min=torch.finfo(logits.dtype).tiny)
    soft = torch.softmax((logits - exponential.log()) / temperature, dim=-1)
    if not hard:
        return soft
    drawn = torch.zeros_like(soft).scatter_(-1, soft.argmax(-1, keepdim=True), 1.0)
    return drawn + (soft - soft.detach())


def categorical_kl(logits: Tensor, prior_logits: Tensor) -> Tensor:
    r"""Return the divergence of one categorical distribution from another.

    .. math::
        \mathrm{KL}(q \,\|\, p) = \sum_k q_k (\log q_k - \log p_k).

    Parameters
    ----------
    logits
        Of q, shape ``(..., edge_type)``.
    prior_logits
        Of p, any shape that broadcasts; logarithms of probabilities are logits.

    Returns
    -------
    Shape ``(...)``, in nats.
    """
    log_q = torch.log_softmax(logits, dim=-1)
    log_p = torch.log_softmax(prior_logits, dim=-1)
    return (log_q.exp() * (log_q - log_p)).sum(-1)


def sparse_logits(num_types: int, no_edge: float | None = None) -> Tensor:
    """Return the logits of a prior that gives type 0, no edge, its own probability.

    Parameters
    ----------
    num_types
        Number of types, at least 2.
    no_edge
        Probability of type 0, between 0 and 1; the others share the rest. ``None``: all types are
        equally likely.

    Returns
    -------
    Logarithms of probabilities, ``(edge_type,)``.

    Raises
    ------
    InputError
        If either is out of range.
    """
    if num_types < 2:
        raise InputError(f"edge_types: there must be at least 2, and there is {num_types}.")
    if no_edge is None:
        no_edge = 1.0 / num_types
    if not 0.0 < no_edge < 1.0:
        raise InputError(f"no_edge: it must be between 0 and 1, and it is {no_edge!r}.")
    share = (1.0 - no_edge) / (num_types - 1)
    return torch.tensor([no_edge, *[share] * (num_types - 1)]).log()
