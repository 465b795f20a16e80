"""Costs are rewards times -1: every analysis says the same of both, with the sign of values turned.

Each entry of the table makes two lists: numbers that are worth something in the model, whose sign
turns, and numbers that are the same for both: regrets, policies, probabilities, steps.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction as F
from typing import Any

import numpy as np
import pandas as pd
import pytest

from exact_mdp import (
    MDP,
    Family,
    OffPolicy,
    Posterior,
    QLearning,
    Robust,
    best_cvar,
    best_policy,
    certify,
    check,
    check_trainer,
    compare,
    curve,
    evaluate,
    gradient,
    learning_curve,
    mean_cvar,
    moving,
    one_way,
    outcomes,
    psa,
    rationalize,
    return_distribution,
    robust,
    robust_curve,
    simulate,
    sobol,
    solve,
    thresholds,
    tornado,
    tradeoff,
    two_way,
)

POLICY = [1, 0, 0, 0]
Told = tuple[Any, Any]


def model(sign: int, discount: object = "9/10") -> MDP:
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
    return MDP.from_outcomes(
        rows,
        discount,
        sense="max" if sign > 0 else "min",
        start={0: "2/3", 1: "1/3"},
        components={"anger": [sign * value for value in anger]},
        labels={"over": [False, False, False, True]},
    )


def family(sign: int) -> Family:
    return moving(model(sign), {"p": [(0, 1)], "q": [(4, 0)]})


def recorded(sign: int) -> MDP:
    return MDP.from_transitions(records(sign), discount="9/10", sense=model(sign).sense)


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


def audited(found: Any) -> Told:
    lost = found.regret
    signed = [lost.optimal.value, lost.learned.value, *lost.optimal_value, *lost.learned_value]
    same = [lost.at_start.value, *lost.by_state, *lost.gap, *lost.optimal_pairs, found.passed]
    same += [number for each in found.disagreements for number in (each.state, each.gap, each.cost)]
    return signed, [*same, found.agreement, found.relative_regret]


def solved(found: Any) -> Told:
    gaps = found.gap_table[found.mdp.pair_state, found.mdp.pair_action]
    return [found.start_value, *found.value], [*found.policy, *gaps, found.error_bound]


def with_interval(sign: int, by: Any) -> Told:
    found = check(recorded(sign), POLICY, confidence=0.9, by=by)
    signed, same = audited(found)
    return signed, [*same, found.interval.low, found.interval.high]


def span(sign: int, low: int, high: int) -> tuple[int, int]:
    """Return a range of rewards, or that of the costs."""
    return (low, high) if sign > 0 else (-high, -low)


def limited(sign: int) -> Told:
    found = solve(model(sign), subject_to=limits(sign))
    signed = [found.start_value, *found.totals.values(), *found.closest.values()]
    return signed, [*found.prices.values(), *found.rule.ravel(), found.violations()]


def limits(sign: int) -> dict[str, str]:
    """Return that anger, in the model's own sign, is at most a half or at least minus a half."""
    return {"anger": "<= 1/2"} if sign > 0 else {"anger": ">= -1/2"}


def fronts(sign: int) -> Told:
    found = tradeoff(model(sign), ["anger", "rest"])
    signed = [number for vertex in found.vertices for number in vertex]
    return signed, [found.violations(), len(found.vertices)]


def weighed(sign: int) -> Told:
    found = rationalize(model(sign), POLICY)
    return [], [found.change, *found.weights.values(), *found.alone.values(), found.violations()]


def bars(sign: int) -> Told:
    found = tornado(family(sign), policy=POLICY)
    ends = [end for bar in found.bars for end in (bar.low, bar.high)]
    signed = [number for end in ends for number in (end.optimal.value, end.fixed.value)]
    return signed, [bar.parameter.name for bar in found.bars] + [end.regret.value for end in ends]


def line(sign: int) -> Told:
    found = one_way(family(sign), "p", policy=POLICY, points=5)
    signed = [number for p in found.points for number in (p.optimal.value, p.fixed.value)]
    return signed, [p.regret.value for p in found.points]


def plane(sign: int) -> Told:
    found = two_way(family(sign), "p", "q", policy=POLICY, points=4)
    signed = [*found.value.ravel(), *found.fixed_value.ravel()]
    return signed, [*found.choices.ravel(), *found.policy.ravel()]


def slopes(sign: int) -> Told:
    found = gradient(family(sign), policy=POLICY)
    own = [each.value.value for each in found.derivatives.values()]
    return [found.start.value, *own], [each.elasticity for each in found.derivatives.values()]


def crossings(sign: int) -> Told:
    found = thresholds(family(sign), "p", ("1/100", "99/100"))
    return [], [number for each in found.found for number in (each.value, each.state)]


def pieces(sign: int) -> Told:
    found = curve(family(sign), "p", ("1/100", "99/100"), policy=POLICY)
    at = ["1/100", "1/7", "1/2", "5/6"]
    signed = [found.at(x) for x in at] + [found.fixed_at(x) for x in at]
    ends = [number for each in found.within("1/10") for number in (*each.low, *each.high)]
    return signed, [found.violations(), len(found.pieces), *ends]


def drawn(sign: int) -> Told:
    found = psa(family(sign), 60, rng=0, policy=POLICY)
    worth = found.evpi()
    signed = [*found.optimal, *found.values.ravel()]
    same = [worth.low.value, worth.high.value, found.evpi_of_candidates().value, *found.regret()]
    same += [each.regression.value for each in found.evppi().values()]
    same += [each.lower.value for each in found.evppi().values()]
    same += [each.value for each in found.acceptability([0, 0.1])]
    same += [each.name for each in found.candidates]
    return signed, [*same, *found.lost.ravel(), *found.counts.ravel()]


def indices(sign: int) -> Told:
    found = sobol(family(sign), policy=POLICY, n=16, rng=0)
    outputs = (found.optimal, found.fixed, found.regret)
    return [], [number for each in outputs for number in (*each.first, *each.total)]


def against_nature(sign: int) -> Told:
    found = robust(model(sign), policy=POLICY)
    starts = (found.value, found.worst, found.robust.start, found.optimistic.start)
    return [each.value for each in starts], [*found.robust.policy]


def along_radii(sign: int) -> Told:
    found = robust_curve(model(sign), "l1", [0, 0.1], policy=POLICY)
    return [n for _, each in found.points for n in (each.worst.value, each.robust.start.value)], []


def learned(sign: int) -> Told:
    own = model(sign)
    run = QLearning(epochs=20, discount="9/10").train(own, rng=3)
    found = outcomes(own, [run])
    return [*run.q.ravel(), *run.returns], [*run.policies.ravel(), *found.regret]


def over_epochs(sign: int) -> Told:
    own = model(sign)
    found = learning_curve(own, QLearning(epochs=5).train(own, rng=0), rng=0, n=20)
    return [*found.sampled, *found.value], [*found.standard_error, *found.error]


def trainers(sign: int) -> Told:
    found = check_trainer(model(sign), lambda seed: [seed % 2, 0, 0, 0], rng=0, runs=30)
    return [], [found.passed, *found.frame()["regret"]]


def sampled(sign: int) -> Told:
    found = simulate(model(sign), POLICY, 50, 0)
    return [found.mean, *found.returns], [found.standard_error, *found.steps]


def spread(sign: int) -> Told:
    found = return_distribution(model(sign, 1), POLICY)
    signed = [found.mean]
    told = {sign * value: chance for value, chance in found.as_dict().items()}
    return signed, [found.sd, *(n for pair in sorted(told.items()) for n in pair)]


def measured(sign: int) -> Told:
    found = evaluate(model(sign, 1), "random")
    quantiles = [found.quantiles[share] for share in (0.25, 0.75)][::sign]
    return [found.mean, *found.components.values(), *found.value, *quantiles], [
        found.sd, found.steps, *found.occupancy,
    ]  # fmt: skip


def averaged(sign: int) -> Told:
    found = certify(endless(sign), criterion="average")
    mine = evaluate(endless(sign), [0, 0], criterion="average")
    signed = [*found.value, *found.bias, *solve(endless(sign), criterion="average").value]
    return [*signed, mine.start.value], [*found.policy, found.violations()]


def endless(sign: int) -> MDP:
    rows = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 3)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 0, -1)])]
    return MDP.from_outcomes(
        [(s, a, [(p, t, sign * r) for p, t, r in each]) for s, a, each in rows],
        "9/10",
        sense="max" if sign > 0 else "min",
    )


def average_check(sign: int) -> Told:
    found = check(endless(sign), [1, 0], criterion="average")
    return [found.regret.optimal.value, found.regret.learned.value], [found.regret.at_start.value]


def tails(sign: int) -> Told:
    found = mean_cvar(model(sign, 1), "1/4", policies={"mine": POLICY}, horizon=4)
    best = best_cvar(model(sign, 1), "1/4", horizon=4)
    return [n for point in found.policies.values() for n in point] + [best.value, best.mean], []


def compared(sign: int) -> Told:
    found = compare(model(sign), {"mine": POLICY, "coin": "random", "best": "optimal"})
    each = list(found.regrets.values())
    return [found.value.value, *(r.learned.value for r in each)], [r.at_start.value for r in each]


def by_columns(sign: int) -> Told:
    found = best_policy(model(sign), [])
    return [found.value.value, found.upper_bound], [*found.policy.weights(model(sign))]


TABLE: dict[str, Callable[[int], Told]] = {
    "solve": lambda s: solved(solve(model(s))),
    "solve, horizon": lambda s: solved(
        solve(model(s), horizon=3, terminal_value=[s * 5, 0, s * -2, s])
    ),
    "certify": lambda s: ((c := certify(model(s))).value, [*c.policy, c.violations()]),
    "evaluate": measured,
    "solve under limits": limited,
    "check": lambda s: audited(check(model(s), POLICY)),
    "check, bounds": lambda s: audited(check(model(s), POLICY, exact_values=False)),
    "check, Q-table": lambda s: audited(
        check(model(s), s * np.array([[1.0, 2], [0, 3], [2, 1], [0, 0]]), kind="q")
    ),
    "check, horizon": lambda s: audited(check(model(s), POLICY, horizon=3)),
    "check under limits": lambda s: audited(check(model(s), POLICY, subject_to=limits(s))),
    "check, average": average_check,
    "check, robust": lambda s: with_interval(s, Robust(rewards=span(s, -3, 8))),
    "check, posterior": lambda s: with_interval(s, Posterior(n=100)),
    "check, off-policy": lambda s: with_interval(
        s, OffPolicy(records=records(s), behaviour="random", rewards=span(s, -3, 8), n=100)
    ),
    "compare": compared,
    "best policy of columns": by_columns,
    "tradeoff": fronts,
    "rationalize": weighed,
    "tornado": bars,
    "one-way": line,
    "two-way": plane,
    "gradient": slopes,
    "thresholds": crossings,
    "curve": pieces,
    "psa": drawn,
    "sobol": indices,
    "robust": against_nature,
    "robust curve": along_radii,
    "Q-learning": learned,
    "learning curve": over_epochs,
    "check trainer": trainers,
    "simulate": sampled,
    "returns": spread,
    "average": averaged,
    "CVaR": tails,
}


def flat(numbers: Any) -> list[Any]:
    found: list[Any] = []
    for each in numbers:
        found += flat(each) if isinstance(each, tuple | list | np.ndarray) else [each]
    return found


@pytest.mark.parametrize("name", TABLE)
def test_costs_are_rewards_turned_round(name: str) -> None:
    costs, rewards = TABLE[name](-1), TABLE[name](1)
    turned = [-1 * each for each in flat(costs[0])]
    for mine, theirs in ((turned, flat(rewards[0])), (flat(costs[1]), flat(rewards[1]))):
        assert len(mine) == len(theirs)
        for one, other in zip(mine, theirs, strict=True):
            if isinstance(other, float | np.floating):
                assert one == pytest.approx(other, rel=1e-9, abs=1e-9, nan_ok=True)
            else:
                assert one == other
