"""The optimal value as an exact function.

A ratio of polynomials, piece by piece; the lines are the switching points, all of them proven.
"""

from exact_mdp import MDP, curve

wait = [["1/10", "9/10", 0], ["1/10", 0, "9/10"], ["1/10", 0, "9/10"]]
cut = [[1, 0, 0]] * 3
forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount="4/5")
curve(forest, "discount", ("0", "9/10")).plot()
