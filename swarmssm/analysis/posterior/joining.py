"""Several words in one sentence."""

from collections.abc import Sequence

__all__ = ["joined"]


def joined(words: Sequence[str]) -> str:
    """Return words as they stand in a sentence: ``a, b and c``."""
    return " and ".join([", ".join(words[:-1]), words[-1]] if len(words) > 1 else words)
