"""The safety gate: one pure function between every command and the base."""
