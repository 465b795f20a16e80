"""Reproduction of Yuan et al. (2025): every number beside the exact one."""
