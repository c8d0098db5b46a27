"""Names of the ready-made guides."""

from typing import Any

from swarmssm.inference.guides.encoder import GraphEncoderGuide
from swarmssm.models.registry import find_part

__all__ = ["GUIDES", "find_guide"]

GUIDES: dict[str, Any] = {"encoder": GraphEncoderGuide}


def find_guide(name: str) -> Any:
    """Return the class that builds a guide, by name or ``module:attribute``."""
    return find_part(name, GUIDES, "guide")
