"""A place where a rover parks: its file, plans of the ways there, the stages of a docking."""
