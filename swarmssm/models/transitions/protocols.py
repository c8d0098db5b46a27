"""What analyses ask of a transition beside the distribution of the next states.

A transition that offers what a protocol lists is understood, whatever it derives from: that with
:class:`NamedForces` has its forces told apart, that with :class:`PairKernels` has them drawn over
the distance.
"""

from collections.abc import Mapping
from typing import Literal, NamedTuple, Protocol, runtime_checkable

from torch import Tensor

from swarmssm.models.markov import StepInputs

__all__ = [
    "AngularModulation",
    "Box",
    "Form",
    "NamedFeatures",
    "NamedForces",
    "NamedParts",
    "PairKernel",
    "PairKernels",
    "PairWeights",
    "PerceptionRadius",
    "View",
    "Walls",
    "WeightedPairs",
]

#: What forces add up to: an acceleration, or the next velocity.
Form = Literal["acceleration", "velocity"]


class PairKernel(NamedTuple):
    """How a function of the distance to a neighbour becomes a force.

    Attributes
    ----------
    along
        ``"offset"``: it is multiplied by the unit vector to the neighbour, positive for towards;
        ``"velocity"``: by the neighbour's velocity minus one's own.
    over
        Whether the ``"mean"`` or the ``"sum"`` over the neighbours is the force.
    """

    along: Literal["offset", "velocity"] = "offset"
    over: Literal["mean", "sum"] = "mean"


class Box(NamedTuple):
    """Soft rectangular walls: half the sides and the middle, ``()`` or ``(space,)`` each."""

    half_width: Tensor
    center: Tensor


class View(NamedTuple):
    """How far an individual sees, ``()`` or ``(individual,)`` each; a sharp edge has no width."""

    radius: Tensor
    width: Tensor | None


class PairWeights(NamedTuple):
    """How often each pair counts; ``None``, once.

    Attributes
    ----------
    influence
        Of who is seen, ``(individual,)``, or of each pair, ``(individual, individual)``, the
        receiver first.
    responsiveness
        Of who sees, ``(individual,)``.
    """

    influence: Tensor | None
    responsiveness: Tensor | None


@runtime_checkable
class NamedForces(Protocol):
    """Next velocities by a sum of forces that have names."""

    @property
    def form(self) -> Form:
        """What the forces add up to."""

    @property
    def terms(self) -> tuple[str, ...]:
        """Names of the forces; none, if they are not told apart."""

    def forces(self, states: Tensor, inputs: StepInputs) -> Tensor:
        """Return the forces ``(..., term, individual, space)`` at ``(..., individual, state)``."""


@runtime_checkable
class PairKernels(Protocol):
    """Forces of neighbours that are functions of their distance."""

    @property
    def kernel_kinds(self) -> Mapping[str, PairKernel]:
        """Names of the kernels, and how each becomes a force."""

    def kernels(self, distance: Tensor) -> dict[str, Tensor]:
        """Return each kernel at distances ``(distance,)``: the same shape, or one for each
        individual, ``(individual, distance)``.
        """


@runtime_checkable
class NamedParts(Protocol):
    """An acceleration that a network makes of parts that have names."""

    @property
    def part_names(self) -> tuple[str, ...]:
        """Names of the parts."""

    def parts(self, states: Tensor, inputs: StepInputs) -> Tensor:
        """Return the parts ``(..., part, individual, space)``."""


@runtime_checkable
class NamedFeatures(Protocol):
    """Features that a network makes of what an individual sees."""

    @property
    def feature_names(self) -> tuple[str, ...]:
        """Names of the features."""

    def features(self, states: Tensor, inputs: StepInputs) -> Tensor:
        """Return the features ``(..., individual, feature)``."""


@runtime_checkable
class AngularModulation(Protocol):
    """Forces of neighbours that depend on the angle at which a neighbour is seen."""

    def angular(self, angle: Tensor) -> Tensor:
        """Return their factor by the angle to the heading, in rad."""


@runtime_checkable
class Walls(Protocol):
    """Soft walls, which may be absent."""

    def box(self) -> Box | None:
        """Return where the walls are."""


@runtime_checkable
class PerceptionRadius(Protocol):
    """A radius of perception, which may be absent."""

    def view(self) -> View | None:
        """Return radius and width of the edge of sight."""


@runtime_checkable
class WeightedPairs(Protocol):
    """Neighbours that count more or less."""

    def pair_weights(self) -> PairWeights:
        """Return how often each pair counts."""
