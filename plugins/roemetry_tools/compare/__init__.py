"""Compare variants of a recipe on the same data: which is better, by how much, and what it costs."""
