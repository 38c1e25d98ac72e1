"""Robots: their descriptions, and the profiles that are measured of single robots."""
