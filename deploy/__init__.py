"""The process that drives: estimator, circuit, command, recording."""
