"""COACH, the handwashing assistant: its numbers with their sources, and its model of any size.

>>> from exact_mdp.mdp.coach.model import Coach
>>> Coach().compile()
MDP(coach: 180 states, 6 actions, 1080 pairs, 5400 transitions, discount 9/10)
"""
