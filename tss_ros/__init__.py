"""Tethered satellite systems: dynamics, Floquet stability, ROS 2 nodes."""
