"""A robot whose ROS 2 topics reach Zenoh, as a base."""
