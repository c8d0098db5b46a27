"""Which of several fits is best, by how much, and how surely."""

from swarmssm.analysis.compare.comparison import METHODS, compare
from swarmssm.analysis.compare.words import comparison_dict, comparison_table, sentence

__all__ = ["METHODS", "compare", "comparison_dict", "comparison_table", "sentence"]
