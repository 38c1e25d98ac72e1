"""The self-contained page of a drive, live or recorded."""
