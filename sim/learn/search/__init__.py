"""Search strategies as ask/tell: vectors out, returns in, random generator passed in; no I/O, no clock."""
