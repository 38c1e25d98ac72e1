"""Poses of the base from pictures of printed AprilTags."""
