"""Classifiers on traced skeins: how they are fitted, how they are judged, and the pages of it."""
