"""The messages that are recorded: their types, their topics, and their bytes; works without ROS."""
