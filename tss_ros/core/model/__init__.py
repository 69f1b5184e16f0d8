"""The system and its forces, sections 2 and 3 of the paper: what is simulated."""
