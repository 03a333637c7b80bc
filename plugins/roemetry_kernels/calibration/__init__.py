"""Rays, lenses and the normal equations of an adjustment."""
