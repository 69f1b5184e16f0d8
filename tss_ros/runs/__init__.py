"""Nodes started, recorded and ended together; the demo."""
