"""Simulated bases, on the rover of sim.world: the firmware of a Pioneer, and a ROS 2 robot."""
