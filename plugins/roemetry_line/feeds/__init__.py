"""Feeds: where the frames of a line come from, a file each."""
