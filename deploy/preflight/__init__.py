"""The pre-flight check of a robot on blocks."""
