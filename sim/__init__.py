"""The simulator: world, training, the mock Pioneer and studies. It wraps the real code."""
