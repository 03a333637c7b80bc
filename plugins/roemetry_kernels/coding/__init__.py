"""Which stripe each peak is of: traces, order, the labels of a whole frame, and the map made of them."""
