"""Driving by keyboard through the same lease and gate."""
