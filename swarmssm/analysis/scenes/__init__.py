"""Tracks as they are drawn frame by frame: observed, and beside them what a model makes of it."""

from swarmssm.analysis.scenes.free_run import free_run, with_free_run
from swarmssm.analysis.scenes.scene import Scene, scenes_of

__all__ = ["Scene", "free_run", "scenes_of", "with_free_run"]
