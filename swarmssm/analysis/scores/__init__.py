"""How good forecasts of held-out frames are, beside rivals on the same frames."""

from swarmssm.analysis.scores.backtest import backtest
from swarmssm.analysis.scores.differences import paired_difference, score_intervals
from swarmssm.analysis.scores.frames import ScoredFrames, common_frames, frames_trained_on
from swarmssm.analysis.scores.sentence import sentence
from swarmssm.analysis.scores.tables import score_table, skill

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
