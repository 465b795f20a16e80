"""Any number of every state.

Here: by how much the value of a state falls if actions are drawn at random.
"""

from exact_mdp import MDP, evaluate, solve
from exact_mdp.analysis.plots import plot_states

lake = MDP.from_gymnasium("FrozenLake-v1", discount="99/100")
lost = solve(lake).value - evaluate(lake, "random").value
plot_states(lake, lost, shape=(4, 4))
