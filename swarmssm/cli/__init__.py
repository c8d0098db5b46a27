"""The ``swarmssm`` command: one file a group of subcommands."""

from swarmssm.cli.app import app, main

__all__ = ["app", "main"]
