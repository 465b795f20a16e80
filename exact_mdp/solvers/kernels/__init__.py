"""Compiled loops: sampling, tabular learning, sweeps. The only numba here, loaded when needed."""
