"""Learn how the members of a group move each other, from their tracks alone."""

from importlib.metadata import version

__version__ = version("swarmssm")
