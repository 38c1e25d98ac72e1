"""The benchmarks' environments as lanes of a compiled kernel."""
