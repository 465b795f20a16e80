"""Proven error bounds of values in floating point: rounding, advantages, linear systems."""
