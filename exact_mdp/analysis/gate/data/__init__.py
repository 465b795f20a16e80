"""Intervals for the regret of a policy in the process behind the records that a model is from."""
