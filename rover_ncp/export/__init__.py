"""Policies for other programs: C for microcontrollers, JSON, and the wiring for the library ncps."""
