"""Intervals for the regret of a policy in the process behind recorded data."""
