"""Transitions: how the swarm goes from one frame to the next."""

from swarmssm.models.transitions.base import KinematicTransition, Linearization, Transition
from swarmssm.models.transitions.boids import BoidsTransition
from swarmssm.models.transitions.force import ForceTransition
from swarmssm.models.transitions.graph import GraphTransition
from swarmssm.models.transitions.hierarchy import Hierarchical
from swarmssm.models.transitions.kernel import KernelTransition
from swarmssm.models.transitions.linear import LinearTransition
from swarmssm.models.transitions.linear_force import LinearForceTransition
from swarmssm.models.transitions.pair_force import PairForceTransition
from swarmssm.models.transitions.protocols import (
    AngularModulation,
    NamedFeatures,
    NamedForces,
    NamedParts,
    PairKernel,
    PairKernels,
    PerceptionRadius,
    Walls,
    WeightedPairs,
)
from swarmssm.models.transitions.radial_basis import PowerBasis, RadialBasis, SplineBasis
from swarmssm.models.transitions.soft_limits import SoftSpeedLimits
from swarmssm.models.transitions.typed_forces import (
    TypedKinematicTransition,
    TypedTransition,
    typed,
)

__all__ = [
    "AngularModulation",
    "BoidsTransition",
    "ForceTransition",
    "GraphTransition",
    "Hierarchical",
    "KernelTransition",
    "KinematicTransition",
    "LinearForceTransition",
    "LinearTransition",
    "Linearization",
    "NamedFeatures",
    "NamedForces",
    "NamedParts",
    "PairForceTransition",
    "PairKernel",
    "PairKernels",
    "PerceptionRadius",
    "PowerBasis",
    "RadialBasis",
    "SoftSpeedLimits",
    "SplineBasis",
    "Transition",
    "TypedKinematicTransition",
    "TypedTransition",
    "Walls",
    "WeightedPairs",
    "typed",
]
