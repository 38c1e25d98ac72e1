"""ROS 2 messages and discovery, robot description."""
