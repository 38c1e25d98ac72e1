"""The firmware of a Pioneer base on the rover of sim.world."""
