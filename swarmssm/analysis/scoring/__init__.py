"""How good forecasts of held-out frames are, and those of simple baselines on the same frames."""

from swarmssm.analysis.posterior.frames import ScoredFrames, common_frames, frames_trained_on
from swarmssm.analysis.scoring.baseline import Baseline, Training
from swarmssm.analysis.scoring.comparison import Comparison, compare
from swarmssm.analysis.scoring.differences import paired_difference, score_intervals
from swarmssm.analysis.scoring.evaluation import Evaluation, evaluate
from swarmssm.analysis.scoring.references import REFERENCES, ConstantVelocity, StayPut
from swarmssm.analysis.scoring.rolling_origin import HORIZONS, score
from swarmssm.analysis.scoring.scores import SCORES, Score
from swarmssm.analysis.scoring.summaries import score_table, skill
from swarmssm.analysis.scoring.verdicts import summary, verdict

__all__ = [
    "HORIZONS",
    "REFERENCES",
    "SCORES",
    "Baseline",
    "Comparison",
    "ConstantVelocity",
    "Evaluation",
    "Score",
    "ScoredFrames",
    "StayPut",
    "Training",
    "common_frames",
    "compare",
    "evaluate",
    "frames_trained_on",
    "paired_difference",
    "score",
    "score_intervals",
    "score_table",
    "skill",
    "summary",
    "verdict",
]
