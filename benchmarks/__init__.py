"""This package's integrator, sweeps and nodes measured side by side with public tools."""
