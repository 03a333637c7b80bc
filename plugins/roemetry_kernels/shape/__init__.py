"""A product's curves along its stripes, curvature, hollows, and the forest that judges them."""
