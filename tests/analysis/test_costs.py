"""Costs are rewards times -1: every analysis says the same of both, with the sign of values turned.

What is said of both is compared number by number: the JSON of a report, else the table of a result.
Numbers whose place is of WORTH and not of SAME turn, and the ends of a SPREAD change places.
"""

import json
import re
from collections.abc import Callable
from fractions import Fraction as F
from typing import Any

import numpy as np
import pandas as pd
import pytest

import exact_mdp as em

POLICY = [1, 0, 0, 0]
WORTH = re.compile(
    r"\b(value|\w+_value|\w*value_(low|high)|(\w+_)?upper_bound|exact|mean|cvar|CVaR|ordinary|weighted"
    r"|promised|components|totals|closest|vertices\.\d+\.values|(exact_)?derivatives|left|right"
    r"|numerator|gain|bias|exact gain|exact bias|return|quantiles)\b|\(reward\)"
    r"|\.interval(\.\d|$)"
)
SAME = re.compile(
    r"(error|error_bound|sd|probability|interval\.mean)$|error \(|expected_loss|evp|elasticit|price"
    r"|gain \(|worst_case_gain|regret|rows\.|drawn\.|[a-z]\.\d+\.interval"
)
SPREAD = {"interval", "quantiles", "optimal_value", "learned_value"}
DIFFERENT = {"seconds", "limits", "checks", "assumptions", "mdp"}


def model(sign: int, discount: object = "9/10") -> em.MDP:
    """Return the model whose rewards are 1 or -1 times the same numbers, to be made the most of."""
    table = [
        (0, 0, [("1/2", 1, 3), ("1/4", 2, 0), ("1/4", 3, 1)]),
        (0, 1, [("1/3", 2, 5), ("2/3", 3, -1)]),
        (1, 0, [("3/4", 2, 2), ("1/4", 3, 4)]),
        (1, 1, [("1/4", 0, 1), ("3/4", 3, 0)]),
        (2, 0, [("1/5", 0, -2), ("4/5", 3, 7)]),
        (2, 1, [(1, 3, 4)]),
        (3, 0, [(1, 3, 0)]),
    ]
    rows = [(s, a, [(p, t, sign * r) for p, t, r in each]) for s, a, each in table]
    anger = [F(2), F(1, 3), F(1), F(-1), F(1), F(0), F(0)]
    return em.MDP.from_outcomes(
        rows,
        discount,
        sense="max" if sign > 0 else "min",
        start={0: "2/3", 1: "1/3"},
        components={"anger": [sign * value for value in anger]},
        labels={"over": [False, False, False, True]},
    )


def family(sign: int) -> em.Family:
    return em.moving(model(sign), {"p": [(0, 1)], "q": [(4, 0)]})


def recorded(sign: int) -> em.MDP:
    return em.MDP.from_transitions(records(sign), discount="9/10", sense=model(sign).sense)


def records(sign: int) -> pd.DataFrame:
    rng = np.random.default_rng(0)
    rows, known = [], model(sign)
    for episode in range(60):
        state = 0
        for _ in range(50):
            if state == 3:
                break
            action = int(rng.integers(2))
            row = known.table.row(known.pair(state, action))
            chosen = int(rng.choice(len(row), p=[float(p) for p, _, _ in row]))
            _, after, reward = row[chosen]
            rows.append((episode, state, action, float(reward), after))
            state = after
    return pd.DataFrame(rows, columns=["episode", "state", "action", "reward", "next_state"])


def span(sign: int, low: int, high: int) -> tuple[int, int]:
    """Return a range of rewards, or that of the costs."""
    return (low, high) if sign > 0 else (-high, -low)


def limits(sign: int) -> dict[str, str]:
    """Return that anger, in the model's own sign, is at most a half or at least minus a half."""
    return {"anger": "<= 1/2"} if sign > 0 else {"anger": ">= -1/2"}


def endless(sign: int) -> em.MDP:
    rows = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 3)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 0, -1)])]
    return em.MDP.from_outcomes(
        [(s, a, [(p, t, sign * r) for p, t, r in each]) for s, a, each in rows],
        "9/10",
        sense="max" if sign > 0 else "min",
    )


def audited(audit: Any) -> Any:
    lost = audit.regret
    fields = vars(lost.losses) | {"at_start": lost.at_start, "forgiven": lost.forgiven}
    return audit, fields, {"value": [lost.optimal.value, lost.learned.value]}


def tails(sign: int) -> list[Any]:
    """The best mean of the worst quarter, that of all, its threshold, and a policy's own."""
    short = model(sign, 1).within(4)
    best, law = em.best_cvar(short, "1/4"), em.return_distribution(short, POLICY, exact=True)
    return [best.value, best.mean, best.threshold, law.tail_mean("1/4", highest=sign < 0)]


def with_interval(sign: int, by: Any) -> Any:
    return audited(em.check(recorded(sign), POLICY, confidence=0.9, by=by))


def pieces(sign: int) -> Any:
    value_curve = em.curve(family(sign), "p", ("1/100", "99/100"), policy=POLICY)
    at = ["1/100", "1/7", "1/2", "5/6"]
    values = [value_curve.at(x) for x in at] + [value_curve.fixed_at(x) for x in at]
    return value_curve, {"value": values}, value_curve.within("1/10")


def drawn(sign: int) -> Any:
    analysis = em.psa(family(sign), 60, rng=0, policy=POLICY)
    values = {"value": [analysis.table.optimal, analysis.table.fixed]}
    return (
        analysis,
        values,
        analysis.acceptability([0, 0.1]),
        analysis.table.lost,
        analysis.table.counts,
    )


def learned(sign: int) -> Any:
    run = em.QLearning(epochs=20, discount="9/10").train(model(sign), rng=3)
    return {"value": [run.q, run.returns]}, run.policies, em.outcomes(model(sign), [run])


def limited(sign: int) -> Any:
    best = em.solve(model(sign), subject_to=limits(sign))
    amounts = {"value": best.start_value, "totals": best.totals, "closest": best.closest}
    return amounts, best.prices, best.rule, best.violations()


TABLE: dict[str, Callable[[int], Any]] = {
    "solve": lambda s: ((solution := em.solve(model(s))), solution.gap_table),
    "solve, horizon": lambda s: em.solve(model(s), horizon=3, terminal_value=[s * 5, 0, s * -2, s]),
    "certify": lambda s: em.certify(model(s)),
    "evaluate": lambda s: (
        (own := em.evaluate(model(s, 1), "random")),
        {"value": own.value, "occupancy": own.occupancy},
    ),
    "solve under limits": limited,
    "check": lambda s: audited(em.check(model(s), POLICY)),
    "check, bounds": lambda s: audited(em.check(model(s), POLICY, exact_values=False)),
    "check, Q-table": lambda s: audited(
        em.check(model(s), s * np.array([[1.0, 2], [0, 3], [2, 1], [0, 0]]), kind="q")
    ),
    "check, horizon": lambda s: audited(em.check(model(s), POLICY, horizon=3)),
    "check under limits": lambda s: audited(em.check(model(s), POLICY, subject_to=limits(s))),
    "check, average": lambda s: audited(em.check(endless(s), [1, 0], criterion="average")),
    "check, robust": lambda s: with_interval(s, em.Robust(rewards=span(s, -3, 8))),
    "check, posterior": lambda s: with_interval(s, em.Posterior(n=100)),
    "check, off-policy": lambda s: with_interval(
        s, em.OffPolicy(records=records(s), behaviour="random", rewards=span(s, -3, 8))
    ),
    "best policy of columns": lambda s: (
        (best := em.best_policy(model(s), [])),
        {"value": [best.value.value, best.upper_bound, best.mixed_upper_bound]},
    ),
    "tradeoff": lambda s: em.tradeoff(model(s), ["anger", "rest"]),
    "rationalize": lambda s: em.rationalize(model(s), POLICY),
    "tornado": lambda s: em.tornado(family(s), policy=POLICY),
    "one-way": lambda s: em.one_way(family(s), "p", policy=POLICY, points=5),
    "two-way": lambda s: (
        (grid := em.two_way(family(s), "p", "q", policy=POLICY, points=4)),
        grid.choices,
    ),
    "gradient": lambda s: em.gradient(family(s), policy=POLICY),
    "thresholds": lambda s: em.thresholds(family(s), "p", ("1/100", "99/100")),
    "curve": pieces,
    "psa": drawn,
    "sobol": lambda s: em.sobol(family(s), policy=POLICY, n=16, rng=0),
    "robust": lambda s: em.robust(model(s), policy=POLICY),
    "robust by name": lambda s: em.robust(model(s), "l1", radius=0.1, policy=POLICY),
    "Q-learning": learned,
    "learning curve": lambda s: em.learning_curve(
        model(s), em.QLearning(epochs=5).train(model(s), rng=0), rng=0, n=20
    ),
    "check trainer": lambda s: em.check_trainer(
        model(s), lambda seed: [seed % 2, 0, 0, 0], rng=0, runs=30
    ),
    "simulate": lambda s: ((sample := em.simulate(model(s), POLICY, 50, 0)), sample.frame()),
    "returns": lambda s: em.return_distribution(model(s, 1), POLICY),
    "average": lambda s: (
        em.certify(endless(s), criterion="average"),
        em.solve(endless(s), criterion="average"),
        em.evaluate(endless(s), [0, 0], criterion="average"),
    ),
    "CVaR": lambda s: {"value": tails(s)},
}


def plain(result: Any) -> Any:
    """Return what a result says: the JSON of its report, its table, or the thing itself."""
    if isinstance(result, tuple | list):
        return [plain(each) for each in result]
    if isinstance(result, dict):
        return {str(name): plain(each) for name, each in result.items()}
    if hasattr(result, "violations"):
        assert result.violations() == []
    if hasattr(result, "report") and (report := result.report()).facts:
        return json.loads(report.json())
    frame = result.frame() if hasattr(result, "frame") else result
    return frame.to_dict("list") if isinstance(frame, pd.DataFrame) else result


def agree(costs: Any, rewards: Any, path: str = "") -> None:
    """Compare what is said of both, leaf by leaf."""
    name = path.rpartition(".")[2]
    if name in DIFFERENT:
        return
    sign = -1 if WORTH.search(path) and not SAME.search(path) else 1
    if isinstance(rewards, np.ndarray):
        costs, rewards = costs.tolist(), rewards.tolist()
    if name == "distribution" and isinstance(rewards, dict):
        costs = {str(-F(key)): chance for key, chance in costs.items()}
    if name == "quantiles" or (name in SPREAD and isinstance(rewards, list)):
        costs, rewards = sorted(leaves(costs), key=lambda x: sign * x), sorted(leaves(rewards))
    if isinstance(rewards, dict):
        assert set(costs) == set(rewards)
        for key in rewards:
            agree(costs[key], rewards[key], f"{path}.{key}")
    elif isinstance(rewards, list | tuple):
        assert len(costs) == len(rewards)
        for number, (one, other) in enumerate(zip(costs, rewards, strict=True)):
            agree(one, other, f"{path}.{number}")
    else:
        one, other = number_of(costs), number_of(rewards)
        if isinstance(other, float):
            other = pytest.approx(other, rel=1e-9, abs=1e-9, nan_ok=True)
        assert (one * sign if isinstance(one, int | float | F) else one) == other, path


def number_of(leaf: Any) -> Any:
    """Return a number, also of a text such as "2/3"; another thing as it is."""
    if isinstance(leaf, str) and re.fullmatch(r"-?\d+(/\d+)?", leaf):
        return F(leaf)
    return float(leaf) if isinstance(leaf, np.floating) else leaf


def leaves(thing: Any) -> list[Any]:
    """Return the numbers in lists and objects, but for probabilities."""
    if isinstance(thing, dict):
        thing = [each for name, each in thing.items() if name != "probability"]
    if isinstance(thing, list):
        return [leaf for each in thing for leaf in leaves(each)]
    return [float(thing) if isinstance(thing, str) else thing]  # infinite ones are texts


@pytest.mark.parametrize("name", TABLE)
def test_costs_are_rewards_turned_round(name: str) -> None:
    agree(plain(TABLE[name](-1)), plain(TABLE[name](1)))
