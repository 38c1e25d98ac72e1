"""Evaluation of policies and control laws on random trials."""
