"""The graph of a small model.

Forest management: wait until the wood is old, or cut it; a fire sends it back to the start.
"""

from exact_mdp import MDP, plots

wait = [["1/10", "9/10", 0], ["1/10", 0, "9/10"], ["1/10", 0, "9/10"]]
cut = [[1, 0, 0]] * 3
forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount="24/25")
plots.plot_transitions(forest, "optimal")
