"""Benchmarks behind ``rover-ncp bench``."""
