"""Recordings: MCAP files that survive a crash of their writer."""
