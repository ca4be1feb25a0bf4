"""Experiments: estimators on pairs, closed loops, trials in the simulated cell."""
