"""Pages of interactive charts that sum up bags and sweeps. No ROS needed."""
