"""Reproduction of Yuan et al. (2025): every number beside the exact one."""

from exact_mdp import names_of

__all__, __getattr__ = names_of(__name__)
