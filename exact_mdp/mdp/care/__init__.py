"""Care scenarios: what they are, how they move, and what is perceived of them.

How to add a scenario. It is one TOML file: give its path wherever a scenario's name is asked for,
or put it into `mdp/scenarios` and its name will do. `tea.toml` there is a short example. The file
has the keys of `toml.KEYS`, which `template.toml` explains: `exact-mdp new FILE` copies it, and
`exact-mdp lint FILE` says what is wrong.

Probabilities are exact: 0.1 is 1/10, and "2/3" may be written. An influence or an assistance that
is left out changes nothing; any other number that is missing, or a name that is not known, is an
error that says where. Every number of the tables is then a parameter: `base.STATUS`,
`reward.trial` and so on, for `--set`, `with_` and every sensitivity analysis.

>>> from exact_mdp import Scenario
>>> scenario = Scenario.load("tea").with_(parameters={"base.anxiety": "1/5"}, tasks=[1])
>>> scenario.compile()
MDP(tea: 33 states, 4 actions, 81 pairs, 501 transitions, discount 99/100)
"""
