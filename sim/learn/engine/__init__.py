"""The engine of a training: a policy, a network or a law drives rovers or environments."""
