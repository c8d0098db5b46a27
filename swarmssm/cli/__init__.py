"""The ``swarmssm`` command: one file a group of subcommands."""

from swarmssm.cli.app import main

__all__ = ["main"]
