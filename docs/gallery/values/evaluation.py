"""Expected visits of a policy.

How often each state is expected to be visited when actions are drawn at random.
"""

from exact_mdp import MDP, evaluate

lake = MDP.from_gymnasium("FrozenLake-v1", discount=1)
evaluate(lake, "random").plot(visits=True, shape=(4, 4))
