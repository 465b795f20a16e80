"""Probabilistic sensitivity analysis: draws of the parameters, and what knowing them is worth."""
