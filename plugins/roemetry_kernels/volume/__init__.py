"""Slices, surfaces and outlines, and what lies beyond the outer slices."""
