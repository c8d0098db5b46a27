"""``swarmssm calibrate``: how far a fit can be trusted, told by data whose truth is known."""

from swarmssm.cli.calibrating.command import calibrate

__all__ = ["calibrate"]
