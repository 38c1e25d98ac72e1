"""Identification of a robot: excitation drive, fit, robot profile."""
