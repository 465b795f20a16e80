"""Care scenarios: what they are, how they move, and what is perceived of them.

A scenario is one TOML file, whose keys `template.toml` explains; in `mdp/scenarios` its name will
do. Every number of its tables is a parameter, such as `base.STATUS`.

>>> from exact_mdp import Scenario
>>> scenario = Scenario.load("tea").with_(parameters={"base.anxiety": "1/5"}, tasks=[1])
>>> scenario.compile()
MDP(tea: 33 states, 4 actions, 81 pairs, 501 transitions, discount 99/100)
"""
