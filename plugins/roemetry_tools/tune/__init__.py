"""Trying a recipe's options on one frame: a local page that answers at once."""
