"""Recordings shown in Rerun. No ROS needed."""
