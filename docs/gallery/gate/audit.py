"""What a learned policy gets wrong.

Wrong states are marked, with the optimal action beside the one taken.
"""

from exact_mdp import MDP, check

lake = MDP.from_gymnasium("FrozenLake-v1")
greedy = [1, 2, 1, 0, 1, 0, 1, 0, 2, 1, 1, 0, 0, 2, 2, 0]  # straight to the goal, as if no ice
check(lake, greedy).plot(shape=(4, 4))
