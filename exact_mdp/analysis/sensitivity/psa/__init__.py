"""Probabilistic sensitivity analysis: draws of the parameters, and the value of knowing them."""
