"""Which of three strategies is cost-effective, by the willingness to pay."""

from exact_mdp import MDP, Family, cost_effectiveness


def build(at):
    """Return a model of one choice, whose gain is uncertain."""
    parts = {"qaly": [0, at["gain"], 2 * at["gain"], 0], "cost": [0, 5_000, 20_000, 0]}
    rows = [(0, action, [(1, 1, 0)]) for action in range(3)]
    return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 0)])], components=parts)


model = Family(parameters={"gain": "1/2"}, build=build)
strategies = {"wait": [0, 0], "tablets": [1, 0], "surgery": [2, 0]}
uncertain = {"gain": {"distribution": "gamma", "sd": 0.2}}
cost_effectiveness(model, strategies, 2000, uncertain=uncertain, rng=0).plot()
