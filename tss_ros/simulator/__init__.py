"""The simulator node: the motion of a formation, published."""
