"""Errors, geometry, configuration, courses, messages and recordings: what every process needs."""
