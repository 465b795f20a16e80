"""Care scenarios: their tables, rules and models, and acting on perceived statuses.

A scenario is a TOML file; `template.toml` explains its keys. A scenario in `mdp/scenarios` is
loaded by its name. Every number of its tables is a parameter, such as `base.STATUS`.

>>> from exact_mdp import Scenario
>>> scenario = Scenario.load("tea").with_(parameters={"base.anxiety": "1/5"}, tasks=[1])
>>> scenario.compile()
MDP(tea: 33 states, 4 actions, 81 pairs, 501 transitions, discount 99/100)
"""
