"""Readers of tracks, one file each, and the writer of our own format."""
