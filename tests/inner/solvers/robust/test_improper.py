"""Robust totals with policies that never end: all policies against all vertices, in fractions."""

import json
from collections.abc import Iterator, Sequence
from fractions import Fraction as F
from itertools import permutations, product
from math import inf, isinf
from random import Random
from typing import Any

import numpy as np
import pytest
from questions import oracle
from questions.oracle import Problem, Value

from exact_mdp import MDP, Intervals, ModelError, SolverError, robust, solve_robust
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.endless.quotient import Quotient, of_pairs
from exact_mdp.solvers.robust.improper import RobustImproperPolicies
from exact_mdp.solvers.robust.likelihood import Likelihood
from exact_mdp.solvers.robust.sets import Ambiguity, L1Ball

Row = list[tuple[F, int, F]]
SIZE = 4
SHARE = F(2, 5)  # of the intervals
RADII = {"l1": F(1, 5), "wide": F(3, 5)}  # in the L1 norm; the second makes outcomes impossible


def vertices(row: Row, kind: str) -> Iterator[Row]:
    """Yield the vertices of the set of distributions around a row."""
    if len(row) == 1:
        yield row
    elif kind in RADII:
        # One outcome gets what the others lose, one after the other.
        for gains, *losing in permutations(range(len(row))):
            left, moved = RADII[kind] / 2, [p for p, *_ in row]
            for k in losing:
                taken = min(left, moved[k])
                left, moved[k], moved[gains] = left - taken, moved[k] - taken, moved[gains] + taken
            yield [(q, to, r) for q, (_, to, r) in zip(moved, row, strict=True) if q]
    else:
        for free in range(len(row)):
            for ends in product((1 - SHARE, 1 + SHARE), repeat=len(row) - 1):
                others = iter(ends)
                moved = [F(0) if k == free else p * next(others) for k, (p, *_) in enumerate(row)]
                moved[free] = 1 - sum(moved)
                if abs(moved[free] - row[free][0]) <= SHARE * row[free][0]:
                    yield [(q, to, r) for q, (_, to, r) in zip(moved, row, strict=True)]


def draw_mixed_policy(problem: Problem, rng: Random) -> tuple[list[list[F]], dict[int, Any]]:
    """Return the probability of each action, by number and by name."""
    policy = list[list[F]]()
    for actions in problem.moves:
        share = rng.choice((F(0), F(1), F(1, 2), F(1, 3)))
        policy.append([share, 1 - share] if len(actions) == 2 else [F(1)])
    mixed = {
        s: {str(a): share for a, share in enumerate(shares) if share}
        for s, shares in enumerate(policy)
    }
    return policy, mixed


def random_problem(rng: Random) -> Problem:
    """Return a problem of three states and an end, with or without a goal."""
    moves = list[list[Row]]()
    low, high = rng.choice(((-2, 0), (0, 2), (-2, 2), (-3, 1)))
    for _ in range(SIZE - 1):
        actions = list[Row]()
        for _ in range(rng.choice((1, 2, 2))):
            count = rng.choice((1, 1, 2, 2, 3))
            weights = [rng.randint(2, 4) for _ in range(count)]
            targets = sorted(rng.sample(range(SIZE), count))
            once, apart = F(rng.randint(low, high)), rng.random() < 0.3
            amounts = [F(rng.randint(low, high)) if apart else once for _ in targets]
            if rng.random() < 0.3:
                amounts = [F(0) for _ in targets]
            actions.append(
                [
                    (F(w, sum(weights)), *each)
                    for w, *each in zip(weights, targets, amounts, strict=True)
                ]
            )
        moves.append(actions)
    moves.append([[(F(1), SIZE - 1, F(0))]])
    stopped, missed = dict[int, Value](), None
    if rng.random() < 0.4:
        stopped, missed = {SIZE - 1: F(0)}, inf
    return Problem(moves, F(1), {0: F(1)}, rng.choice(("max", "min")), stopped, missed)


def model_of(problem: Problem, start: int) -> MDP:
    """Return the model of the toolkit."""
    rows = [
        (s, a, outcomes) for s, each in enumerate(problem.moves) for a, outcomes in enumerate(each)
    ]
    labels = {"goal": [SIZE - 1]}
    mdp = MDP.from_outcomes(rows, 1, start=start, sense=problem.sense, labels=labels)
    if problem.missed is None:
        return mdp
    return mdp.until("goal")


def set_of(mdp: MDP, kind: str) -> Ambiguity:
    """Return the set of one kind."""
    if kind in RADII:
        return L1Ball(radius=RADII[kind])
    return Intervals.relative(mdp, SHARE)


def under_nature(
    problem: Problem, kind: str, nature: str, policy: Sequence[Sequence[F]]
) -> list[Value]:
    """Return the values of a policy against nature's best vertices, state by state."""
    worst = min if (problem.sense == "max") == (nature == "worst") else max
    each = list[list[Value]]()
    options = [
        [[*vertices(row, kind)] if share else [row] for row, share in zip(a, shares, strict=True)]
        for a, shares in zip(problem.moves, policy, strict=True)
    ]
    for rows in product(*(product(*per_state) for per_state in options)):
        moved = oracle.replace(problem, moves=[list(actions) for actions in rows])
        each.append(oracle.evaluate(moved, policy))
    return [worst(column) for column in zip(*each, strict=True)]


def assert_same(found: Any, wanted: Sequence[Value], state: int) -> None:
    """Compare the value of a state with the exact one, within the error that is stated."""
    value, error = float(found.value[state]), float(found.state_error[state])
    if isinstance(wanted[state], float):
        assert value == wanted[state]
    else:
        assert error < 1e-7
        assert abs(F(value) - wanted[state]) <= F(error)


@pytest.mark.parametrize("nature", ["worst", "best"])
@pytest.mark.parametrize("kind", ["interval", "l1", "wide"])
def test_values_are_those_of_all_policies_against_all_vertices(kind: str, nature: str) -> None:
    answered = infinite = 0
    for seed in range(18):
        rng = Random(seed)
        problem = random_problem(rng)
        mdp = model_of(problem, SIZE - 1)
        policies = [oracle.pure(problem, choice) for choice in problem.choices()]
        values = [under_nature(problem, kind, nature, policy) for policy in policies]
        wanted = [problem.best(column) for column in zip(*values, strict=True)]
        try:
            found = solve_robust(mdp, set_of(mdp, kind), nature=nature)
        except (ModelError, SolverError):
            continue
        answered += 1
        taken = [int(found.policy.rule[state]) for state in range(SIZE)]
        own = under_nature(problem, kind, nature, oracle.pure(problem, taken))
        for state in range(SIZE):
            # Costs that fall without end before the goal have no minimum among policies.
            falls = problem.missed is not None and found.value[state] == -inf
            if falls and problem.sense == "min":
                continue
            assert_same(found, wanted, state)
            assert own[state] == wanted[state]
            infinite += isinf(found.value[state])
    if kind == "wide":
        assert answered >= 4
        return
    assert answered >= 15
    assert infinite >= 5


@pytest.mark.parametrize("nature", ["worst", "best"])
@pytest.mark.parametrize("kind", ["interval", "l1", "wide"])
def test_a_policy_is_worth_what_nature_leaves_it(kind: str, nature: str) -> None:
    answered = mixes = 0
    for seed in range(16):
        rng = Random(f"policy {seed}")
        problem = random_problem(rng)
        mdp = model_of(problem, SIZE - 1)
        policy, mixed = draw_mixed_policy(problem, rng)
        try:
            found = solve_robust(mdp, set_of(mdp, kind), nature=nature, policy=mixed)
        except (ModelError, SolverError):
            continue
        wanted = under_nature(problem, kind, nature, policy)
        for state in range(SIZE):
            assert_same(found, wanted, state)
        answered += 1
        mixes += any(len(shares) > 1 and 0 < shares[0] < 1 for shares in policy)
    assert answered >= (4 if kind == "wide" else 12)
    assert mixes >= (1 if kind == "wide" else 5)


# ---- sets and cases by hand ----------------------------------------------------------------------


def way_out(leaves: Any, cost: Any = 1, sense: str = "min") -> MDP:
    """State 0 costs something and is left with some probability; action 1 stays for good."""
    rows = [
        (0, 0, [(leaves, 1, cost), (1 - F(leaves), 0, cost)]),
        (0, 1, [(1, 0, cost)]),
        (1, 0, [(1, 1, 0)]),
    ]
    return MDP.from_outcomes(rows, sense=sense, labels={"goal": [1]})


def test_the_cost_of_a_way_out_is_what_nature_leaves_of_its_probability() -> None:
    """1 / p with p within 1/2 ± 1/10, or with p (1 - p) = e^-2β / 4 at the edge of a region."""
    mdp = way_out("1/2")
    edge = np.sqrt(1 - np.exp(-2 * 0.01)) / 2
    for sets, low, high in (
        (Intervals.relative(mdp, "1/5"), 0.4, 0.6),
        (L1Ball(radius="1/5"), 0.4, 0.6),
        (Likelihood(radius="1/100"), 0.5 - edge, 0.5 + edge),
    ):
        for model in (mdp, mdp.until("goal")):
            for nature, p in (("worst", low), ("best", high)):
                found = solve_robust(model, sets, nature=nature)
                assert found.value[0] == pytest.approx(1 / p, abs=1e-9)
                assert found.policy.rule[0] == 0
                assert found.transition.toarray()[0] == pytest.approx([1 - p, p])
                assert found.reward[0] == pytest.approx(1)
                held = solve_robust(model, sets, nature=nature, policy=[1, 0])
                assert (held.value[0], held.state_error[0], held.pairs) == (inf, 0, None)


def test_a_policy_that_never_ends_is_infinitely_worse_than_one_that_does() -> None:
    mdp = way_out("1/2")
    found = robust(mdp, policy=[1, 0])
    assert [found.value.value, found.worst.value, found.best.value] == [inf] * 3
    assert (found.price.value, found.price.error) == (-inf, 0)
    assert (found.gain.value, found.gain.error) == (inf, 0)
    assert found.robust.start.value == pytest.approx(2.5)
    # Where no policy ends, there is nothing to gain.
    lost = robust(way_out("1/2", sense="max"))
    assert (lost.robust.start.value, lost.price, lost.gain) == (inf, None, None)
    told = json.loads(lost.report().json())
    assert (told["price_of_robustness"], told["worst_case"]["value"]) == (None, "inf")
    assert "price" not in str(lost.report().lines())


def test_sets_that_can_close_a_way_are_refused() -> None:
    mdp = way_out("1/2")
    for sets in (L1Ball(radius=1), Intervals.relative(mdp, 1)):
        with pytest.raises(ModelError, match="an outcome is impossible"):
            solve_robust(mdp, sets)
    assert solve_robust(mdp.with_(discount="1/2"), L1Ball(radius=1)).value[0] == pytest.approx(2)


def test_nature_may_decide_whether_a_component_gains() -> None:
    """Going round earns 3 p - 1 in the mean, p within 1/3 ± a share: 0 is between for any share."""

    def going_round(p: Any) -> MDP:
        rows = [(0, 0, [(p, 0, 2), (1 - F(p), 0, -1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows)

    for p, share, worst, best in (
        ("1/3", "1/10", 0, inf),
        ("1/2", "1/10", inf, inf),
        ("1/5", "1/10", 0, 0),
    ):
        mdp = going_round(p)
        sets = Intervals.relative(mdp, share)
        assert solve_robust(mdp, sets).value[0] == worst
        assert solve_robust(mdp, sets, nature="best").value[0] == best
    with pytest.raises((ModelError, SolverError)):
        solve_robust(going_round("1/3"), Intervals.relative(going_round("1/3"), 0))


def test_pairs_are_left_out_only_if_they_are_worth_less() -> None:
    """Three ways to go on: leave with 1/2, leave with 1/4, and stay; each costs 1 a step."""
    rows = [
        (0, 0, [("1/2", 1, -1), ("1/2", 0, -1)]),
        (0, 1, [("1/4", 1, -1), ("3/4", 0, -1)]),
        (0, 2, [(1, 0, -1)]),
        (1, 0, [(1, 1, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    sets = Intervals.relative(mdp, "1/5")
    improper = RobustImproperPolicies.of(mdp, sets, against=True, weights=None)
    whole = improper.apply()
    assert whole.source.tolist() == [0, 1, 2, 4]
    assert 2 not in improper.omit_losing_pairs(whole).source
    for kept, value in ((0, -1 / 0.4), (1, -1 / 0.2)):
        chosen = np.array([kept, 3])
        part = Quotient(
            mdp=of_pairs(whole.mdp, chosen), new_state=whole.new_state, source=whole.source[chosen]
        )
        found = BoundedVector(value=np.array([value, 0.0]), error=np.array([1e-12, 0.0]))
        if kept == 0:
            improper.require_losses(whole, part, found)
            continue
        with pytest.raises(SolverError, match="loses too little"):
            improper.require_losses(whole, part, found)


@pytest.mark.parametrize("against", [True, False])
def test_gains_are_those_of_the_worst_and_the_best_rows(*, against: bool) -> None:
    """A round of 0 and 1 earns 2 and loses 1 / p; a round of 2 and 3 loses more than it earns."""
    rows = [
        (0, 0, [(1, 1, 2)]),
        (1, 0, [("1/2", 0, -1), ("1/2", 1, -1)]),
        (2, 0, [(1, 3, 1)]),
        (3, 0, [("1/4", 2, -1), ("3/4", 3, -1)]),
    ]
    mdp = MDP.from_outcomes(rows)
    # The first round loses between 5/3 and 5/2, the second between 10/3 and 5.
    sets = Intervals.relative(mdp, "1/5")
    improper = RobustImproperPolicies.of(mdp, sets, against=against, weights=None)
    assert improper.gains[0].tolist() == [-1 if against else 1] * 2 + [-1, -1]
    assert improper.sign.tolist() == improper.gains[0].tolist()
    assert improper.applies
    found = solve_robust(mdp, sets, nature="worst" if against else "best")
    assert found.value.tolist() == [(-inf if against else inf)] * 2 + [-inf] * 2
