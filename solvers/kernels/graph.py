"""The search of `mdp.chain.join`, compiled: backward from some states, one pair after the other."""

from __future__ import annotations

from exact_mdp.mdp import chain
from exact_mdp.solvers.kernels.compiling import compiled

join = compiled(chain.join)
