"""Care scenarios: what they are, how they move, and what is perceived of them.

How to add a scenario. It is one TOML file: give its path wherever a scenario's name is asked for,
or put it into `mdp/scenarios` and its name will do. `tea.toml` there is a short example. The file
has

    statuses, actions   their names; each status is present or absent
    tasks, max_trial    subtasks of each task, and the trials allowed in a subtask
    discount            from 0 to 1
    [readings]          how open points of the paper are read (`tables.READINGS`), if not by default
    [base]              STATUS = probability that it appears without assistance
    [persistence]       STATUS = probability that it stays without assistance
    [influence.ROW]     STATUS = what a present ROW adds to the probability of STATUS
    [assistance.ACTION.STATUS]   persistence and onset of STATUS under ACTION
    [skip.STATUS]       persistence when a subtask is skipped; or other, alone and with-other
    [reward]            a weight for each status, trial, subtask-complete, subtask-skip, timestep
                        and task-complete; [reward.assist] one for each action

Probabilities are exact: 0.1 is 1/10, and "2/3" may be written. An influence or an assistance that
is left out changes nothing; any other number that is missing, or a name that is not known, is an
error that says where. Every number of the tables is then a parameter: `base.STATUS`,
`reward.trial` and so on, for `--set`, `with_` and every sensitivity analysis.

>>> from exact_mdp import Scenario
>>> scenario = Scenario.load("tea").with_(parameters={"base.anxiety": "1/5"}, tasks=[1])
>>> scenario.compile()
MDP(tea: 33 states, 4 actions, 81 pairs, 501 transitions, discount 99/100)
"""
