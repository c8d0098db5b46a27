"""A function of parameters and tensors, for many draws of both at once."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from swarmssm.errors import WorkError

__all__ = ["OverDraws", "in_pieces"]

#: Numbers that the tensors of draws which are taken together have at most.
CHUNK = 1_000_000
#: The same for a network, which turns each entry into hundreds.
NETWORK_CHUNK = 200_000


class OverDraws:
    """Calls a function for each draw of parameters, all draws together where that can be.

    Parameters
    ----------
    function
        Of the parameters of one draw, by full name, and of tensors; it returns a tensor or a tuple
        of tensors.
    parameters
        Those of each draw, the same names and shapes in all.
    """

    def __init__(
        self, function: Callable[..., Any], parameters: Sequence[Mapping[str, Tensor]]
    ) -> None:
        self.function, self.parameters = function, parameters
        self.stacked = {
            name: torch.stack([values[name] for values in parameters]) for name in parameters[0]
        }
        self.together = bool(self.stacked)

    def __call__(self, *tensors: Tensor) -> Any:
        """Return what the function returns, with a dimension of draws in front as the tensors."""
        if self.together:
            size = _at_once(tensors, CHUNK)
            together = torch.vmap(self.function, randomness="different", chunk_size=size)
            try:
                return together(self.stacked, *tensors)
            except WorkError:
                raise
            except RuntimeError:
                # Something whose course depends on numbers, which vmap cannot follow.
                self.together = False
        parts = [
            self.function(values, *(tensor[draw] for tensor in tensors))
            for draw, values in enumerate(self.parameters)
        ]
        if isinstance(parts[0], Tensor):
            return torch.stack(parts)
        return tuple(torch.stack(part) for part in zip(*parts, strict=True))


def in_pieces(function: Callable[..., tuple[Tensor, ...]], tensors: Sequence[Tensor]) -> Any:
    """Return what a function returns of tensors that are too large for it to take whole.

    Parameters
    ----------
    function
        Of tensors with a dimension of draws in front; it returns tensors with such a dimension.
    tensors
        Its arguments.
    """
    size = _at_once(tensors, NETWORK_CHUNK)
    pieces = zip(*(torch.split(tensor, size) for tensor in tensors), strict=True)
    parts = [function(*piece) for piece in pieces]
    return tuple(torch.cat(part) for part in zip(*parts, strict=True))


def _at_once(tensors: Sequence[Tensor], most: int) -> int:
    """Return how many draws are taken together."""
    return max(1, most // max(1, *(tensor[0].numel() for tensor in tensors)))
