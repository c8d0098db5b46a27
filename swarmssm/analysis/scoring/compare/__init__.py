"""Which of several fits is best, by how much, and how surely."""

from swarmssm.analysis.scoring.compare.comparison import METHODS, compare
from swarmssm.analysis.scoring.compare.words import comparison_dict, comparison_table, sentence

__all__ = ["METHODS", "compare", "comparison_dict", "comparison_table", "sentence"]
