"""Policies for other programs: C for microcontrollers."""
