"""What was asked of a model before changes no copy of it: pickled or deep, it answers alike."""

import copy
import pickle
import re
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from fractions import Fraction
from functools import cached_property
from multiprocessing import get_context
from typing import Any

import matplotlib.pyplot as plt
import pytest

import exact_mdp
from exact_mdp import (
    MDP,
    Family,
    Parameter,
    Policy,
    Scenario,
    certify,
    check,
    curve,
    gradient,
    moving,
)

COPIES: dict[str, Callable[[Any], Any]] = {
    "pickle": lambda thing: pickle.loads(pickle.dumps(thing)),
    "deepcopy": copy.deepcopy,
}


def line() -> MDP:
    """Exact numbers, objects as states, names as actions."""

    def outcomes(place: Any, action: str) -> list[tuple[str, Any, dict[str, int]]]:
        if action == "run":
            return [("1/2", "goal", {"effort": -2}), ("1/2", 0, {"effort": -2, "falls": -1})]
        after = place + 1 if place < 3 else "goal"
        return [("9/10", after, {"effort": -1}), ("1/10", place, {"effort": -1})]

    actions = {"goal": []}
    return MDP.from_function(
        0, lambda place: actions.get(place, ["walk", "run"]), outcomes,
        labels={"goal": lambda place: place == "goal"},
    )  # fmt: skip


def floats() -> MDP:
    """Floats, whose rounding a check forgives; costs, a discount."""
    rows = [[[0.3, 0.7], [0, 1]], [[0.9, 0.1], [0, 1]]]
    return MDP.from_arrays(
        rows, [[1.1, 0.3], [0, 0]], "9/10", layout="ass", sense="min",
        components={"effort": [[0.5, 0.1], [0, 0]]}, labels={"goal": [False, True]},
    )  # fmt: skip


def scenario() -> MDP:
    return Scenario.load("yuan2025").with_(max_trial=1, tasks=[1]).compile()


def built(at: Any) -> MDP:
    rows = [[[at["p"], 1 - at["p"]], [0, 1]], [[0, 1], [0, 1]]]
    return MDP.from_arrays(rows, [[1, 2], [0, 0]], "1/2", layout="ass")


def by_name(mdp: MDP) -> dict[str, str]:
    """The first action of every state, by the names of both."""
    first = mdp.pair_action[mdp.pair_offsets[:-1]]
    return {mdp.space.label(state): mdp.actions[first[state]] for state in range(mdp.n_states)}


MODELS = {"line": line, "floats": floats, "scenario": scenario, "within": lambda: line().within(3)}
QUESTIONS: dict[str, Callable[[MDP], Any]] = {
    "names": lambda mdp: (mdp.action(mdp.actions[-1]), mdp.space.number(mdp.space.label(1))),
    "policy": lambda mdp: Policy.of(mdp, by_name(mdp)),
    "compare": lambda mdp: exact_mdp.compare(mdp, {"first": by_name(mdp), "best": "optimal"}),
    "average": lambda mdp: exact_mdp.solve(mdp, criterion="average"),
    "simulate": lambda mdp: exact_mdp.simulate(mdp, by_name(mdp), 20, 1),
    "plot": lambda mdp: plt.close(exact_mdp.solve(mdp).plot().figure),
    "negated": lambda mdp: mdp.maximised,
    **{name: getattr(exact_mdp, name) for name in ("solve", "certify", "gradient", "tornado")},
    **{name: lambda mdp, name=name: getattr(exact_mdp, name)(mdp, by_name(mdp))
       for name in ("check", "evaluate", "rationalize")},
    **{name: lambda mdp, name=name: getattr(exact_mdp, name)(mdp, "discount")
       for name in ("one_way", "thresholds", "curve")},
}  # fmt: skip
# What not every model answers.
SOME: dict[str, tuple[list[str], Callable[[MDP], Any]]] = {
    "returns": (["line", "scenario"], lambda mdp: exact_mdp.return_distribution(mdp, "optimal")),
    "tradeoff": (["line", "floats"], lambda mdp: exact_mdp.tradeoff(mdp, mdp.component_names[:2])),
    "reaching": (["line", "floats", "within"], lambda mdp: mdp.reaching("goal")),
    "until": (["line", "floats", "within"], lambda mdp: mdp.until("goal")),
    "family": (["line", "floats"], lambda mdp: moving(mdp, {"chance": [(0, 0)]})),
}
TABLE = [(model, ask) for model in MODELS for ask in QUESTIONS.values()]
TABLE += [(model, ask) for models, ask in SOME.values() for model in models]


def shown(thing: Any) -> list[str]:
    """What a result shows: its text, its table and its view in a notebook."""
    views = (getattr(thing, name, None) for name in ("frame", "_repr_html_"))
    texts = [repr(thing), *(str(view()) for view in views if view is not None)]
    return [re.sub(r"\S+ s;", "", text) for text in texts]  # without the seconds that it took


def read_all(thing: Any) -> None:
    """Read every public property, so that what is remembered of it is."""
    for name in dir(type(thing)):
        if isinstance(getattr(type(thing), name), property | cached_property):
            with suppress(ValueError, RuntimeError):  # a question with no answer for this model
                getattr(thing, name)


@pytest.mark.parametrize(("model", "ask"), TABLE)
def test_whatever_was_asked_before(model: str, ask: Callable[[MDP], Any]) -> None:
    mdp = MODELS[model]()
    answer = ask(mdp)
    read_all(answer)
    read_all(mdp)
    for how in COPIES.values():
        again, copied = how((mdp, answer))
        assert shown(again) == shown(mdp)
        assert shown(copied) == shown(answer)
    assert shown(ask(again)) == shown(answer)


@pytest.mark.parametrize("how", COPIES.values(), ids=COPIES)
def test_policies_scenarios_families_and_curves(how: Callable[[Any], Any]) -> None:
    mdp, tables = scenario(), Scenario.load("yuan2025")
    policy = Policy.of(mdp, by_name(mdp))
    policy.weights(mdp)
    assert how(policy).tolist() == policy.tolist()
    assert not how(policy).rule.flags.writeable
    tables["base.anger"]
    assert how(tables) == tables
    chance = Parameter(name="p", value=Fraction(1, 3), low=Fraction(0), high=Fraction(1))
    own = Family(parameters=(chance,), build=built)
    for family in (own, moving(floats(), {"chance": [(0, 0)]}), tables.parametric()):
        first = shown(gradient(family))
        other = how(family)
        assert [p.name for p in other.parameters] == [p.name for p in family.parameters]
        assert shown(gradient(other)) == first
    exact = curve(own, "p")
    assert how(exact).violations() == exact.violations() == []
    assert [how(exact).at(at) for at in ("1/3", "1/2")] == [exact.at(at) for at in ("1/3", "1/2")]


def test_a_pool_of_processes_takes_a_model_that_was_asked() -> None:
    mdp = line()
    audit, proof = check(mdp, by_name(mdp)), certify(mdp)
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as pool:
        mean = pool.submit(exact_mdp.evaluate, mdp, by_name(mdp)).result().mean
        assert shown(pool.submit(check, mdp, by_name(mdp)).result()) == shown(audit)
        assert pool.submit(certify, mdp).result().start_value == proof.start_value
    assert mean == exact_mdp.evaluate(mdp, by_name(mdp)).mean
