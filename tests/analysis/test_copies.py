"""What was asked of a model before changes no copy of it: pickled or deep, it answers alike."""

import copy
import pickle
import re
from collections.abc import Callable
from contextlib import suppress
from functools import cached_property
from typing import Any

import matplotlib.pyplot as plt
import pytest

import exact_mdp
from exact_mdp import MDP, Policy, Scenario, moving

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


def by_name(mdp: MDP) -> dict[str, str]:
    """The first action of every state, by the names of both."""
    first = mdp.pair_action[mdp.pair_offsets[:-1]]
    return {mdp.space.label(state): mdp.actions[first[state]] for state in range(mdp.n_states)}


MODELS = {"line": line, "floats": floats, "scenario": scenario, "within": lambda: line().within(3)}
QUESTIONS: dict[str, Callable[[MDP], Any]] = {
    "names": lambda mdp: (mdp.action(mdp.actions[-1]), mdp.space.number(mdp.space.label(1))),
    "policy": lambda mdp: Policy.of(mdp, by_name(mdp)),
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
    "average": (
        ["line", "floats", "scenario"],
        lambda mdp: exact_mdp.solve(mdp, criterion="average"),
    ),
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
