"""ROS 2 robots over Zenoh: their names, messages and odometry, and the base that the bridge drives."""
