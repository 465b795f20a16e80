"""Reproduction of Yuan et al. (2025): every number beside the exact one."""

if __name__ == "paper_repro":
    from exact_mdp._checkout import alias

    alias(__name__)
