"""The two ways in which work can go wrong, each with its exit status."""

from typing import ClassVar

__all__ = ["InputError", "SwarmssmError", "WorkError"]


class SwarmssmError(Exception):
    """What this package raises on purpose: one or two plain sentences for the user.

    The text names the file or argument, the place in it, and the mend.
    """

    exit_status: ClassVar[int] = 1


class InputError(SwarmssmError, ValueError):
    """The call or the input is wrong: the user can mend it. Exit status 2."""

    exit_status = 2


class WorkError(SwarmssmError, RuntimeError):
    """The call was right, but the work failed: a full disk, a loss that exploded. Exit status 1."""

    exit_status = 1
