"""Mean, spread, parts, visits and events of a return, beside their equations in fractions."""

import json
from collections.abc import Iterator, Sequence
from dataclasses import replace
from fractions import Fraction as F
from math import inf, isnan, sqrt
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import (
    Chances,
    given,
    law_of_return,
    outcomes_of,
    random_policy,
    small_model,
    with_events,
)

from exact_mdp import MDP, ModelError, SolverError, evaluate, solve
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.claims import Bounded, Status
from exact_mdp.solvers.values.evaluate import Evaluation
from exact_mdp.solvers.values.policy_chain import PolicyEquations

DISCOUNTS = [F(0), F(95, 100), F(1)]


def cases(discount: F, seeds: int = 2, **kind: Any) -> Iterator[tuple[MDP, Chances, Evaluation]]:
    for seed in range(seeds):
        kinds = [{}, {"falling": True}, {"by_outcome": False, "start": int(seed)}]
        for each in [kind] if kind else kinds:
            mdp = with_events(small_model(seed, discount, **each), seed)
            amounts = np.random.default_rng(seed).integers(-9, 10, size=mdp.n_pairs).tolist()
            amounts = [
                0 if mdp.terminal[s] else x for x, s in zip(amounts, mdp.pair_state, strict=True)
            ]
            total = [r for _, _, r, _ in oracle.rows_of(mdp)]
            other = [r - x for r, x in zip(total, amounts, strict=True)]
            mdp = mdp.with_(components={"whole": [*map(F, amounts)], "rest": other})
            chances = random_policy(mdp, seed, pure=seed % 3 == 0)
            yield mdp, chances, evaluate(mdp, given(chances))


def law_of(mdp: MDP, chances: Chances) -> list[oracle.Row]:
    return oracle.mixed(oracle.rows_of(mdp), chances)


def ends_of(mdp: MDP) -> set[int]:
    return set(np.flatnonzero(mdp.terminal).tolist())


def at_start(mdp: MDP, values: Sequence[F]) -> F:
    return sum((p * values[s] for s, p in mdp.start), F(0))


def second_moment(mdp: MDP, chances: Chances, mean: Sequence[F]) -> list[F]:
    """E[(r + γ V')²] + γ² E[Var'], the variance and the square of the mean, state by state."""
    rate, listed = mdp.discount_exact, outcomes_of(mdp, chances)
    earned = [
        sum((p * (r * r + 2 * r * rate * mean[to]) for p, to, r, _ in each), F(0))
        for each in listed
    ]
    rows = [
        (s, 0, e, row[3])
        for s, (e, row) in enumerate(zip(earned, law_of(mdp, chances), strict=True))
    ]
    return oracle.policy_values(rows, rate**2, ends_of(mdp))


def holds(number: Bounded, exact: F, room: float = 1e-9) -> None:
    """Whether a bound is sound, and small."""
    assert abs(F(number.value) - exact) <= F(number.error)
    assert number.error <= room * (1 + abs(float(exact)))


@pytest.mark.parametrize("discount", DISCOUNTS)
def test_mean_and_variance_satisfy_their_equations(discount: F) -> None:
    for mdp, chances, law in cases(discount):
        mean = oracle.policy_values(law_of(mdp, chances), discount, ends_of(mdp))
        for value, error, exact in zip(law.value, law.error, mean, strict=True):
            holds(Bounded(value=value, error=error), exact, 1e-10)
        holds(law.start, at_start(mdp, mean))
        square = second_moment(mdp, chances, mean)
        variance = [float(x - m * m) for x, m in zip(square, mean, strict=True)]
        assert law.variance == pytest.approx(variance, rel=1e-11, abs=1e-11)
        wanted = at_start(mdp, square) - at_start(mdp, mean) ** 2
        holds(law.numbers["variance"], wanted, 1e-8)
        assert law.sd == pytest.approx(sqrt(wanted), rel=1e-10, abs=1e-7)
        number = law.numbers["sd"]
        assert abs(number.value - sqrt(wanted)) <= number.error
        assert (law.settled, law.ends, law.only_means) == (True, True, False)
        assert law.mean == law.numbers["mean"].value


@pytest.mark.parametrize("discount", DISCOUNTS)
def test_steps_and_visits_satisfy_their_equations(discount: F) -> None:
    for mdp, chances, law in cases(discount):
        chain, over = law_of(mdp, chances), ends_of(mdp)
        ones = [(s, 0, F(1), row) for s, _, _, row in chain]
        holds(law.numbers["steps"], at_start(mdp, oracle.policy_values(ones, F(1), over)))
        assert law.steps == law.numbers["steps"].value
        once = [{} if s in over else row for s, _, _, row in chain]
        often = oracle.visits(dict(mdp.start), once)
        assert law.visits == pytest.approx([*map(float, often)], rel=1e-12)
        moves = [{t: discount * p for t, p in row.items()} for row in once]
        often = oracle.visits(dict(mdp.start), moves)
        uses = [F(0)] * mdp.n_pairs
        for (s, a), chance in chances.items():
            stays = 1 if s not in over else 0 if discount == 1 else 1 / (1 - discount)
            uses[mdp.pair(s, a)] = often[s] * chance * stays
        assert law.occupancy == pytest.approx([*map(float, uses)], rel=1e-12)
        table = law.occupancy_table
        assert np.isnan(table).sum() == table.size - mdp.n_pairs
        assert table[mdp.pair_state, mdp.pair_action].tolist() == law.occupancy.tolist()


@pytest.mark.parametrize("discount", DISCOUNTS)
def test_components_are_what_each_earns_alone(discount: F) -> None:
    for mdp, chances, law in cases(discount, 4):
        amounts, below = mdp.table.expected_components_exact()
        for number, name in enumerate(mdp.component_names):
            alone = [
                (s, a, F(int(amounts[pair, number]), int(below[pair])), row)
                for pair, (s, a, _, row) in enumerate(oracle.rows_of(mdp))
            ]
            values = oracle.policy_values(oracle.mixed(alone, chances), discount, ends_of(mdp))
            holds(law.numbers[f"component.{name}"], at_start(mdp, values))
            assert law.components[name] == law.numbers[f"component.{name}"].value


def test_an_event_happens_with_the_chance_of_its_outcomes() -> None:
    for discount in (F(1, 2), F(1)):
        for mdp, chances, law in cases(discount):
            listed = outcomes_of(mdp, chances)
            for bit, name in enumerate(("first", "second")):
                happens = [sum((o[0] for o in each if o[3] >> bit & 1), F(0)) for each in listed]
                others = [
                    {
                        t: sum((o[0] for o in each if o[1] == t and not o[3] >> bit & 1), F(0))
                        for t in {o[1] for o in each}
                    }
                    for each in listed
                ]
                for s in ends_of(mdp):
                    happens[s], others[s] = F(0), {}
                ever = oracle.fixed_point(happens, others)
                holds(law.numbers[f"event.{name}"], at_start(mdp, ever))
                assert law.event_probability[name] == law.numbers[f"event.{name}"].value
            assert law.skip_probability is None


def test_events_of_runs_that_never_end() -> None:
    """From 0 a run may come to a ring, in which the event may happen, or to one in which not."""
    half, rows = F(1, 2), []
    rows += [(0, 0, [(half, 1, 1), (half, 3, 1)]), (1, 0, [(1, 2, 0)])]
    rows += [(2, 0, [(F(1, 100), 1, 0), (F(99, 100), 2, 0)]), (3, 0, [(1, 3, 0)])]
    mdp = MDP.from_outcomes([*rows, (4, 0, [(1, 1, 0)])])
    # Once in a hundred rounds of the ring; and in the end, where nothing happens any more.
    bits = [0, 0, 0, 1, 0, 2, 0]
    table = replace(mdp.table, event=np.array(bits, dtype=np.uint8))
    mdp = mdp.with_(table=table, events=("skip", "never"))
    law = evaluate(mdp, "random")
    assert law.event_probability == {"skip": pytest.approx(0.5), "never": 0}
    assert law.skip_probability == law.event_probability["skip"]


def test_chances_of_events_too_slow_for_floats_are_found_in_rationals() -> None:
    rare = F(1, 2**80)
    rows: Any = [(0, 0, [(rare, 1, 1), (rare, 1, 2), (1 - 2 * rare, 0, 1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows)
    which = [r for _, _, r in mdp.table.row(0)]
    bits = np.array([*(int(r == 2) for r in which), 0], dtype=np.uint8)
    mdp = mdp.with_(table=replace(mdp.table, event=bits), events=("e",))
    law = evaluate(mdp, "random")
    assert law.event_probability == {"e": 0.5}
    assert law.numbers["event.e"].error < 1e-15


def test_errors_of_events_count_roundings() -> None:
    """A chance is rounded once and two are added up; the equation of a state has nine more."""
    for p in (1, 2, 4):
        rows: Any = [(0, 0, [(F(p, 9), 1, 1), (F(9 - p, 9), 1, 3)]), (1, 0, [(1, 1, 0)])]
        mdp = MDP.from_outcomes(rows)
        bits = np.array([*(int(r == 1) for _, _, r in mdp.table.row(0)), 0], dtype=np.uint8)
        mdp = mdp.with_(table=replace(mdp.table, event=bits), events=("e",))
        number = evaluate(mdp, "random").numbers["event.e"]
        holds(number, F(p, 9))
        assert number.error == pytest.approx(12 * 2.0**-53 * p / 9, rel=1e-5, abs=0)


def test_an_event_has_a_probability_of_at_most_1(monkeypatch: pytest.MonkeyPatch) -> None:
    def rounded_up(*_: Any) -> BoundedVector:
        return BoundedVector(value=np.array([1 + 2.0**-52, 0]), error=np.full(2, 2.0**-50))

    mdp = with_events(MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]), 0)
    law = evaluate(mdp, "random")
    monkeypatch.setattr(PolicyEquations, "solve", rounded_up)
    assert {*law.event_probability.values()} == {1}


def test_quantiles_are_those_of_every_run() -> None:
    for mdp, chances, law in cases(F(1), falling=True):
        runs, total, wanted = law_of_return(mdp, chances), F(0), dict[float, F]()
        for value, chance in runs.items():
            total += chance
            for share in (0.05, 0.25, 0.5, 0.75, 0.95):
                if total >= F(str(share)) and share not in wanted:
                    wanted[share] = value
        assert law.quantiles == {share: float(value) for share, value in sorted(wanted.items())}
        assert law.quantiles_missing == ""
        mean = sum(v * p for v, p in runs.items())
        holds(law.start, mean)
        holds(law.numbers["variance"], sum(v * v * p for v, p in runs.items()) - mean**2, 1e-8)
    below = evaluate(small_model(0, "1/2"), "random")
    assert below.quantiles is None
    assert "not on a lattice" in below.quantiles_missing


def test_a_model_of_costs_is_evaluated_as_it_is() -> None:
    mdp = small_model(5, "9/10")
    chances = random_policy(mdp, 5)
    one, other = evaluate(mdp, given(chances)), evaluate(mdp.with_(sense="min"), given(chances))
    assert one.value.tolist() == other.value.tolist()


# ---- runs that do not end ------------------------------------------------------------------------


def test_means_of_runs_that_go_on_are_the_limits_of_discounted_ones() -> None:
    seen = dict.fromkeys([inf, -inf, 0], 0)
    for seed in range(30):
        mdp = small_model(seed, leaving=False, ends=1, states=4, start=seed % 5)
        chances = random_policy(mdp, seed, pure=True)
        total = oracle.total(law_of(mdp, chances))
        law = evaluate(mdp, given(chances))
        known = np.isfinite(law.error)
        reached = law.given.reached
        assert known[reached].all() or not law.settled or isnan(law.mean)
        for state in np.flatnonzero(known).tolist():
            value = law.value[state]
            assert value == pytest.approx(float(total[state]), rel=1e-9, abs=1e-9)
            if reached[state]:
                seen[value if abs(value) == inf else 0] += 1
        if abs(law.mean) == inf:
            assert np.isnan(law.variance).all() == (not law.settled)
    assert min(seen.values()) > 5


RINGS: Any = [  # a state that is left, one that earns for ever, one that loses, one at rest, an end
    (0, 0, [(F(1, 2), 3, 4), (F(1, 2), 4, 2)]),
    (1, 0, [(1, 1, 1)]),
    (2, 0, [(1, 2, -1)]),
    (3, 0, [(1, 3, 0)]),
    (4, 0, [(1, 4, 0)]),
    (5, 0, [(F(1, 2), 1, 7), (F(1, 2), 3, 0)]),
]


def test_a_run_that_comes_to_rest_has_a_return() -> None:
    rows = [*RINGS[:3], (3, 0, [(1, 6, 0)]), *RINGS[4:], (6, 0, [(1, 3, 0)])]
    law = evaluate(MDP.from_outcomes(rows), "random")
    assert law.value[[0, 3, 4, 6]].tolist() == [3, 0, 0, 0]
    assert law.value[[1, 2, 5]].tolist() == [inf, -inf, inf]  # where no episode comes
    assert law.error[[1, 2, 5]].tolist() == [0, 0, 0]
    assert law.error[[0, 3, 4, 6]].max() < 1e-12
    assert law.settled
    assert not law.ends
    assert (law.steps, law.numbers["steps"].error) == (inf, 0)
    assert law.variance[[0, 3, 4, 6]].tolist() == [1, 0, 0, 0]
    assert np.isnan(law.variance[[1, 2, 5]]).all()
    assert law.quantiles == {0.05: 2, 0.25: 2, 0.5: 2, 0.75: 4, 0.95: 4}
    assert law.visits[[0, 3, 4]].tolist() == [1, 0.5, 0.5]


def test_an_infinite_mean_is_all_that_is_known() -> None:
    mdp = MDP.from_outcomes(RINGS, start=5)
    law = evaluate(mdp, "random")
    assert law.mean == inf
    assert not (law.settled and law.ends)
    assert isnan(law.sd)
    assert np.isnan(law.variance).all()
    assert law.numbers["sd"].error == law.numbers["variance"].error == inf
    with pytest.raises(ModelError, match="number of visits is infinite"):
        _ = law.visits
    parts = evaluate(
        mdp.with_(components={"a": [1, 1, 0, 0, 0, 0], "b": [2, 0, -1, 0, 0, "7/2"]}), "random"
    )
    assert parts.components["b"] == 3.5
    assert parts.components["a"] == inf
    assert parts.numbers["component.b"].error < 1e-12


def test_amounts_that_are_counted_for_ever_where_all_is_over() -> None:
    rows: Any = [
        (0, 0, [(F(1, 2), 1, {"a": 1, "b": 1, "c": 1, "d": 3}), (F(1, 2), 2, {"a": 1})]),
        (1, 0, [(1, 1, {"a": 1, "b": -1, "c": 1, "d": -1})]),
        (2, 0, [(1, 2, {"a": 0, "b": -2, "c": -1, "d": 3})]),
        (3, 0, [(1, 3, {"a": 0, "b": 2, "c": -2, "d": 0})]),
    ]
    law = evaluate(MDP.from_outcomes(rows), "random")
    assert law.components["a"] == inf
    assert law.components["b"] == -inf
    assert isnan(law.components["c"])
    assert isnan(law.components["d"])
    single = [*rows[:2], (2, 0, [(1, 2, {"a": 1, "b": -1, "c": 0, "d": 0})]), *rows[3:]]
    law = evaluate(MDP.from_outcomes(single), "random")
    assert law.components["c"] == inf
    assert law.components["d"] == -inf


def test_a_missed_goal_leaves_parts_unknown() -> None:
    rows: Any = [
        (0, 0, [(F(1, 2), 1, {"a": 1, "b": 2}), (F(1, 2), 2, {"a": 1, "b": 2})]),
        (1, 0, [(1, 1, {"a": 0})]),
        (2, 0, [(1, 2, {"a": 0})]),
    ]
    law = evaluate(MDP.from_outcomes(rows, labels={"home": {1}}).until("home"), "random")
    assert law.mean == inf
    assert all(isnan(each) for each in law.components.values())


def test_starts_that_gain_and_lose_for_ever_have_no_mean() -> None:
    mdp = MDP.from_outcomes(RINGS, start={1: "1/2", 2: "1/2"})
    with pytest.raises(ModelError):
        _ = evaluate(mdp, "random").mean


def test_components_of_runs_that_go_on_are_those_of_exact_chances() -> None:
    """Of the floats next to 3/10 and 7/10, seven of the one are not three of the other."""
    assert F(0.3) * 7 != F(0.7) * 3
    rows: Any = [
        (0, 0, [(F(1), 1, {"cancels": 1, "b": 0})]),
        (1, 0, [(F(1), 1, {"cancels": 7, "b": -6})]),
        (1, 1, [(F(1), 1, {"cancels": -3, "b": 4})]),
    ]
    policy = {0: 0, 1: {0: F(3, 10), 1: F(7, 10)}}
    law = evaluate(MDP.from_outcomes(rows), policy)
    assert law.mean == inf
    assert law.components == {"cancels": 1, "b": inf}


def test_rewards_that_cancel_for_ever_have_a_mean() -> None:
    """1, -1, 1, -1, … is worth 1/2 in the limit of discounts, and -1/2 a step later."""
    rows: Any = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, -1)])]
    law = evaluate(MDP.from_outcomes(rows), "random")
    assert law.value.tolist() == pytest.approx([0.5, -0.5])
    assert not law.settled
    assert law.quantiles is None


# ---- floats and their limits ---------------------------------------------------------------------


def test_errors_of_rewards_that_cancel_are_in_the_bound() -> None:
    """10^16 + 1 is no float: half of it less 5 10^15 is 1 / 2, of which floats see nothing."""
    big = 10**16
    rows: Any = [(0, 0, [(1, 1, big + 1)]), (0, 1, [(1, 1, -big)]), (1, 0, [(1, 1, 0)])]
    for discount in (F(1), F(1, 2)):
        law = evaluate(MDP.from_outcomes(rows, discount), "random")
        assert abs(F(law.mean) - F(1, 2)) <= F(law.start.error) < 16


def test_what_cannot_be_bounded_is_unknown_and_the_rest_stands(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def unbounded(*_: Any, **__: Any) -> Any:
        raise SolverError(Status.NO_BOUND)

    (_, _, law), *_ = cases(F(1, 2), 1)
    mean = law.mean
    monkeypatch.setattr(PolicyEquations, "solve", unbounded)
    monkeypatch.setattr(PolicyEquations, "visits", property(unbounded))
    numbers = law.numbers
    assert numbers.pop("mean").value == mean
    assert len(numbers) == 7
    for number in numbers.values():
        assert isnan(number.value)
        assert number.error == inf


def test_variances_beyond_the_range_of_floats_are_unknown() -> None:
    big = F(10) ** 200
    rows: Any = [
        (0, 0, [(F(1, 2), 1, big), (F(1, 2), 1, -big)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 1, 3 * big)]),
    ]
    for start in (0, {1: "1/2", 2: "1/2"}):
        law = evaluate(MDP.from_outcomes(rows, start=start), "random")
        assert isnan(law.numbers["variance"].value)
        assert isnan(law.sd)
        assert law.numbers["sd"].error == inf
        assert abs(law.mean) < inf
    # Each start is certain of its return, and only the spread between them is too large.
    apart: Any = [(0, 0, [(1, 0, 0)]), (1, 0, [(1, 0, F(10) ** 160)])]
    law = evaluate(MDP.from_outcomes(apart, start={0: "1/2", 1: "1/2"}), "random")
    assert law.mean == 5e159
    assert law.variance.max() < inf
    assert isnan(law.numbers["variance"].value)
    assert law.numbers["variance"].error == inf


def test_variances_below_the_range_of_floats_are_in_the_bound() -> None:
    small = F(1, 2**600)
    rows: Any = [(0, 0, [(F(1, 2), 1, small), (F(1, 2), 1, -small)]), (1, 0, [(1, 1, 0)])]
    number = evaluate(MDP.from_outcomes(rows), "random").numbers["variance"]
    assert number.value == 0 < small**2 <= F(number.error)


def test_surprises_too_rare_and_too_great_for_floats_are_unknown() -> None:
    rare = F(1, 10**400)
    rows: Any = [(0, 0, [(rare, 1, 10**200), (1 - rare, 1, 1)]), (1, 0, [(1, 1, 0)])]
    law = evaluate(MDP.from_outcomes(rows), "random")
    assert law.mean == 1
    assert isnan(law.numbers["variance"].value)


def test_components_of_visits_without_a_bound_are_unknown() -> None:
    rows: Any = [(0, 0, [(1, 1, {"a": 1, "b": 0})]), (1, 0, [(1, 2, {"a": 0, "b": 1})])]
    law = evaluate(MDP.from_outcomes([*rows, (2, 0, [(1, 2, {"a": 0})])]), "random")
    vars(law)["_discounted"] = BoundedVector(value=np.ones(3), error=np.array([inf, 0, 0]))
    assert all(isnan(each) for each in law.components.values())


def test_components_beyond_the_range_of_floats_are_unknown() -> None:
    big = F(17, 10) * F(10) ** 308
    amounts = {"a": big, "b": -big, "c": 1}
    rows: Any = [(0, 0, [(1, 1, amounts)]), (1, 0, [(1, 2, amounts)]), (2, 0, [(1, 2, {"a": 0})])]
    law = evaluate(MDP.from_outcomes(rows), "random")
    assert law.mean == 2
    assert law.components["c"] == 2
    for name in "ab":
        assert isnan(law.components[name])
        assert law.numbers[f"component.{name}"].error == inf


def test_a_return_that_is_certain_has_no_spread() -> None:
    rows: Any = [(0, 0, [(1, 1, F(1, 3))]), (1, 0, [(1, 2, F(1, 7))]), (2, 0, [(1, 2, 0)])]
    law = evaluate(MDP.from_outcomes(rows), "random")
    assert law.variance == pytest.approx([0, 0, 0], abs=1e-30)
    assert 0 <= law.sd <= law.numbers["sd"].error < 1e-7
    rows = [(s, a, [(p, t, 0) for p, t, _ in outcomes]) for s, a, outcomes in rows]
    law = evaluate(MDP.from_outcomes(rows), "random")
    assert law.variance.tolist() == [0, 0, 0]
    assert law.numbers["variance"].error < 1e-290


def test_means_over_outcomes_have_no_spread() -> None:
    mdp = MDP.from_arrays([[[F(1, 2), F(1, 2)], [0, 1]]], [[1], [0]])
    averaged = mdp.with_(table=replace(mdp.table, averaged=True))
    law = evaluate(averaged, "random")
    assert law.only_means
    assert np.isnan(law.variance).all()
    assert isnan(law.sd)
    assert law.mean == 2
    assert not evaluate(mdp, "random").only_means


def test_errors_of_variances_cover_those_of_means() -> None:
    """Where means are as far off as their errors, the exact variance is in the bound."""
    for mdp, chances, law in cases(F(1, 2), 3):
        mean = oracle.policy_values(law_of(mdp, chances), F(1, 2), ends_of(mdp))
        square = second_moment(mdp, chances, mean)
        variance = at_start(mdp, square) - at_start(mdp, mean) ** 2
        live = ~mdp.terminal
        for sign in (1, -1):
            for size in (1e-6, 1e-3, 1.0):
                for state in np.flatnonzero(live).tolist():  # one value is off, and no other
                    off = np.where(np.arange(mdp.n_states) == state, size, 0.0)
                    own = Evaluation(
                        chain=law.chain,
                        given=law.given,
                        value=law.value + sign * off,
                        error=law.error + off,
                    )
                    number = own.numbers["variance"]
                    assert abs(F(number.value) - variance) <= F(number.error)
                    assert number.error <= 400 * size * (1 + size + sqrt(variance))


def test_errors_of_variances_count_roundings() -> None:
    """Of two outcomes after which all is over: what each number and each sum may lose."""
    rng, unit = np.random.default_rng(0), 2.0**-53
    for _ in range(20):
        p = int(rng.integers(1, 9))
        pay = rng.integers(-99, 100, size=2).tolist()
        rows: Any = [(0, 0, [(F(p, 9), 1, pay[0]), (F(9 - p, 9), 1, pay[1])]), (1, 0, [(1, 1, 0)])]
        law = evaluate(MDP.from_outcomes(rows), "random")
        mean = (p * pay[0] + (9 - p) * pay[1]) / 9
        own = Evaluation(
            chain=law.chain, given=law.given, value=np.array([mean, 0.0]), error=np.zeros(2)
        )
        number = own.numbers["variance"]
        least = 0.0
        for chance, reward in zip((p / 9, 1 - p / 9), pay, strict=True):
            away = abs(reward - mean)
            least += chance * (6 * unit * away * (abs(reward) + abs(mean)) + 4 * unit * away**2)
        assert least <= number.error <= 4 * least + 1e-290
        # A surprise is off by five roundings, twice of which times itself its square is; the sum of
        # two squares has eight roundings at most, and solving the equation of one state seven.
        whole = 0.0
        for chance, reward in zip((p / 9, 1 - p / 9), pay, strict=True):
            away, off = abs(reward - mean), 5 * unit * (abs(reward) + abs(mean))
            whole += chance * (2 * away * off + 15 * unit * away**2)
        assert number.error == pytest.approx(whole, rel=2e-5, abs=1e-290)
        # What follows is rounded as well: 1000 more, whatever happens first.
        later: Any = [(0, 0, rows[0][2]), (1, 0, [(1, 2, 1000)]), (2, 0, [(1, 2, 0)])]
        law = evaluate(MDP.from_outcomes(later), "random")
        own = Evaluation(
            chain=law.chain, given=law.given, value=np.array([mean + 1000, 1000, 0]),
            error=np.zeros(3),
        )  # fmt: skip
        least = 0.0
        for chance, reward in zip((p / 9, 1 - p / 9), pay, strict=True):
            off = 5 * unit * (abs(reward) + 1000 + abs(mean + 1000))
            least += chance * 2 * abs(reward - mean) * off
        assert least <= own.numbers["variance"].error <= 1.2 * least + 1e-290


def test_a_mixture_of_starts_adds_the_spread_between_them() -> None:
    rows: Any = [(0, 0, [(1, 2, 1)]), (1, 0, [(1, 2, 5)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, start={0: "1/4", 1: "3/4"})
    law = evaluate(mdp, "random")
    own = Evaluation(
        chain=law.chain,
        given=law.given,
        value=np.array([1.0, 5.0, 0.0]),
        error=np.array([0.25, 0.5, 0.0]),
    )
    vars(own)["_variance"] = BoundedVector(
        value=np.array([2.0, 8.0, 0.0]), error=np.array([1.0, 0.5, 0.0])
    )
    number = own.numbers["variance"]
    assert number.value == (2 + 3 * 8) / 4 + (9 + 3 * 1) / 4
    doubt = (0.25 + 3 * 0.5) / 4  # of the mean
    # |a² - b²| ≤ (2 |a| + |a - b|) |a - b|
    low, high = 0.25 + doubt, 0.5 + doubt
    between = ((6 + low) * low + 3 * (2 + high) * high) / 4
    within = (1 + 3 * 0.5) / 4
    assert between + within <= number.error <= (between + within) * (1 + 1e-5)
    # Without errors of the values there are roundings: of a mean over two starts ten, of distances
    # from it two, of squares one, and of the sum of both parts one.
    unit = 2.0**-53
    for pays in ((1.0, 5.0), (0.1, 7.3), (2.0, 2.5)):
        own = replace(own, value=np.array([*pays, 0.0]), error=np.zeros(3))
        vars(own)["_variance"] = BoundedVector(value=np.array([2.0, 8.0, 0.0]), error=np.zeros(3))
        mean, between, doubt = (pays[0] + 3 * pays[1]) / 4, 0.0, 0.0
        for chance, pay in zip((0.25, 0.75), pays, strict=True):
            away = abs(pay - mean)
            between += chance * away**2
            off = unit * (10 * mean + 2 * away)
            doubt += chance * (2 * away * off + unit * away**2)
        number = own.numbers["variance"]
        assert number.value == pytest.approx(6.5 + between)
        assert number.error == pytest.approx(doubt + 11 * unit * (6.5 + between), rel=1e-5, abs=0)


def test_a_deviation_is_between_the_roots() -> None:
    law = evaluate(small_model(0), "random")
    for variance, error in ((4.0, 1.0), (0.25, 0.3), (0.25, 1.0), (9.0, 0.0)):
        own = replace(law)
        vars(own)["_start_variance"] = Bounded(value=variance, error=error)
        number = own.numbers["sd"]
        ends = sqrt(max(variance - error, 0)), sqrt(variance + error)
        assert number.value == own.sd == sqrt(variance)
        off = max(number.value - ends[0], ends[1] - number.value)
        assert off < number.error <= off + 1e-14


def test_visits_are_discounted_where_an_episode_may_not_end() -> None:
    rows: Any = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 0, 1)]), (2, 0, [(1, 2, 0)])]
    law = evaluate(MDP.from_outcomes(rows, "1/2"), "random")
    assert law.visits == pytest.approx([4 / 3, 2 / 3, 0])


def test_amounts_of_actions_that_are_not_taken_do_not_count() -> None:
    rows: Any = [
        (0, 0, [(1, 1, {"a": 1, "b": 1})]),
        (1, 0, [(1, 1, {"a": 1, "b": -1})]),
        (1, 1, [(1, 1, {"a": -1, "b": 1})]),
    ]
    law = evaluate(MDP.from_outcomes(rows), [0, 0])
    assert law.components == {"a": inf, "b": -inf}
    around: Any = [
        (0, 0, [(1, 1, {"a": 1, "b": 1})]),
        (1, 0, [(1, 2, {"a": 1, "b": -1})]),
        (2, 0, [(1, 1, {"a": 0, "b": 0})]),
    ]
    law = evaluate(MDP.from_outcomes(around), [0, 0, 0])  # at rest, in no end
    assert law.mean == 2
    assert law.components == {"a": inf, "b": -inf}


# ---- the ways to ask -----------------------------------------------------------------------------


def test_a_horizon_is_that_of_the_model_within() -> None:
    mdp = small_model(7)
    one, other = evaluate(mdp, "random", horizon=3), evaluate(mdp.within(3), "random")
    assert one.mean == other.mean
    assert one.steps <= 3
    assert evaluate(mdp, "random").mean != one.mean


def test_the_best_policy_has_the_best_value() -> None:
    for discount in (F(1, 2), F(1)):
        mdp = small_model(3, discount)
        assert evaluate(mdp, "optimal").mean == pytest.approx(solve(mdp).start_value)
    rows: Any = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 1)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    assert evaluate(mdp, "optimal", criterion="average").mean == 1
    assert evaluate(mdp, [0, 0, 0], criterion="average").mean == 0
    flat = np.array([[0.25, 0.75], [1, 0], [1, 0]])
    for kind in ("q", "policy"):
        assert evaluate(mdp, flat, kind=kind).read_as == kind
        assert evaluate(mdp, flat, kind=kind, criterion="average").read_as == kind
    with pytest.raises(ModelError):
        evaluate(mdp, [0, 0, 0], criterion="average", horizon=3)


def test_a_report_has_the_numbers_and_their_errors() -> None:
    (mdp, _, law), *_ = cases(F(1), 1, falling=True)
    facts = json.loads(law.report().json())
    assert facts["mean"] == law.mean
    assert facts["error_bounds"] == {name: each.error for name, each in law.numbers.items()}
    assert facts["quantiles"] == {str(share): x for share, x in (law.quantiles or {}).items()}
    assert facts["ends"] is True
    shown = law.report().facts
    for name in ("sd", "steps", "ends", "skip_probability", "event_probability", "components"):
        assert shown[name].value == getattr(law, name)
    assert shown["sd"].text == law.numbers["sd"]
    assert shown["steps"].text == law.numbers["steps"]
    assert shown["quantiles_missing"].value is None
    assert shown["quantiles"].text is None
    tables = law.report().tables
    assert tables["totals"].rows == {
        name: law.numbers[f"component.{name}"] for name in law.components
    }
    assert tables["returns"].rows == [
        {"share": share, "return": value} for share, value in (law.quantiles or {}).items()
    ]
    endless = evaluate(MDP.from_outcomes(RINGS, start=1), "random").report().facts
    assert endless["sd"].text == "undefined: the mean is infinite"
    assert endless["steps"].text == "inf: it may never end"
    below = evaluate(small_model(0, "1/2"), "random")
    assert below.report().facts["quantiles_missing"].value == below.quantiles_missing
    assert below.report().tables["returns"].rows == []
    frame = law.frame()
    assert frame["number"].tolist() == [*law.numbers]
    assert frame["value"].tolist() == [each.value for each in law.numbers.values()]
    assert frame["error"].tolist() == [each.error for each in law.numbers.values()]
    assert mdp.component_names == ("whole", "rest")
