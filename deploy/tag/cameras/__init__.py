"""Pictures of cameras: of a device, a folder, an HTTP server or a ROS topic, and their calibration files."""
