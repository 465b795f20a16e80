"""Any number of every state.

Here: by how much the value of a state falls if actions are drawn at random.
"""

from exact_mdp import MDP, evaluate, plots, solve

lake = MDP.from_gymnasium("FrozenLake-v1", discount="99/100")
lost = solve(lake).value - evaluate(lake, "random").value
plots.plot_states(lake, lost, shape=(4, 4))
