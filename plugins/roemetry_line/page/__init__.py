"""The operator's page: what the line measures, what is wrong, and what may be done from it."""
