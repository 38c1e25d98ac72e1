"""rover-ncp: a tiny, explainable neural circuit on a real rover. The shared package."""
