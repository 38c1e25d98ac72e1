"""Fault injection: the safety matrix, on real processes."""
