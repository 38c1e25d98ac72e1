"""Evaluation of policies on random trials."""
