"""``swarmssm sbc`` and ``swarmssm recovery``: how far a fit can be trusted, by simulated data."""

from swarmssm.cli.calibrating.commands import recovery, sbc

__all__ = ["recovery", "sbc"]
