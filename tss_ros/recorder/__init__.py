"""The logger node, its live view, and the player of recordings."""
