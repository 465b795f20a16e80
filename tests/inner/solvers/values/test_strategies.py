"""The model of a choice between strategies is worth what the best strategy is worth."""

from fractions import Fraction as F

import pytest
from small_models import small_model

from exact_mdp import MDP, Family, ModelError, Policy, certify, choose_once, evaluate, thresholds
from exact_mdp.solvers.values.policy_chain import PolicyChain


def worth(mdp: MDP, policy: object) -> F:
    """The exact value of a policy at the start."""
    value = PolicyChain.of(mdp, policy).exact_value.to_fractions()
    return sum((share * value[state] for state, share in mdp.start), F(0))


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.parametrize("sense", ["max", "min"])
def test_the_best_of_the_listed(seed: int, sense: str) -> None:
    mdp = small_model(seed, F(9, 10), sense=sense)
    random = {}
    for state in range(mdp.n_states):
        own = [int(mdp.pair_action[pair]) for pair in mdp.pairs_of(state)]
        if len(own) > 1:
            random[state] = {action: F(1, len(own)) for action in own}
    first = {state: next(iter(row)) for state, row in random.items()}
    last = {state: [*row][-1] for state, row in random.items()}
    listed = {"first": first, "last": last, "mixed": random}
    chosen = choose_once(mdp, listed)
    values = {name: worth(mdp, policy) for name, policy in listed.items()}
    best = certify(chosen)
    assert best.start_value == (max if sense == "max" else min)(values.values())
    for number, name in enumerate(listed):
        assert worth(chosen, {"choose": number}) == values[name]
    assert chosen.n_states == 1 + 3 * mdp.n_states
    assert chosen.space.label(1).startswith("state first: ")


def test_two_strategies_change_places_at_the_closed_form() -> None:
    """A year of waiting costs x twice on average; treating costs 60: equal at 30."""

    def build(at):
        P = [[["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]]
        ill = MDP.from_arrays(P, [[-at["loss"], -60], [0, 0]], layout="ass")
        return choose_once(ill, {"wait": "always:0", "treat": "always:1"})

    model = Family(parameters={"loss": 20}, build=build)
    found = thresholds(model, "loss", ranges={"loss": (0, 99)}).frame()
    assert found["threshold"].tolist() == [30]
    assert found[["before", "after"]].to_numpy().tolist() == [["wait", "treat"]]


def test_what_cannot_be_chosen() -> None:
    mdp = small_model(1, labels={"there": {0}})
    for strategies in ({}, ["random"], None):
        with pytest.raises(ModelError, match="there is no strategy"):
            choose_once(mdp, strategies)
    with pytest.raises(ModelError, match="misses the goal"):
        choose_once(mdp.until("there"), {"a": "random"})


def test_a_policy_may_name_times() -> None:
    """(time, state) as a key, beside states alone, which mean every time."""
    P = [[[0, 1], [0, 1]], [[F(1, 2), F(1, 2)], [0, 1]]]
    names = {"states": ["ill", "dead"], "actions": ["a", "b"]}
    mdp = MDP.from_arrays(P, [[1, 3], [0, 0]], layout="ass", **names).within(2)
    two = {(0, "ill"): "b", (1, "ill"): "a"}
    assert evaluate(mdp, two).start_value == 3 + 0.5
    assert evaluate(mdp, {"ill": "b"}).start_value == 3 + 1.5
    assert Policy.of(mdp, two).space.names == ("time", "state")
    with pytest.raises(ModelError, match="is not a state"):
        evaluate(mdp, {(0, "ill"): "b", (7, "ill"): "a"})
