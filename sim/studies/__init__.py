"""Park, evaluate and other experiments that join all parts."""
