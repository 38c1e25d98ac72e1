"""The process beside the robot: ARCOS on one side, Zenoh on the other, the safety gate between."""
