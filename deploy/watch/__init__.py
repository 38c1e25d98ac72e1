"""The live page of a running drive."""
