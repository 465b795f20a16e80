"""Compiled loops: sampling, tabular learning, sweeps. The only numba here.

This package is imported when a loop is first needed; machine code is kept from run to run.
"""

from exact_mdp.solvers.kernels.learning import Tables, alias_tables, learn, rollouts

__all__ = ["Tables", "alias_tables", "learn", "rollouts"]
