"""Fault injection: the safety matrix and the soak, on real processes."""
