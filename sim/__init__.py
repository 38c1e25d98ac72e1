"""The simulator: world, training and the mock Pioneer. It wraps the real code."""
