"""What is proven of values in floating point: rounding, gains, sweeps, bounds, linear systems."""
