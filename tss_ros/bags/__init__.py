"""Recordings as MCAP bags: written, read, recovered, summed up. No ROS needed."""
