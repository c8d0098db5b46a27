"""How good forecasts of held-out frames are, beside rivals on the same frames."""

from swarmssm.analysis.scoring.backtest import backtest
from swarmssm.analysis.scoring.differences import paired_difference, score_intervals
from swarmssm.analysis.scoring.frames import ScoredFrames, common_frames, frames_trained_on
from swarmssm.analysis.scoring.sentence import sentence
from swarmssm.analysis.scoring.tables import score_table, skill

__all__ = [
    "ScoredFrames",
    "backtest",
    "common_frames",
    "frames_trained_on",
    "paired_difference",
    "score_intervals",
    "score_table",
    "sentence",
    "skill",
]
