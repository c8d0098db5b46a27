"""What a baseline may use while it learns, besides the states."""

import time
from dataclasses import dataclass, field

from swarmssm.graphs import GraphRule
from swarmssm.tracks import Array

__all__ = ["Training"]


@dataclass(frozen=True)
class Training:
    """The terms on which all baselines learn, so that none has more than another.

    Attributes
    ----------
    validation
        States ``(trial, time, individual, state)`` that tell when to stop, in the tracks' units;
        ``None``: there are none.
    graph
        Who sees whom, for methods that do not find it out themselves; ``None``: everybody sees
        everybody.
    seconds
        Processor time after which learning ends with the best so far; ``None``: the method's own
        number of epochs.
    seed
        Of weights, batches and draws.
    """

    validation: Array | None = None
    graph: GraphRule | None = None
    seconds: float | None = None
    seed: int = 0
    began: float = field(default_factory=time.process_time)

    @property
    def spent(self) -> float:
        """Processor seconds since the beginning."""
        return time.process_time() - self.began

    @property
    def over(self) -> bool:
        """Whether the time is up."""
        return self.seconds is not None and self.spent >= self.seconds

    @property
    def progress(self) -> float:
        """Share of the time that is gone, from 0 to 1; 0 where there is no limit."""
        return 0.0 if self.seconds is None else min(1.0, self.spent / self.seconds)
