"""Files, YAML with places, JSON values: nothing here knows what it holds."""
