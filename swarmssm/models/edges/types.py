"""The type of each ordered pair, as one random variable that gradients flow through."""

from typing import Any, Literal

import torch
from pyro.distributions import TorchDistribution
from torch import Tensor
from torch.distributions import constraints

from swarmssm.models.relational import sample_edges

__all__ = ["EdgeTypes", "Gradient", "PosteriorEdgeTypes"]

#: How gradients flow through draws of types.
Gradient = Literal["conditional", "straight-through", "relaxed"]


class EdgeTypes(TorchDistribution):  # type: ignore[misc]
    r"""Independent categorical types of all ordered pairs, as one-hot vectors.

    .. math:: \log p(e) = \sum_{t, i \ne j} \sum_k e_{tij,k} \log p_{tij,k}

    Draws are made by the Gumbel trick, from :math:`y = \mathrm{softmax}((\log p + g) / \tau)`
    (Jang et al. 2017; Maddison et al. 2017). The one-hot vector of the greatest y is exactly a draw
    of the categorical distribution; its gradient is that of y (``"straight-through"``), or that of
    :math:`\log p` (``"conditional"``, for
    :meth:`swarmssm.models.InferredEdges.conditional_term`). A ``"relaxed"`` draw is y itself, of
    which the sum above is linear, as in NRI.

    Parameters
    ----------
    logits
        ``(..., frame, individual, neighbor, type)``; ``[..., i, j, :]`` is how j acts on i.
    pairs
        Which pairs there are, ``(..., frame, individual, neighbor)`` of bool. The others are of no
        type: their draws are 0, and they have no term.
    temperature
        :math:`\tau`.
    gradient
        See above. :meth:`sample` is never relaxed.
    normalized
        False: the logits are taken for the :math:`\log p` of the score as they stand. Their sum
        over types must be at most 1, so that the score is a lower bound of that of the
        distribution that is drawn from.

    Shapes
    ------
    Batch shape ``(...)``, event shape ``(frame, individual, neighbor, type)``.
    """

    has_rsample = True

    def __init__(
        self,
        logits: Tensor,
        pairs: Tensor,
        temperature: float = 0.5,
        *,
        gradient: Gradient = "conditional",
        normalized: bool = True,
        validate_args: bool | None = None,
    ) -> None:
        if logits.dim() < 4 or pairs.shape[-3:] != logits.shape[-4:-1]:
            raise ValueError(
                "logits and pairs must end in (frame, individual, neighbor, type) and (frame, "
                f"individual, neighbor), and they are {tuple(logits.shape)} and "
                f"{tuple(pairs.shape)}"
            )
        self.log_p = logits.log_softmax(-1)
        self.scores = self.log_p if normalized else logits
        self.pairs = pairs.expand(logits.shape[:-1])
        self.temperature, self.gradient, self.normalized = temperature, gradient, normalized
        super().__init__(logits.shape[:-4], logits.shape[-4:], validate_args=validate_args)

    @property
    def arg_constraints(self) -> dict[str, Any]:
        """Return no constraints: any logits will do."""
        return {}

    @constraints.dependent_property(is_discrete=False, event_dim=4)
    def support(self) -> constraints.Constraint:
        """Return all real numbers."""
        return constraints.independent(constraints.real, 4)  # type: ignore[no-untyped-call]

    def expand(self, batch_shape: Any, _instance: Any = None) -> "EdgeTypes":
        """Return the distribution with another batch shape."""
        shape = torch.Size(batch_shape) + self.event_shape
        return EdgeTypes(
            self.scores.expand(shape),
            self.pairs.expand(shape[:-1]),
            self.temperature,
            gradient=self.gradient,
            normalized=self.normalized,
            validate_args=False,
        )

    @property
    def mean(self) -> Tensor:
        """Probabilities of the types; 0 where there is no pair."""
        return self._among(self.log_p.exp())

    @property
    def mode(self) -> Tensor:
        """The most probable types, one-hot."""
        best = self.log_p.argmax(-1, keepdim=True)
        return self._among(torch.zeros_like(self.log_p).scatter_(-1, best, 1.0))

    def rsample(self, sample_shape: Any = torch.Size()) -> Tensor:  # noqa: B008
        """Draw types, differentiably."""
        logits = self.log_p.expand(torch.Size(sample_shape) + self.log_p.shape)
        if self.gradient == "conditional":
            with torch.no_grad():
                drawn = sample_edges(logits, hard=True)
            # What is added is exactly 0, so that the types stay exactly one-hot.
            return self._among(drawn + (logits - logits.detach()))
        hard = self.gradient == "straight-through"
        return self._among(sample_edges(logits, self.temperature, hard=hard))

    def sample(self, sample_shape: Any = torch.Size()) -> Tensor:  # noqa: B008
        """Draw one-hot types."""
        with torch.no_grad():
            logits = self.log_p.expand(torch.Size(sample_shape) + self.log_p.shape)
            return self._among(sample_edges(logits, self.temperature, hard=True))

    def log_prob(self, value: Tensor) -> Tensor:
        """Return the log-probability of types, ``(...)``."""
        # What reaches a conditional draw is not the derivative by the draw.
        value = value.detach() if self.gradient == "conditional" else value
        each = (value * self.scores).sum(-1)
        return torch.where(self.pairs, each, 0.0).sum((-1, -2, -3))

    def divergence(self, other: "EdgeTypes") -> Tensor:
        """Return the Kullback-Leibler divergence of another distribution from this, ``(...)``."""
        each = (self.log_p.exp() * (self.log_p - other.scores)).sum(-1)
        return torch.where(self.pairs, each, 0.0).sum((-1, -2, -3))

    def _among(self, values: Tensor) -> Tensor:
        """Return values, 0 where there is no pair."""
        return torch.where(self.pairs.unsqueeze(-1), values, 0.0)


class PosteriorEdgeTypes(EdgeTypes):
    r"""The types of a guide.

    Integrated, they score :math:`\log p(e) + \mathrm{KL}(q \| p)` in place of
    :math:`\log q(e)`: in an ELBO the prior's own score of the draw cancels, and the divergence of
    the whole distribution is left, of the same mean and without noise. That is no density, and
    importance weights need the other. Of conditional draws no gradient flows through the score.

    Parameters
    ----------
    posterior, prior
        Of the same pairs.
    integrated
        See above.
    """

    def __init__(self, posterior: EdgeTypes, prior: EdgeTypes, *, integrated: bool = True) -> None:
        super().__init__(
            posterior.scores,
            posterior.pairs,
            posterior.temperature,
            gradient=posterior.gradient,
            validate_args=False,
        )
        self.prior, self.integrated = prior, integrated

    def log_prob(self, value: Tensor) -> Tensor:
        """Return the score, see the class, ``(...)``."""
        law: EdgeTypes = self
        if self.gradient == "conditional":
            law = EdgeTypes(self.scores.detach(), self.pairs, gradient=self.gradient)
        if not self.integrated:
            return EdgeTypes.log_prob(law, value)
        return self.prior.log_prob(value) + law.divergence(self.prior)

    def expand(self, batch_shape: Any, _instance: Any = None) -> "PosteriorEdgeTypes":
        """Return the distribution with another batch shape."""
        shape = torch.Size(batch_shape)
        own, prior = super().expand(shape), self.prior.expand(shape)
        return PosteriorEdgeTypes(own, prior, integrated=self.integrated)
