"""A map of optimal values and actions.

FrozenLake on its grid of four by four: the value of each state, and the optimal action.
"""

from exact_mdp import MDP, solve

lake = MDP.from_gymnasium("FrozenLake-v1", discount="99/100")
solve(lake).plot(shape=(4, 4))
