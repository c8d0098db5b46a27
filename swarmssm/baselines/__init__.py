"""Methods to compare a model with, beyond the two references of :mod:`swarmssm.analysis.scoring`.

Each is a file with a subclass of :class:`Baseline`, and an entry in
:data:`swarmssm.baselines.registry.BASELINES`.
"""

from swarmssm.analysis.scoring.baseline import Baseline, Training
from swarmssm.baselines.registry import BASELINES, baseline_named

__all__ = ["BASELINES", "Baseline", "Training", "baseline_named"]
