"""Compiled kernels: the compiler and vector instructions."""
