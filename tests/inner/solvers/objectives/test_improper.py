"""Totals of policies of which some never end, or miss a goal, beside all deterministic policies."""

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction as F
from itertools import chain, product
from math import inf

import numpy as np
import pytest
from objective_models import best_under, vertices
from oracle import each_choice, fixed_point, rows_of

from exact_mdp import MDP, ModelError, Policy, check, rationalize, solve, tradeoff
from exact_mdp.analysis.tradeoffs.front import Front
from exact_mdp.solvers.objectives.amounts import Objectives
from exact_mdp.solvers.objectives.totals import OccupancyMeasure, evaluate_objectives, flow_of

NAMES = ["a", "b"]
Totals = tuple[F, ...] | None  # of a policy; None if they are not finite


def models(seed: int) -> Iterator[MDP]:
    """Questions about a model in which staying often loses, now and then for nothing or a gain."""
    rng, rows = np.random.default_rng(seed), list[tuple[int, int, object]]()
    amounts = [-3, -2, -1, 0, 0, 0] if seed % 3 else [-2, -1, 0, 0, 1]
    parts = {name: list[int]() for name in NAMES}
    for s in range(4):
        for a in range(int(rng.integers(1, 4))):
            targets = sorted(rng.choice(6, size=int(rng.integers(1, 3)), replace=False).tolist())
            both = [0, 0] if rng.random() < 0.3 else rng.choice(amounts, 2).tolist()
            for own, amount in zip(parts.values(), both, strict=True):
                own.append(amount)
            rows.append((s, a, [(F(1, len(targets)), t, sum(both)) for t in targets]))
    rows += [(4, 0, [(1, 4, 0)]), (5, 0, [(1, 5, 0)])]
    parts = {name: [*own, 0, 0] for name, own in parts.items()}
    start = {0: F(1, 2), 1: F(1, 2)} if seed % 2 else {0: F(1)}
    mdp = MDP.from_outcomes(rows, 1, components=parts, start=start)
    mdp = mdp.with_(labels={"goal": [False] * 4 + [True, False]})
    costs = mdp.negated()
    yield from (mdp, costs, costs.until("goal"), costs.until("goal").within(3))
    yield mdp.reaching("goal")


def amounts_of(mdp: MDP, name: str) -> list[F]:
    if name == "reward":
        top, below = mdp.table.expected_gain_exact
    else:
        top, below = mdp.component(name)
    return [F(int(x), int(y)) for x, y in zip(top, below, strict=True)]


def recurrent(mdp: MDP, choice: tuple[int, ...]) -> Iterator[set[int]]:
    """The recurrent classes of a policy."""
    after = [{s} for s in range(mdp.n_states)]
    law = [set(row[3]) for row in rows_of(mdp, choice)]
    for _ in range(mdp.n_states):
        after = [own.union(*(law[t] for t in own)) for own in after]
    for s, own in enumerate(after):
        if all(s in after[t] for t in own) and s == min(own):
            yield own


def gain(mdp: MDP, choice: tuple[int, ...], inside: set[int], amounts: list[F]) -> F:
    """The mean amount in a class: the total until the first state is met again, by its length."""
    states = sorted(inside)
    first, others = states[0], states[1:]
    law = [row[3] for row in rows_of(mdp, choice)]
    moves = [{others.index(t): p for t, p in law[s].items() if t != first} for s in others]

    def until_back(each: list[F]) -> F:
        ahead = fixed_point([each[s] for s in others], moves) if others else []
        return each[first] + sum(
            (p * ahead[others.index(t)] for t, p in law[first].items() if t != first), F(0)
        )

    earned = [amounts[pair] for pair in choice]
    return until_back(earned) / until_back([F(1)] * mdp.n_states)


def totals_of(mdp: MDP, choice: tuple[int, ...], amounts: list[list[F]]) -> Totals:
    """The totals of a policy from the start, None if a run may go on or miss the goal."""
    law = [row[3] for row in rows_of(mdp, choice)]
    met = {s for s, p in mdp.start if p}
    for _ in range(mdp.n_states):
        met = met.union(*(law[s] for s in met))
    over = set[int]()
    for inside in recurrent(mdp, choice):
        idle = all(own[choice[s]] == 0 for s in inside for own in amounts)
        if mdp.goal is not None:
            idle = all(mdp.goal[s] for s in inside)
        if met & inside and not idle:
            return None
        over |= inside
    live = [s for s in range(mdp.n_states) if s in met and s not in over]
    moves = [{live.index(t): p for t, p in law[s].items() if t in live} for s in live]
    found = []
    for own in amounts:
        values = dict(zip(live, fixed_point([own[choice[s]] for s in live], moves), strict=True))
        found.append(sum((p * values.get(s, F(0)) for s, p in mdp.start), F(0)))
    return tuple(found)


def may_grow(mdp: MDP, choice: tuple[int, ...], amounts: list[list[F]], sign: int) -> bool:
    return any(
        sign * gain(mdp, choice, inside, own) > 0
        for inside in recurrent(mdp, choice)
        for own in amounts
    )


def cancels(mdp: MDP, choice: tuple[int, ...], amounts: list[list[F]]) -> bool:
    return any(
        any(own[choice[s]] for s in inside for own in amounts)
        and all(gain(mdp, choice, inside, own) == 0 for own in amounts)
        for inside in recurrent(mdp, choice)
    )


def answer_or_refusal(mdp: MDP, names: list[str]) -> tuple[str, Front | None]:
    try:
        return "", tradeoff(mdp, names)
    except ModelError as error:
        return error.what, None


def test_fronts_are_those_of_all_policies_with_finite_totals() -> None:
    answered = dict.fromkeys(range(5), 0)
    for seed in range(40):
        for number, mdp in enumerate(models(seed)):
            names = ["reward", "quick=-1*reward"] if number == 4 else NAMES
            amounts = [amounts_of(mdp, "reward" if number == 4 else name) for name in names]
            if number == 4:
                amounts[1] = [-x for x in amounts[1]]
            sign, choices = mdp.sense.sign, [*each_choice(mdp)] if number != 3 else []
            said, front = answer_or_refusal(mdp, names)
            if front is None:
                if number == 3:
                    assert "no policy from the start" in said
                elif "grow forever" in said:
                    assert any(may_grow(mdp, each, amounts, sign) for each in choices)
                elif "cancel" in said:
                    assert any(cancels(mdp, each, amounts) for each in choices)
                else:
                    assert "no policy from the start" in said
                    assert {totals_of(mdp, each, amounts) for each in choices} == {None}
                continue
            assert front.violations() == []
            answered[number] += front.of.reduced
            if number == 3:  # too many policies to list: those of a model without a time
                continue
            each = {choice: totals_of(mdp, choice, amounts) for choice in choices}
            finite = [point for point in each.values() if point is not None]
            assert front.vertices == sorted(vertices(finite, sign))
            for vertex, policy in zip(front.vertices, front.policies, strict=True):
                taken = tuple(int(mdp.pair(s, int(a))) for s, a in enumerate(policy))
                assert each[taken] == vertex
            for choice, point in list(each.items())[:8]:
                actions = mdp.pair_action[list(choice)]
                if point is None:
                    with pytest.raises(ModelError, match="its totals are not finite"):
                        front.totals(actions)
                else:
                    assert front.totals(actions) == point
    assert min(answered.values()) > 5


def test_weights_make_a_policy_as_good_as_all_with_finite_totals() -> None:
    count = 0
    for seed in range(40):
        for mdp in [*models(seed)][:3]:
            amounts, sign = [amounts_of(mdp, name) for name in NAMES], mdp.sense.sign
            try:
                of = Objectives(mdp, NAMES)
            except ModelError:
                continue
            each = {choice: totals_of(mdp, choice, amounts) for choice in each_choice(mdp)}
            own, point = next((c, p) for c, p in each.items() if p is not None)
            found = rationalize(mdp, mdp.pair_action[list(own)])
            assert found.violations() == []
            assert flow_of(of, mdp.pair_action[list(own)]).compute_totals(of) == tuple(
                sign * x for x in point
            )

            def lost(weights: list[F], point=point, each=each, sign=sign) -> F:
                return max(
                    sum((w * sign * (y - x) for w, x, y in zip(weights, point, other, strict=True)),
                        F(0))
                    for other in each.values() if other is not None
                )  # fmt: skip

            weights = [found.weights[name] for name in NAMES]
            assert lost(weights) == 0
            assert found.change == max(abs(w - 1) for w in weights)
            step = F(99, 100) * found.change
            for one in (-step, F(0), step):
                for other in (-step, F(0), step):
                    assert not found.change or lost([1 + one, 1 + other]) > 0
            count += of.reduced and found.change > 0
            for k, name in enumerate(NAMES):
                span = found.alone[name]
                for x in (F(0), F(1, 2), F(1), F(3)):
                    inside = span is not None and span[0] <= x <= span[1]
                    assert inside == (lost([x if i == k else F(1) for i in range(2)]) == 0)
    assert count > 5


def test_optima_under_limits_are_mixtures_of_policies_with_finite_totals() -> None:
    feasible, mixed, infeasible, remembers = 0, 0, 0, 0
    for mdp in chain.from_iterable([*models(seed)][:3] for seed in range(40)):
        amounts = [amounts_of(mdp, name) for name in ("reward", *NAMES)]
        choices, sense = [*each_choice(mdp)], mdp.sense.sign
        points = {totals_of(mdp, each, amounts) for each in choices} - {None}
        for a, b in product((">= -2", "<= -1"), (">= -4", ">= 0")):
            signs = {"a": 1 if a[0] == ">" else -1, "b": 1}
            try:
                found = solve(mdp, subject_to={"a": a, "b": b})
            except ModelError as error:
                if "grow forever" in str(error):
                    turned = [
                        amounts[0],
                        [sense * signs["a"] * x for x in amounts[1]],
                        [sense * x for x in amounts[2]],
                    ]
                    assert any(may_grow(mdp, each, turned, sense) for each in choices)
                remembers += "has to remember" in str(error)
                continue
            assert found.violations() == []
            limits = [(1, signs["a"], F(a[3:])), (2, 1, F(b[3:]))]
            best = best_under([*points], limits, sense)
            assert found.start_value == best
            infeasible += best is None
            own = flow_of(found.of, found.policy).compute_totals(found.of)
            assert [sense * x for x in own[1:]] == [found.totals["a"], found.totals["b"]]
            if best is not None:
                assert sense * own[0] == best
                feasible += found.of.reduced
            mixed += found.of.reduced and bool(found.randomises)
    assert min(feasible, mixed, infeasible) > 3
    assert remembers


def test_a_policy_that_has_to_remember_is_none() -> None:
    """Half of the runs stay in state 0 for nothing: the others leave, at once or later."""
    rows = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, 1, components={"a": [0, 3, 0], "b": [0, -2, 0]})
    assert solve(mdp, subject_to={"b": ">= -2"}).start_value == 1
    with pytest.raises(ModelError, match="has to remember") as refused:
        solve(mdp, subject_to={"b": ">= -1"})
    assert refused.value.where == "state 0"
    with pytest.raises(ModelError, match="a regret under limits"):
        check(mdp, [1, 0], subject_to={"b": ">= -2"})


def test_ties_are_not_broken_by_more_of_what_has_to_be_kept_low() -> None:
    """To wait in state 0 earns nothing, and counts b without limit."""
    for gain in (0, 2):
        rows = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, gain)]), (1, 0, [(1, 1, 0)])]
        mdp = MDP.from_outcomes(rows, 1, components={"a": [-1, gain, 0], "b": [1, 0, 0]})
        best = solve(mdp, subject_to={"b": "<= 1"})
        assert (best.start_value, best.totals, best.violations()) == (gain, {"b": 0}, [])
        assert best.rule[0].tolist() == [0, 1]
        with pytest.raises(ModelError, match="grow forever"):
            solve(mdp, subject_to={"b": ">= 1"})


LOOPS = MDP.from_outcomes(  # each way to the end is cheap in one total; the states are next door
    [
        (0, 0, [(1, 1, 2)]),
        (0, 1, [(1, 2, 9)]),
        (1, 0, [(1, 0, 2)]),
        (1, 1, [(1, 2, 9)]),
        (2, 0, [(1, 2, 0)]),
    ],
    components={"a": [1, 9, 1, 0, 0], "b": [1, 0, 1, 9, 0]},
    sense="min",
)


def test_a_way_there_and_the_way_back_are_each_taken_by_some_vertex() -> None:
    front = tradeoff(LOOPS, ["a", "b"])
    assert front.vertices == [(1, 10), (9, 0)]
    assert tradeoff(LOOPS.with_(start=1), ["a", "b"]).vertices == [(0, 9), (10, 1)]
    both = LOOPS.with_(start={0: "1/2", 1: "1/2"})
    wanted = [(F(1, 2), F(19, 2)), (F(9, 2), F(9, 2)), (F(19, 2), F(1, 2))]
    assert tradeoff(both, ["a", "b"]).vertices == wanted


SIDE = MDP.from_outcomes(  # one may wait in state 1, at a cost, which is on no cheap way
    [
        (0, 0, [(1, 2, 1)]),
        (0, 1, [(1, 1, 1)]),
        (1, 0, [(1, 2, 1)]),
        (1, 1, [(1, 1, 1)]),
        (2, 0, [(1, 3, 0)]),
        (3, 0, [(1, 3, 0)]),
    ],
    components={"a": [1, 1, 1, 1, 0, 0]},
    sense="min",
)


def test_a_proof_about_policies_that_do_not_end_is_none() -> None:
    front = tradeoff(LOOPS, ["a", "b"])
    vertex = front.attained[0]
    pairs = vertex.pairs.copy()
    mdp = front.of.mdp
    round_trip = [int(mdp.pairs_of(s)[0]) for s in range(mdp.n_states)]
    pairs[:] = round_trip
    bad = replace(front, attained=(replace(vertex, pairs=pairs), *front.attained[1:]))
    assert "a policy of the proof never ends" in bad.violations()
    with pytest.raises(ModelError, match="only models in which every policy ends"):
        front.save("front.json")
    # Visits of a circle that the start does not lead to balance, too.
    own = rationalize(SIDE, [0, 0, 0, 0])
    assert own.violations() == []
    mdp, visits = own.of.mdp, own.flow.to_numbers()
    circle = [
        pair for pair in range(mdp.n_pairs) if mdp.table.row(pair)[0][1] == mdp.pair_state[pair]
    ]
    visits[next(pair for pair in circle if not mdp.terminal[mdp.pair_state[pair]])] = F(2)
    worse = replace(own, flow=OccupancyMeasure.of(visits))
    assert "visits cannot be reached from the start" in worse.violations()


def test_a_policy_may_stay_where_nothing_is_counted_or_leave() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (1, 0, [(1, 0, 0)]), (1, 1, [(1, 2, 1)]), (2, 0, [(1, 2, 0)])]
    parts = {"a": [0, 0, 3, 0], "b": [0, 0, -2, 0]}
    mdp = MDP.from_outcomes(rows, 1, components=parts)
    front = tradeoff(mdp, ["a", "b"])
    assert front.vertices == [(0, 0), (3, -2)]
    assert [policy.tolist() for policy in front.policies] == [[0, 0, 0], [0, 1, 0]]
    half = Policy(
        space=mdp.space, actions=mdp.actions, rule=np.array([[1.0, 0.0], [0.5, 0.5], [1.0, 0.0]])
    )
    assert front.totals(half) == (3, -2)
    assert evaluate_objectives(front.of, front.of.first).total in ((0, 0), (3, -2))
    assert rationalize(mdp, [0, 0, 0]).alone["a"] == (0, F(2, 3))
    assert rationalize(mdp, [0, 1, 0]).alone["a"] == (F(2, 3), inf)
