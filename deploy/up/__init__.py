"""Starts what docks a robot, bridge, localiser and page, and ends it."""
