"""Distributions that bodies move by."""
