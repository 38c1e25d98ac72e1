"""The native library in C++, and the one module that calls it."""
