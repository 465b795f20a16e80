"""Mean and worst tenth.

Two bets in a row, each safe, fair or bold: the best policies for the mean return, for the mean of
its worst tenth, and between the two. A policy may remember what was won.
"""

from exact_mdp import MDP, mean_cvar

bets = [[(1, 2)], [("9/10", 3), ("1/10", -2)], [("1/2", 9), ("1/2", -3)]]
pairs = [(s, a, [(p, s + 1, r) for p, r in bets[a]]) for s in (0, 1) for a in (0, 1, 2)]
model = MDP.from_outcomes([*pairs, (2, 0, [(1, 2, 0)])], discount=1)
mean_cvar(model, "1/10", policies={"random": "random"}).plot()
