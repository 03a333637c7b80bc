"""The search for stripes in image rows, their centres, and what noise does to them."""
