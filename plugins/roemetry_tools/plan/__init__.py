"""Plan a rig before it is built: its plan as a page and as plain data."""
