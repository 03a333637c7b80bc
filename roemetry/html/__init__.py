"""What the pages that the core writes have in common: their style, and drawing in SVG."""
