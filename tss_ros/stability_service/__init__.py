"""The stability node, and the client that asks it."""
