"""Search, objective, engine and ensemble: how a circuit learns."""
