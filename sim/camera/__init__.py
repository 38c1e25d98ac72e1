"""A camera of a simulated rover: pictures of tags from the true pose."""
