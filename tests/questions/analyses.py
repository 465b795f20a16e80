"""Every public analysis, asked of a case and held against the oracle.

A function asks the toolkit and raises `Mismatch` where the answer is another one. It returns the
number of numbers that it compared; a refusal in words is an error of the toolkit that passes on.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction as F
from itertools import pairwise, product
from math import inf, isinf, isnan
from random import Random
from typing import Any

import pandas as pd

import exact_mdp
from exact_mdp import Policy

from . import oracle
from .models import PARTS, SIZE, Case
from .oracle import Value

Check = Callable[[Case, Random], int]
ANALYSES: dict[str, Check] = {}
MIXED = "a start that mixes infinities is not refused"
ROUNDING = 1e-9  # of numbers that state no bound, relative to their size


class Mismatch(AssertionError):
    """An answer that is not the oracle's."""


def analysis(check: Check) -> Check:
    """Add an analysis to the table, by its name."""
    ANALYSES[check.__name__.removeprefix("check_")] = check
    return check


def require(holds: bool, *what: object) -> None:
    """Raise Mismatch unless a fact holds."""
    if not holds:
        raise Mismatch(" ".join(map(str, what)))


def require_near(found: Any, wanted: Value | None, what: object, error: float | None = None) -> int:
    """Raise Mismatch unless a number is the wanted one, up to the error that it states."""
    if error is None:
        error = float(getattr(found, "error", 0.0))
        found = getattr(found, "value", found)
    if wanted is None:
        raise Mismatch(f"{what}: {found}, where +∞ and -∞ are mixed")
    if isinstance(wanted, float) or (isinstance(found, float) and isinf(found)):
        require(float(found) == float(wanted), what, "is", found, "not", wanted)
    elif isinstance(found, F | int) and not error:
        require(found == wanted, what, "is", found, "not", wanted)
    else:
        require(isinstance(found, F) or not isnan(found), what, "is not a number")
        off = abs(F(found) - wanted)
        require(off <= F(error), what, "is", float(found), "±", error, "not", float(wanted))
    return 1


def about(found: Any, wanted: Value | None, what: object) -> int:
    """Raise Mismatch unless a float is near the wanted number; it states no bound."""
    if wanted is None or isinstance(wanted, float):
        return require_near(float(found), wanted, what, 0.0)
    return require_near(float(found), wanted, what, ROUNDING * (1 + abs(float(wanted))))


def same_everywhere(case: Case, found: Any, errors: Any, wanted: Sequence[Value], what: str) -> int:
    """Compare values of all states: of the first layer, where states have the time in them."""
    for state in range(SIZE):
        error = None if errors is None else float(errors[state])
        require_near(found[state], wanted[state], f"{what} of state {state}", error)
    return SIZE


# ---- optima and policies -------------------------------------------------------------------------


@analysis
def check_solve(case: Case, rng: Random) -> int:
    """The optimum in floats."""
    found = exact_mdp.solve(case.mdp, **case.question.options)
    same_everywhere(case, found.value, found.state_error, case.optimum, "optimum")
    return SIZE + require_near(found.start, case.start_of(case.optimum), "start")


@analysis
def check_certify(case: Case, rng: Random) -> int:
    """The exact optimum and its proof."""
    found = exact_mdp.certify(case.mdp, **case.question.options)
    require(found.violations() == [], "the proof:", found.violations())
    same_everywhere(case, found.value, None, case.optimum, "optimum")
    return SIZE + require_near(found.start_value, case.start_of(case.optimum), "start")


@analysis
def check_evaluate(case: Case, rng: Random) -> int:
    """The value of a policy, in every state, and its components."""
    found = exact_mdp.evaluate(case.mdp, case.policy, **case.question.options)
    count = require_near(found.start, case.start_of(case.worth), "mean")
    for state in range(SIZE):
        if not isnan(found.value[state]):
            error = float(found.error[state])
            count += require_near(found.value[state], case.worth[state], f"state {state}", error)
    components = dict(found.components)
    if set(components) == set(PARTS):
        for name in PARTS:
            part = components[name]
            value = getattr(part, "value", part)
            if not isnan(value):
                count += about(value, _component(case, name), f"component {name}")
    return count


def _component(case: Case, name: str) -> Value | None:
    """Return the total of a component under the policy."""
    plain = oracle.replace(case.plain, rows=_rows_of_component(case.plain, name))
    problem = case.question.of_oracle(plain)
    values = oracle.evaluate(problem, case.mixture(problem))
    return oracle.at_start(problem, values)


def _rows_of_component(plain: oracle.Plain, name: str) -> Any:
    """Return the rows of a model in which one component alone is earned."""
    return [
        [
            (action, [(p, to, {"r": amounts[name]}) for p, to, amounts in outcomes])
            for action, outcomes in each
        ]
        for each in plain.rows
    ]


@analysis
def check_check(case: Case, rng: Random) -> int:
    """The regret of a policy, and the verdict."""
    audit = exact_mdp.check(case.mdp, case.policy, **case.question.options)
    best, own = case.start_of(case.optimum), case.start_of(case.worth)
    lost = _lost(case, best, own)
    require_near(audit.regret.at_start, lost, "regret")
    require(audit.passed == (lost == 0), "passed is", audit.passed, "with a regret of", lost)
    if not audit.passed and not case.question.options:
        require(len(audit.disagreements) > 0, "no state is named")
    for each in audit.disagreements:
        require(each is not None, "no state")
    str(audit), audit.report().json()
    return 2


def _lost(case: Case, best: Value | None, own: Value | None) -> Value:
    """Return how much worse a policy is than the optimum."""
    if best is None or own is None or best == own:
        require(best is not None and own is not None, MIXED)
        require(not isinstance(best, float), "∞ - ∞ is not refused")
        return F(0)
    return best - own if case.plain.sense == "max" else own - best


@analysis
def check_return_distribution(case: Case, rng: Random) -> int:
    """The probability of each return, and the spread that `evaluate` states."""
    if case.question.options:
        exact_mdp.return_distribution(case.mdp, case.policy, **case.question.options)
    found = exact_mdp.return_distribution(case.mdp, case.policy)
    law, left = oracle.returns(case.problem, case.mixture(case.problem), 30)
    mine = dict(zip(found.values, found.probabilities.tolist(), strict=True))
    count = 0
    for value, p in law.items():
        if isinstance(value, float):
            continue
        error = 1e-11 + float(left)
        count += require_near(float(mine.get(value, 0.0)), p, f"probability of {value}", error)
    require(sum(mine.values()) <= 1 + 1e-9, "probabilities pass 1")
    return count


@analysis
def check_best_cvar(case: Case, rng: Random) -> int:
    """The greatest mean of the worst half of returns."""
    found = exact_mdp.best_cvar(case.mdp, "1/2", **case.question.options)
    return require_near(found.value, oracle.best_tail_mean(case.problem, F(1, 2), 4), "worst half")


@analysis
def check_simulate(case: Case, rng: Random) -> int:
    """The mean of sampled returns, within six standard errors."""
    found = exact_mdp.simulate(case.mdp, case.policy, 400, 1, **case.question.options)
    wanted = case.start_of(case.worth)
    if wanted is None or isinstance(wanted, float):
        require(isinf(found.mean) or isnan(found.mean), "a finite mean of infinite returns")
        return 1
    reach = 6 * float(found.standard_error) + 0.05 * (found.standard_error == 0) + 1e-9
    if found.standard_error == 0 or isinf(found.mean):  # rare outcomes that the sample lacks
        return 0
    return require_near(float(found.mean), wanted, "mean of a sample", reach)


@analysis
def check_best_policy(case: Case, rng: Random) -> int:
    """The best policy that reads one column."""
    found = exact_mdp.best_policy(case.mdp, ["status"], **case.question.options)
    best = list[Value]()
    for taken in product(range(3), repeat=2):
        choice = []
        for state, each in enumerate(case.plain.rows):
            places = [k for k, (action, _) in enumerate(each) if action == taken[state % 2]]
            idle = all(
                len(o) == 1 and o[0][1] == state and not any(o[0][2].values()) for _, o in each
            )
            alike = len({str(o) for _, o in each}) == 1
            stopped = state in case.problem.stopped
            if not places and (len(each) == 1 or idle or alike or stopped):
                places = [0]
            choice.append(places[0] if places else -1)
        if min(choice) < 0:
            continue
        values = oracle.evaluate(case.problem, case.mixture(case.problem, choice))
        value = case.start_of(values)
        require(value is not None, MIXED)
        best.append(value if value is not None else F(0))
    require(bool(best), "no policy reads the column")
    require(found.proven, "not proven")
    return require_near(found.value, case.problem.best(best), "best policy that reads the status")


@analysis
def check_error_costs(case: Case, rng: Random) -> int:
    """What errors of perception cost."""
    wrong = [[F(3, 4), F(1, 4)], [F(1, 2), F(1, 2)]]
    if any(len({a for a, _ in case.plain.rows[2 * k + j]}) != 3 for k in (0, 1) for j in (0, 1)):
        case = _all_offered(case)
    matrix = [[float(p) for p in row] for row in wrong]
    found = exact_mdp.error_costs(case.mdp, case.policy, matrix, **case.question.options)
    mixed = []
    for state in range(len(case.problem.moves)):
        place, status = (state % SIZE) // 2, state % 2
        shares = [F(0)] * len(case.problem.moves[state])
        if len(shares) == 1:
            mixed.append([F(1)])
            continue
        for seen in (0, 1):
            shares[case.choice[2 * place + seen]] += wrong[status][seen]
        mixed.append(shares)
    count = require_near(found.perfect, case.start_of(case.worth), "read rightly")
    values = oracle.evaluate(case.problem, mixed)
    wanted = case.start_of(values)
    count += require_near(found.value, wanted, "read with errors")
    sign = 1 if case.plain.sense == "max" else -1
    lost = sign * (case.start_of(case.worth) - wanted)
    return count + about(float(found.loss.sum()), lost, "the whole loss")


def _all_offered(case: Case) -> Case:
    """Return a case in which all states offer all actions, as perception needs."""
    rows = []
    for each in case.plain.rows:
        by_action = dict(each)
        first = each[0][1]
        rows.append([(action, by_action.get(action, first)) for action in range(3)])
    choice = tuple(
        [a for a, _ in rows[s]].index(case.plain.rows[s][k][0]) for s, k in enumerate(case.choice)
    )
    plain = oracle.replace(case.plain, rows=rows)
    return Case(plain, case.question, None, (0, 0), choice)


# ---- several aims --------------------------------------------------------------------------------


def _best_weighted(case: Case, weights: Sequence[F]) -> Value | None:
    """Return the best total of the components with weights, at the start."""
    rows = [
        [
            (
                action,
                [
                    (
                        p,
                        to,
                        {"r": sum((w * a[n] for w, n in zip(weights, PARTS, strict=True)), F(0))},
                    )
                    for p, to, a in outcomes
                ],
            )
            for action, outcomes in each
        ]
        for each in case.plain.rows
    ]
    problem = case.question.of_oracle(oracle.replace(case.plain, rows=rows))
    return oracle.at_start(problem, oracle.optimum(problem))


def _best_of_finite(case: Case, weights: Sequence[F]) -> Value | None:
    """Return the best total of the components with weights among policies with finite totals.

    A policy that never ends may have a finite weighted total, and yet an infinite cost.
    """
    if case.problem.layered or case.problem.discount < 1:
        return _best_weighted(case, weights)
    problems = [
        case.question.of_oracle(
            oracle.replace(case.plain, rows=_rows_of_component(case.plain, name))
        )
        for name in PARTS
    ]
    worths = list[Value]()
    for choice in case.problem.choices():
        policy = oracle.pure(case.problem, choice)
        totals = [oracle.at_start(each, oracle.evaluate(each, policy)) for each in problems]
        if all(isinstance(total, F) for total in totals):
            each = zip(weights, totals, strict=True)
            worths.append(sum((w * total for w, total in each), F(0)))
    return case.problem.best(worths)


@analysis
def check_tradeoff(case: Case, rng: Random) -> int:
    """The front: in each direction its best vertex is the optimum of that weighted total."""
    if case.question.amount or "reaching" in case.question.name:
        exact_mdp.tradeoff(case.mdp, ["qaly", "cost"], **case.question.options)
    front = exact_mdp.tradeoff(case.mdp, ["qaly", "cost"], **case.question.options)
    require(front.violations() == [], "the proof:", front.violations())
    for weights in ((1, 0), (0, 1), (1, 1), (2, 7), (5, 2)):
        exact = [F(w) for w in weights]
        worths = [sum((w * x for w, x in zip(exact, v, strict=True)), F(0)) for v in front.vertices]
        require_near(case.problem.best(worths), _best_weighted(case, exact), f"weights {weights}")
    return 5


@analysis
def check_subject_to(case: Case, rng: Random) -> int:
    """The optimum under a limit, between two policies at most."""
    limit = {"cost": "<= 1/2"}
    found = exact_mdp.solve(case.mdp, subject_to=limit, **case.question.options)
    require(found.violations() == [], "the proof:", found.violations())
    # Duality: the least, over prices of the limit, of the optimum of reward - price (cost - 1/2).
    low = None
    sign = 1 if case.plain.sense == "max" else -1
    for price in (F(0), F(1, 2), F(1), F(3), F(9)):
        weights = [F(1), 1 - sign * price]
        best = _best_weighted(case, weights)
        if best is None or isinstance(best, float):
            require(False, "an infinite total is not refused")
        value = sign * best + price * F(1, 2)
        low = value if low is None else min(low, value)
    if not found.feasible:
        return 1
    mine = sign * found.start_value
    require(mine <= low, "the optimum", mine, "is above what duality allows,", low)
    own = [found.totals["cost"] <= F(1, 2)]
    require(all(own), "the limit is not kept:", found.totals)
    price = F(sum(found.prices.values()))
    best = _best_of_finite(case, [F(1), 1 - sign * abs(price)])
    bound = sign * best + abs(price) * F(1, 2)
    require(mine == bound, "the optimum", mine, "is not what its price proves,", bound)
    return 3


@analysis
def check_rationalize(case: Case, rng: Random) -> int:
    """The weights make the policy optimal, and no smaller change does."""
    found = exact_mdp.rationalize(case.mdp, case.policy, **case.question.options)
    require(found.violations() == [], "the proof:", found.violations())
    names = tuple(found.weights)
    parts = {name: _component(case, name) for name in PARTS}

    def loses(weights: Sequence[F]) -> Value:
        if names == PARTS:
            own = sum((w * parts[n] for w, n in zip(weights, PARTS, strict=True)), F(0))
            best = _best_weighted(case, weights)
        else:
            problem = _scaled(case.problem, *weights)
            own = oracle.at_start(problem, oracle.evaluate(problem, case.mixture(problem)))
            best = oracle.at_start(problem, oracle.optimum(problem))
        return best - own if case.plain.sense == "max" else own - best

    weights = [found.weights[name] for name in names]
    require(loses(weights) == 0, "the policy is not optimal under the weights")
    change = max(abs(w - 1) for w in weights)
    require(change == found.change, "the change is", change)
    less = found.change * F(99, 100)
    if less:
        for steps in product((-1, F(1, 2), 1), repeat=len(names)):
            near = [1 + step * less for step in steps]
            require(loses(near) > 0, "a smaller change does it:", near)
    return 2


def _scaled(problem: oracle.Problem, weight: F) -> oracle.Problem:
    """Return the problem in which all that is earned is multiplied by a weight."""
    moves = [
        [[(p, to, weight * r) for p, to, r in outcomes] for outcomes in each]
        for each in problem.moves
    ]
    stopped = {s: weight * value for s, value in problem.stopped.items()}
    return oracle.replace(problem, moves=moves, stopped=stopped)


@analysis
def check_cost_effectiveness(case: Case, rng: Random) -> int:
    """Effect and cost of two strategies, at drawn parameters."""
    other = tuple(0 for _ in case.plain.rows)
    draws = pd.DataFrame({"r": [float(case.today["r"]), float(case.today["r"] - 1)]})
    actions = [each[0][0] for each in case.plain.rows]
    strategies = {"one": case.policy, "other": Policy.of(case.base, actions)}
    found = exact_mdp.cost_effectiveness(
        case.family, strategies, uncertain=draws, **case.question.options
    )
    count = 0
    for d, r in enumerate((case.today["r"], case.today["r"] - 1)):
        plain = case.plain_at({"r": r})
        for n, choice in enumerate((case.choice, other)):
            there = Case(plain, case.question, None, (0, 0), choice)
            for name, values in (("qaly", found.effect), ("cost", found.cost)):
                count += about(values[d, n], _component(there, name), f"{name} of {n}, draw {d}")
    return count


# ---- parameters ----------------------------------------------------------------------------------


def _moved(case: Case, rng: Random) -> tuple[str, tuple[F, F]]:
    """Return one of the parameters, and its range."""
    return rng.choice(sorted(case.spans.items()))


@analysis
def check_gradient(case: Case, rng: Random) -> int:
    """One-sided derivatives, against exact differences over a step of 10⁻¹⁵."""
    count, step = 0, F(1, 10**15)
    fixed, exact = rng.random() < 0.5, rng.random() < 0.5
    policy = case.policy if fixed else "optimal"
    found = exact_mdp.gradient(case.family, policy=policy, exact=exact, **case.question.options)
    at = case.worth_at if fixed else case.optimum_at
    here = at({})
    count += require_near(found.start, here, "start")
    for name, each in found.derivatives.items():
        for side, derivative in ((-1, each.left), (1, each.right)):
            there = at({name: case.today[name] + side * step})
            require(
                not isinstance(here, float) and not isinstance(there, float),
                "a derivative where the value is infinite",
            )
            slope = side * (there - here) / step
            number = getattr(derivative, "number", derivative)
            # The step leaves an error of its own, of the order of its size.
            error = float(getattr(number, "error", 0.0)) + 1e-9 * (1 + abs(float(slope)))
            what = f"derivative in {name}, side {side}"
            count += require_near(float(number.value), slope, what, error)
    return count


def _of_study(case: Case, table: Any, names: Sequence[str], fixed: bool = True) -> int:
    """Compare a study's optimum and fixed values at every point."""
    count = 0
    for row, point in enumerate(table.points):
        values = {name: F(x) for name, x in zip(names, point.tolist(), strict=True)}
        error, own = table.error[row, 0], table.error[row, 1]
        count += require_near(table.optimal[row], case.optimum_at(values), f"at {values}", error)
        if fixed:
            count += require_near(
                table.fixed[row, 0], case.worth_at(values), f"fixed, at {values}", own
            )
    return count


@analysis
def check_study(case: Case, rng: Random) -> int:
    """The optimum and a fixed policy at points."""
    points = {name: [low, high] for name, (low, high) in case.spans.items()}
    found = exact_mdp.study(case.family, points, [case.policy], **case.question.options)
    return _of_study(case, found, tuple(points))


@analysis
def check_one_way(case: Case, rng: Random) -> int:
    """The optimum and a fixed policy along one parameter."""
    name, span = _moved(case, rng)
    found = exact_mdp.one_way(
        case.family, name, span, policy=case.policy, points=3, **case.question.options
    )
    count = _of_study(case, found.table, [name])
    if case.question.amount is None and "reaching" not in case.question.name:
        count += _own_rewards(case)
    return count


@analysis
def check_two_way(case: Case, rng: Random) -> int:
    """The optimum over a grid of two parameters."""
    if "p" not in case.spans:
        return 0
    found = exact_mdp.two_way(
        case.family,
        "r",
        "p",
        policy=case.policy,
        ranges=case.spans,
        points=2,
        **case.question.options,
    )
    return _of_study(case, found.table, found.table.names)


@analysis
def check_tornado(case: Case, rng: Random) -> int:
    """The optimum and a fixed policy at the ends of all ranges."""
    found = exact_mdp.tornado(
        case.family, policy=case.policy, ranges=case.spans, **case.question.options
    )
    return _of_study(case, found.table, found.table.names)


def _own_rewards(case: Case) -> int:
    """The same of a model whose parameters nobody named."""
    totals = sorted(
        {sum(amounts.values()) for each in case.plain.rows for _, o in each for *_, amounts in o}
        - {F(0)}
    )
    if not totals:
        return 0
    reward = totals[0]
    name = f"reward.{int(reward)}"
    span = (reward - 1, reward + 1)
    found = exact_mdp.one_way(
        case.mdp, name, span, policy=case.policy, points=3, **case.question.options
    )
    count = 0
    for row, (at,) in enumerate(found.table.points.tolist()):
        problem = case.question.of_oracle(case.plain.with_amount(reward, F(at)))
        wanted = oracle.at_start(problem, oracle.optimum(problem))
        own = oracle.at_start(problem, oracle.evaluate(problem, case.mixture(problem)))
        error = found.table.error[row]
        count += require_near(found.table.optimal[row], wanted, f"{name} = {at}", error[0])
        count += require_near(found.table.fixed[row, 0], own, f"fixed, {name} = {at}", error[1])
    return count


@analysis
def check_worst_point(case: Case, rng: Random) -> int:
    """The value at the corner that is found, which no change of one parameter makes worse."""
    found = exact_mdp.worst_point(case.family, case.policy, case.spans, **case.question.options)
    point = {name: F(at) for name, at in found.point.items()}
    count = require_near(found.value, case.worth_at(point), f"at {point}")
    count += require_near(found.optimum, case.optimum_at(point), f"optimum at {point}")
    sign = 1 if case.plain.sense == "max" else -1
    for name, (low, high) in case.spans.items():
        other = {**point, name: low + high - point[name]}
        worth = case.worth_at(other)
        here = found.value.value * sign
        if not isinf(here):
            here = F(here) - F(found.value.error) - F(1, 10**9)
        require(worth is not None and sign * worth >= here, "a worse corner:", other)
    return count


@analysis
def check_psa(case: Case, rng: Random) -> int:
    """The optimum and a fixed policy in every draw; and of draws of the model's own rows."""
    draws = pd.DataFrame(
        {name: [float(low), float(high)] for name, (low, high) in case.spans.items()}
    )
    found = exact_mdp.psa(case.family, uncertain=draws, policy=case.policy, **case.question.options)
    count = _of_study(case, found.table, found.table.names)
    return count + _own_rows(case)


def _own_rows(case: Case) -> int:
    """Draw the rows of the model; each is one row, however often the question repeats it."""
    found = exact_mdp.psa(case.mdp, 2, policy=case.policy, **case.question.options)
    labels = case.base.space.labels(range(SIZE))
    count = 0
    for row, point in enumerate(found.table.points):
        plain, chances = case.plain, dict[tuple[int, int], dict[int, F]]()
        for name, x in zip(found.table.names, point.tolist(), strict=True):
            match = re.fullmatch(r"\((.*), (a|b|c)\): to (.*)", name)
            require(match is not None, "a parameter that is none of the model:", name)
            state, action, to = (
                labels.index(match[1]),
                "abc".index(match[2]),
                labels.index(match[3]),
            )
            place = [a for a, _ in case.plain.rows[state]].index(action)
            chances.setdefault((state, place), {})[to] = F(x)
        for (state, place), each in chances.items():
            plain = plain.with_chance(state, place, each)
        problem = case.question.of_oracle(plain)
        wanted = oracle.at_start(problem, oracle.optimum(problem))
        own = oracle.at_start(problem, oracle.evaluate(problem, case.mixture(problem)))
        error = found.table.error[row]
        count += require_near(found.table.optimal[row], wanted, f"draw {row}", error[0])
        count += require_near(found.table.fixed[row, 0], own, f"fixed, draw {row}", error[1])
    return count


@analysis
def check_sobol(case: Case, rng: Random) -> int:
    """The mean and spread of the optimum over a design lie between its least and greatest value."""
    found = exact_mdp.sobol(
        case.family, policy=case.policy, ranges=case.spans, n=2, **case.question.options
    )
    corners = [dict(zip(case.spans, each, strict=True)) for each in product(*case.spans.values())]
    middle = {name: (low + high) / 2 for name, (low, high) in case.spans.items()}
    values = [case.worth_at(at) for at in (*corners, middle)]
    require(
        not any(v is None or isinstance(v, float) for v in values), "infinite values are averaged"
    )
    if list(case.spans) == ["r"]:  # the value of a fixed policy is linear in r
        low, high = min(values), max(values)
        off = ROUNDING * (1 + max(abs(float(low)), abs(float(high))))
        mean = found.fixed.mean
        require(float(low) - off <= mean <= float(high) + off, "mean", mean, "of", low, high)
    return 1


@analysis
def check_curve(case: Case, rng: Random) -> int:
    """The exact value along one parameter."""
    name, (low, high) = _moved(case, rng)
    found = exact_mdp.curve(
        case.family, name, (low, high), policy=case.policy, **case.question.options
    )
    require(found.violations() == [], "the proof:", found.violations())
    count = 0
    for share in (F(0), F(3, 7), F(1)):
        at = low + share * (high - low)
        count += require_near(found.at(at), case.optimum_at({name: at}), f"at {name} = {at}")
        piece = next(p for p in found.pieces if p.low[0] <= at <= p.high[1])
        if piece.fixed is not None:
            wanted = case.worth_at({name: at})
            count += require_near(piece.fixed.at(at), wanted, f"fixed, at {name} = {at}")
    return count


@analysis
def check_thresholds(case: Case, rng: Random) -> int:
    """Between two thresholds one set of actions is optimal at both ends."""
    name, (low, high) = _moved(case, rng)
    found = exact_mdp.thresholds(case.family, name, (low, high), **case.question.options)
    ends = [low, *((t.low + t.high) / 2 for t in found.found), high]
    count = 0
    for one, other in pairwise(ends):
        at = (one + other) / 2
        count += require_near(found.curve.at(at), case.optimum_at({name: at}), f"{name} = {at}")
    return count


@analysis
def check_explore(case: Case, rng: Random) -> int:
    """The values on the page."""
    name, (low, high) = _moved(case, rng)
    found = exact_mdp.explore(
        case.family, name, ranges={name: (low, high)}, policy=case.policy, **case.question.options
    )
    (curve,) = found.curves
    count = 0
    for share in (F(0), F(1, 3), F(1)):
        at = low + share * (high - low)
        count += require_near(curve.at(at), case.optimum_at({name: at}), f"at {name} = {at}")
    require("<script" in found.page(), "no page")
    return count


@analysis
def check_robust(case: Case, rng: Random) -> int:
    """The worst and the best that rows within ± 20 % allow, among the vertices of the sets."""
    found = exact_mdp.robust(
        case.mdp, "interval", radius="1/5", policy=case.policy, **case.question.options
    )
    sign = 1 if case.plain.sense == "max" else -1
    count = 0
    for worst, value, best in (
        (True, found.worst, found.robust.start),
        (False, found.best, found.optimistic.start),
    ):
        turn = -sign if worst else sign
        for mixture, number in ((case.mixture(case.problem), value), (None, best)):
            wanted = _under_nature(case, turn, mixture)
            count += require_near(number, wanted, f"nature {'worst' if worst else 'best'}")
    return count


def _vertices(outcomes: Sequence[tuple[F, int, F]]) -> Iterable[list[tuple[F, int, F]]]:
    """Yield the vertices of the rows within ± 20 % of a row."""
    merged = dict[tuple[int, F], F]()
    for p, to, r in outcomes:
        if p:
            merged[to, r] = merged.get((to, r), F(0)) + p
    keys = list(merged)
    spans = [(merged[k] * F(4, 5), min(F(1), merged[k] * F(6, 5))) for k in keys]
    if len(keys) == 1:
        yield [(F(1), *keys[0])]
        return
    for free in range(len(keys)):
        for ends in product((0, 1), repeat=len(keys) - 1):
            others = iter(ends)
            row = [F(0) if k == free else spans[k][next(others)] for k in range(len(keys))]
            row[free] = 1 - sum(row)
            if spans[free][0] <= row[free] <= spans[free][1]:
                yield [(p, *key) for p, key in zip(row, keys, strict=True)]


def _under_nature(case: Case, turn: int, mixture: Any) -> Value | None:
    """Return the value at the start where nature makes it as great as it can, or as small."""
    problem = case.problem
    pick = max if turn > 0 else min
    options = [
        [[*_vertices(outcomes)] if outcomes else [[]] for outcomes in actions]
        for actions in problem.moves
    ]
    if problem.layered:
        values: list[Value] = [F(0)] * len(problem.moves)
        for state, value in problem.stopped.items():
            values[state] = value
        for state in reversed(range(len(problem.moves))):
            if state in problem.stopped:
                continue
            worths = []
            for rows in options[state]:
                each = []
                for row in rows:
                    ahead = [values[to] for _, to, _ in row]
                    if any(isinstance(value, float) for value in ahead):
                        each.append(inf)
                    else:
                        rate = problem.discount
                        each.append(sum((p * (r + rate * values[to]) for p, to, r in row), F(0)))
                worths.append(pick(each))
            if mixture is None:
                values[state] = problem.best(worths)
            else:
                values[state] = worths[mixture[state].index(F(1))]
        return oracle.at_start(problem, values)
    policies = [[each.index(F(1)) for each in mixture]] if mixture else list(problem.choices())
    best = list[list[Value]]()
    for choice in policies:
        rows = [
            [[row] for row in options[s][k]] if s not in problem.stopped else [[[(F(1), s, F(0))]]]
            for s, k in enumerate(choice)
        ]
        each = list[list[Value]]()
        for combination in product(*rows):
            there = oracle.replace(problem, moves=list(combination))
            each.append(oracle.evaluate(there, [[F(1)]] * len(combination)))
        best.append([pick(column) for column in zip(*each, strict=True)])
    # One policy, and one choice of nature, are the best in all states.
    return oracle.at_start(problem, [problem.best(column) for column in zip(*best, strict=True)])
