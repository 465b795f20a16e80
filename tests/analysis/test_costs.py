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


def audited(audit: Any) -> Told:
    lost = audit.regret
    signed = [lost.optimal.value, lost.learned.value, *lost.optimal_value, *lost.learned_value]
    same = [lost.at_start.value, *lost.by_state, *lost.gap, *lost.optimal_pairs, audit.passed]
    same += [number for each in audit.disagreements for number in (each.state, each.gap, each.cost)]
    return signed, [*same, audit.agreement, audit.relative_regret]


def solved(solution: Any) -> Told:
    gaps = solution.gap_table[solution.mdp.pair_state, solution.mdp.pair_action]
    return [solution.start_value, *solution.value], [*solution.policy, *gaps, solution.error_bound]


def with_interval(sign: int, by: Any) -> Told:
    audit = check(recorded(sign), POLICY, confidence=0.9, by=by)
    signed, same = audited(audit)
    return signed, [*same, audit.interval.low, audit.interval.high]


def span(sign: int, low: int, high: int) -> tuple[int, int]:
    """Return a range of rewards, or that of the costs."""
    return (low, high) if sign > 0 else (-high, -low)


def limited(sign: int) -> Told:
    solution = solve(model(sign), subject_to=limits(sign))
    signed = [solution.start_value, *solution.totals.values(), *solution.closest.values()]
    return signed, [*solution.prices.values(), *solution.rule.ravel(), solution.violations()]


def limits(sign: int) -> dict[str, str]:
    """Return that anger, in the model's own sign, is at most a half or at least minus a half."""
    return {"anger": "<= 1/2"} if sign > 0 else {"anger": ">= -1/2"}


def fronts(sign: int) -> Told:
    front = tradeoff(model(sign), ["anger", "rest"])
    signed = [number for vertex in front.vertices for number in vertex]
    return signed, [front.violations(), len(front.vertices)]


def weighed(sign: int) -> Told:
    least_change = rationalize(model(sign), POLICY)
    return [], [
        least_change.change,
        *least_change.weights.values(),
        *least_change.alone.values(),
        least_change.violations(),
    ]


def bars(sign: int) -> Told:
    ends_of = tornado(family(sign), policy=POLICY)
    ends = [end for bar in ends_of.bars for end in (bar.low, bar.high)]
    signed = [number for end in ends for number in (end.optimal.value, end.fixed.value)]
    return signed, [bar.parameter.name for bar in ends_of.bars] + [end.regret.value for end in ends]


def line(sign: int) -> Told:
    points = one_way(family(sign), "p", policy=POLICY, points=5).table
    return [*points.optimal, *points.fixed.ravel()], [*points.regret.ravel()]


def plane(sign: int) -> Told:
    grid = two_way(family(sign), "p", "q", policy=POLICY, points=4)
    signed = [*grid.table.optimal, *grid.table.fixed.ravel()]
    return signed, [*grid.choices.ravel(), *grid.policy.ravel()]


def slopes(sign: int) -> Told:
    slope = gradient(family(sign), policy=POLICY)
    own = [each.value.value for each in slope.derivatives.values()]
    return [slope.start.value, *own], [each.elasticity for each in slope.derivatives.values()]


def crossings(sign: int) -> Told:
    switches = thresholds(family(sign), "p", ("1/100", "99/100"))
    return [], [number for each in switches.found for number in (each.value, each.state)]


def pieces(sign: int) -> Told:
    value_curve = curve(family(sign), "p", ("1/100", "99/100"), policy=POLICY)
    at = ["1/100", "1/7", "1/2", "5/6"]
    signed = [value_curve.at(x) for x in at] + [value_curve.fixed_at(x) for x in at]
    ends = [number for each in value_curve.within("1/10") for number in (*each.low, *each.high)]
    return signed, [value_curve.violations(), len(value_curve.pieces), *ends]


def drawn(sign: int) -> Told:
    analysis = psa(family(sign), 60, rng=0, policy=POLICY)
    evpi = analysis.evpi()
    signed = [*analysis.table.optimal, *analysis.table.fixed.ravel()]
    same = [
        evpi.low.value,
        evpi.high.value,
        analysis.evpi_of_candidates().value,
        *analysis.regret(),
    ]
    same += [each.regression.value for each in analysis.evppi().values()]
    same += [each.lower.value for each in analysis.evppi().values()]
    same += analysis.acceptability([0, 0.1])[0].tolist()
    same += [each.name for each in analysis.candidates]
    return signed, [*same, *analysis.table.lost.ravel(), *analysis.table.counts.ravel()]


def indices(sign: int) -> Told:
    shares = sobol(family(sign), policy=POLICY, n=16, rng=0)
    outputs = (shares.optimal, shares.fixed, shares.regret)
    return [], [number for each in outputs for number in (*each.first, *each.total)]


def against_nature(sign: int) -> Told:
    cases = robust(model(sign), policy=POLICY)
    starts = (cases.value, cases.worst, cases.robust.start, cases.optimistic.start)
    return [each.value for each in starts], [*cases.robust.policy]


def along_radii(sign: int) -> Told:
    cases = robust_curve(model(sign), "l1", [0, 0.1], policy=POLICY)
    return [n for _, each in cases.points for n in (each.worst.value, each.robust.start.value)], []


def learned(sign: int) -> Told:
    own = model(sign)
    run = QLearning(epochs=20, discount="9/10").train(own, rng=3)
    runs = outcomes(own, [run])
    return [*run.q.ravel(), *run.returns], [*run.policies.ravel(), *runs.regret]


def over_epochs(sign: int) -> Told:
    own = model(sign)
    by_epoch = learning_curve(own, QLearning(epochs=5).train(own, rng=0), rng=0, n=20)
    return [*by_epoch.sampled, *by_epoch.value], [*by_epoch.standard_error, *by_epoch.error]


def trainers(sign: int) -> Told:
    verdict = check_trainer(model(sign), lambda seed: [seed % 2, 0, 0, 0], rng=0, runs=30)
    return [], [verdict.passed, *verdict.frame()["regret"]]


def sampled(sign: int) -> Told:
    sample = simulate(model(sign), POLICY, 50, 0)
    return [sample.mean, *sample.returns], [sample.standard_error, *sample.steps]


def spread(sign: int) -> Told:
    law = return_distribution(model(sign, 1), POLICY)
    signed = [law.mean]
    chances = {sign * value: chance for value, chance in law.as_dict().items()}
    return signed, [law.sd, *(n for pair in sorted(chances.items()) for n in pair)]


def measured(sign: int) -> Told:
    evaluation = evaluate(model(sign, 1), "random")
    quantiles = [evaluation.quantiles[share] for share in (0.25, 0.75)][::sign]
    return [evaluation.mean, *evaluation.components.values(), *evaluation.value, *quantiles], [
        evaluation.sd, evaluation.steps, *evaluation.occupancy,
    ]  # fmt: skip


def averaged(sign: int) -> Told:
    optimum = certify(endless(sign), criterion="average")
    mine = evaluate(endless(sign), [0, 0], criterion="average")
    signed = [*optimum.value, *optimum.bias, *solve(endless(sign), criterion="average").value]
    return [*signed, mine.start.value], [*optimum.policy, optimum.violations()]


def endless(sign: int) -> MDP:
    rows = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 3)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 0, -1)])]
    return MDP.from_outcomes(
        [(s, a, [(p, t, sign * r) for p, t, r in each]) for s, a, each in rows],
        "9/10",
        sense="max" if sign > 0 else "min",
    )


def average_check(sign: int) -> Told:
    audit = check(endless(sign), [1, 0], criterion="average")
    return [audit.regret.optimal.value, audit.regret.learned.value], [audit.regret.at_start.value]


def tails(sign: int) -> Told:
    points = mean_cvar(model(sign, 1), "1/4", policies={"mine": POLICY}, horizon=4)
    best = best_cvar(model(sign, 1), "1/4", horizon=4)
    return [n for point in points.policies.values() for n in point] + [best.value, best.mean], []


def compared(sign: int) -> Told:
    comparison = compare(model(sign), {"mine": POLICY, "coin": "random", "best": "optimal"})
    each = list(comparison.regrets.values())
    return [comparison.value.value, *(r.learned.value for r in each)], [
        r.at_start.value for r in each
    ]


def by_columns(sign: int) -> Told:
    best = best_policy(model(sign), [])
    return [best.value.value, best.upper_bound], [*best.policy.weights(model(sign))]


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
    facts: list[Any] = []
    for each in numbers:
        facts += flat(each) if isinstance(each, tuple | list | np.ndarray) else [each]
    return facts


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
