"""Exact values as bars.

Where states are only numbered, a solution and a certificate are bars.
"""

from exact_mdp import MDP, certify

wait = [["1/10", "9/10", 0], ["1/10", 0, "9/10"], ["1/10", 0, "9/10"]]
cut = [[1, 0, 0]] * 3
forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount="24/25")
certify(forest).plot()
