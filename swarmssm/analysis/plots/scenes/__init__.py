"""Tracks as they are drawn frame by frame: observed, and beside them what a model makes of it."""

from swarmssm.analysis.plots.scenes.free_runs import free_run, with_free_run
from swarmssm.analysis.plots.scenes.scene import Scene, scenes_of

__all__ = ["Scene", "free_run", "scenes_of", "with_free_run"]
