"""Writes the file of a robot: finds what can be found, and asks the rest."""
