"""The best policy that reads some columns, beside all of them in fractions."""

from collections.abc import Iterator
from fractions import Fraction as F
from itertools import product
from math import inf
from types import SimpleNamespace
from typing import Any

import numpy as np
import oracle
import pytest

from exact_mdp import MDP, Column, ModelError, StateSpace, best_policy, certify
from exact_mdp.analysis.gate import columns as module
from exact_mdp.analysis.gate.columns import (
    AverageRows,
    Cycles,
    EndlessRows,
    PolicyRows,
    _BranchAndBound,
)
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.bounds.bounds import margin_weights
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.endless.quotient import of_pairs
from exact_mdp.solvers.values.layers import Layers, find_taken_pairs


def in_columns(seed: int, *, cyclic: bool, sense: str = "max") -> MDP:
    """Two rows at each of two times, and an end; of a few states some actions are missing."""
    rng, rows = np.random.default_rng(seed), list[Any]()
    for s in range(4):
        actions = [0, 1, 2] if s % 2 == seed % 2 else [0, 2]
        for a in actions:
            targets = range(5) if cyclic else ([2, 3, 4] if s < 2 else [4])
            weights = rng.integers(0, 4, size=len(targets)).tolist()
            weights[-1] += 1
            law = [
                (F(w, sum(weights)), t, F(int(rng.integers(-6, 7)), 2))
                for w, t in zip(weights, targets, strict=True)
                if w
            ]
            rows.append((s, a, law))
    rows.append((4, 0, [(1, 4, 0)]))
    space = StateSpace(
        columns=(Column(name="time", size=2), Column(name="row", size=2)), extra=("end",)
    )
    start = {0: F(1, 2), 1: F(1, 2)}
    mdp = MDP.from_outcomes(rows, F(9, 10) if cyclic or seed % 3 else 1, start=start)
    return mdp.with_(space=space, sense=sense)


def worth(mdp: MDP, key: Integers, choice: Any) -> F | None:
    """The exact value at the start of one action a row; None where a state does not offer it."""
    rows = []
    for s in range(mdp.n_states):
        named = {int(mdp.pair_action[pair]): pair for pair in mdp.pairs_of(s)}
        action = choice[key[s]] if len(named) > 1 else min(named)
        if action not in named:
            return None
        rows.append(named[action])
    value = oracle.policy_values(oracle.rows_of(mdp, rows), mdp.discount_exact, {4})
    return sum((p * value[s] for s, p in mdp.start), F(0))


def every_choice(mdp: MDP, rows: PolicyRows) -> Iterator[tuple[tuple[int, ...], F]]:
    for choice in product(range(mdp.n_actions), repeat=rows.space.size):
        value = worth(mdp, rows.key, choice)
        if value is not None:
            yield choice, value


@pytest.mark.parametrize("cyclic", [True, False])
@pytest.mark.parametrize("read", [("row",), ("time",), ()])
def test_no_policy_that_reads_the_columns_is_better(cyclic: bool, read: tuple[str, ...]) -> None:
    for seed in range(5):
        for sense in ("max", "min"):
            mdp = in_columns(seed, cyclic=cyclic, sense=sense)
            rows = PolicyRows(mdp, read)
            found = best_policy(mdp, read)
            pick = max if sense == "max" else min
            exact = pick(value for _, value in every_choice(mdp, rows))
            assert abs(F(found.value.value) - exact) <= F(found.error) <= F(1, 10**9)
            assert found.proven
            assert mdp.sense.sign * (F(found.upper_bound) - exact) >= 0
            assert abs(found.upper_bound - float(exact)) < 1e-9
            assert mdp.sense.sign * (F(found.mixed_upper_bound) - exact) >= 0
            full, _ = oracle.solve_exact(
                5,
                [(s, a, mdp.sense.sign * r, law) for s, a, r, law in oracle.rows_of(mdp)],
                mdp.discount_exact,
            )
            most = mdp.sense.sign * sum((p * full[s] for s, p in mdp.start), F(0))
            assert mdp.sense.sign * (F(found.mixed_upper_bound) - most) <= F(1, 10**8)
            assert worth(mdp, rows.key, rows.choices_of(found.policy)) == exact
            assert found.columns == read
            labels = [rows.space.label(k) or "all states" for k in range(rows.space.size)]
            assert [*found.actions] == [
                label for k, label in enumerate(labels) if rows.available[k].any()
            ]
            assert found.frame()["action"].tolist() == [*found.actions.values()]


def test_rows_offer_what_all_their_states_do() -> None:
    for seed in range(4):
        mdp = in_columns(seed, cyclic=False)
        for read in (("row",), ("time",), ("time", "row"), ()):
            rows = PolicyRows(mdp, read)
            for k in range(rows.space.size):
                own = [s for s in range(4) if rows.key[s] == k]
                offered = [{*mdp.pair_action[mdp.pairs_of(s)].tolist()} for s in own]
                common = set.intersection(*offered) if own else set[int]()
                assert set(np.flatnonzero(rows.available[k]).tolist()) == common
            later = PolicyRows(mdp.with_(start=2), read)
            met = {int(later.key[s]) for s in (2,)}
            assert set(np.flatnonzero(later.must_choose).tolist()) == met or "time" not in read
            assert later.must_choose.shape == (later.space.size,)
    rows_of: Any = [
        (0, 0, [(1, 2, 1)]),
        (0, 1, [(1, 2, 1)]),
        (1, 1, [(1, 2, 1)]),
        (1, 2, [(1, 2, 2)]),
    ]
    apart = MDP.from_outcomes(
        [*rows_of, (0, 3, [(1, 2, 5)]), (1, 4, [(1, 2, 0)]), (2, 0, [(1, 2, 0)])]
    )
    assert np.flatnonzero(PolicyRows(apart, ()).available[0]).tolist() == [1]
    none = MDP.from_outcomes([*rows_of[:1], (0, 3, [(1, 2, 5)]), *rows_of[2:], (2, 0, [(1, 2, 0)])])
    with pytest.raises(ModelError, match="no action is available"):
        PolicyRows(none, ())


@pytest.mark.parametrize("cyclic", [True, False])
def test_a_relaxation_is_no_less_than_its_policies_and_says_what_they_lose(cyclic: bool) -> None:
    for seed in range(5):
        mdp = in_columns(seed, cyclic=cyclic)
        rows = PolicyRows(mdp, ("row",))
        rng = np.random.default_rng(seed)
        nodes = np.repeat(rows.available[None], 4, axis=0) & (rng.random((4, 2, 3)) < 0.7)
        nodes |= np.eye(3, dtype=bool)[rows.available.argmax(axis=1)][None]
        upper, choice, lost = rows.bound_relaxations(nodes)
        for n, node in enumerate(nodes):
            kept = [
                pair
                for pair, (s, a) in enumerate(zip(mdp.pair_state, mdp.pair_action, strict=True))
                if mdp.forced[s] or node[rows.key[s], a]
            ]
            free, best = oracle.solve_exact(5, oracle.rows_of(mdp, kept), mdp.discount_exact)
            exact = sum((p * free[s] for s, p in mdp.start), F(0))
            assert exact <= F(float(upper[n])) <= exact + F(1, 10**8)
            law = [
                row
                for s in range(5)
                for row in oracle.rows_of(mdp, kept)
                if row[0] == s and row[1] == min(best[s])
            ]
            moves = [
                {} if s == 4 else {t: mdp.discount_exact * p for t, p in row.items()}
                for s, _, _, row in law
            ]
            often = oracle.visits(dict(mdp.start), moves)
            q = {
                (s, a): r + mdp.discount_exact * oracle.mean(row, free)
                for s, a, r, row in oracle.rows_of(mdp)
            }
            for k in range(2):
                each = {
                    a: sum(
                        often[s] * (free[s] - q[s, a])
                        for s in range(4)
                        if rows.key[s] == k and not mdp.forced[s]
                    )
                    for a in np.flatnonzero(node[k]).tolist()
                }
                assert lost[n, k] == pytest.approx(float(min(each.values())), abs=1e-9)
                assert float(each[int(choice[n, k])]) == pytest.approx(lost[n, k], abs=1e-9)


@pytest.mark.parametrize("cyclic", [True, False])
def test_values_of_choices_hold_the_exact_ones(
    cyclic: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    for numbers in (2**22, 5, 1):
        monkeypatch.setattr(module, "BLOCK", numbers)
        for seed in range(3):
            mdp = in_columns(seed, cyclic=cyclic)
            rows = PolicyRows(mdp, ("time",))
            listed = [*every_choice(mdp, rows)]
            point = rows.evaluate_choices(np.array([choice for choice, _ in listed]))
            for (_, exact), value, error in zip(listed, point.value, point.error, strict=True):
                assert abs(F(float(value)) - exact) <= F(float(error)) <= F(1, 10**9)


def test_cycles_do_what_layers_do() -> None:
    for seed in range(5):
        mdp = in_columns(seed, cyclic=False)
        rng = np.random.default_rng(seed)
        allowed = rng.random((mdp.n_pairs, 4)) < 0.5
        pairs = np.array([rng.choice(mdp.pairs_of(s), size=4) for s in range(5)])
        np.put_along_axis(allowed, pairs, True, axis=0)
        one, other = Cycles(mdp), Layers(mdp)
        value, q, apart = one.solve_allowed(allowed)
        wanted, of_pairs, _ = other.solve_allowed(allowed)
        assert value == pytest.approx(wanted, abs=1e-12)
        assert q[mdp.pair_state < 4] == pytest.approx(of_pairs[mdp.pair_state < 4], abs=1e-12)
        assert (apart < 1e-12).all()
        assert one.evaluate_pairs(pairs)[0] == pytest.approx(
            other.evaluate_pairs(pairs)[0], abs=1e-12
        )
        alone = np.zeros_like(allowed)
        np.put_along_axis(alone, pairs, True, axis=0)
        # An end is worth nothing, and how often it is met is not asked.
        assert one.compute_visits(alone)[:4] == pytest.approx(
            other.compute_visits(alone)[:4], abs=1e-12
        )


def test_what_a_search_of_few_rounds_leaves_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    """Whatever the policies that it ends with, max Q is no further from V than it says."""
    monkeypatch.setattr(module, "POLICIES", 1)
    for seed in range(6):
        mdp = in_columns(seed, cyclic=True)
        value, q, apart = Cycles(mdp).solve_allowed(np.ones((mdp.n_pairs, 1), dtype=bool))
        best = np.maximum.reduceat(q[:, 0], mdp.pair_offsets[:-1])
        assert apart[0] == np.abs(best - value[:, 0]).max()
        found = best_policy(mdp, ("row",))
        exact = max(v for _, v in every_choice(mdp, PolicyRows(mdp, ("row",))))
        assert found.upper_bound >= exact - F(1, 10**9)


def test_a_search_that_stops_early_bounds_the_others() -> None:
    for seed in range(8):
        mdp = in_columns(seed, cyclic=False)
        rows = PolicyRows(mdp, ("row",))
        exact = max(value for _, value in every_choice(mdp, rows))
        for limit in (1, 2, 4):
            found = best_policy(mdp, ("row",), node_limit=limit)
            assert F(found.value.value) - F(found.error) <= exact <= F(found.upper_bound)
            assert found.upper_bound <= found.mixed_upper_bound
            assert found.nodes >= 1
            assert limit > 1 or found.nodes == 1
        search = _BranchAndBound(rows)
        search.split_nodes(1000)
        assert search.ended
        assert search.nodes < 1000
        assert search.upper <= search.mixed


def test_a_policy_to_begin_from_is_kept_where_it_is_best() -> None:
    for seed in range(4):
        mdp = in_columns(seed, cyclic=False)
        best = best_policy(mdp, ("row",))
        again = best_policy(mdp, ("row",), start=best.policy, node_limit=1)
        assert again.value.value >= best.value.value - 1e-12
        search = _BranchAndBound(PolicyRows(mdp, ("row",)))
        choice = search.choice.copy()
        search.offer_policies(search.choice[None])  # no better than itself
        assert search.choice.tolist() == choice.tolist()


def in_one_step(offers: list[dict[int, Any]], start: Any = None) -> MDP:
    """Two rows of two states, with a reward for each action that a state offers, and an end."""
    rows: Any = [(s, a, [(1, 4, pay)]) for s, own in enumerate(offers) for a, pay in own.items()]
    columns = (Column(name="row", size=2), Column(name="bed", size=2))
    mdp = MDP.from_outcomes(
        [*rows, (4, 0, [(1, 4, 0)])], start=start or dict.fromkeys(range(4), "1/4")
    )
    return mdp.with_(space=StateSpace(columns=columns, extra=("end",)))


def test_states_without_a_choice_do_not_bind_a_row() -> None:
    """State 0 has one action; in state 2 all are alike; what the others offer is available."""
    mdp = in_one_step([{2: 4}, {0: 8, 1: 12}, {1: 3, 2: 3}, {0: 16, 3: 20}])
    rows = PolicyRows(mdp, ("row",))
    assert rows.free.tolist() == [False, True, False, True, False]
    assert [np.flatnonzero(each).tolist() for each in rows.available] == [[0, 1], [0, 3]]
    best = best_policy(mdp, ("row",))
    assert best.actions == {"row 0": "1", "row 1": "3"}
    assert best.value.value == pytest.approx((4 + 12 + 3 + 20) / 4)
    # Where a row has no choice at all, the policy names no action.
    alone = best_policy(in_one_step([{2: 4}, {1: 3}, {1: 3}, {0: 16, 3: 20}]), ("row",))
    assert alone.actions == {"row 1": "3"}
    assert np.isnan(alone.policy.table[0]).all()
    none = in_one_step([{0: 4, 1: 1}, {2: 1, 3: 2}, {0: 3, 1: 4}, {0: 3, 1: 4}])
    with pytest.raises(ModelError, match="no action is available") as refused:
        PolicyRows(none, ("row",))
    assert "row 0" in str(refused.value)


def test_a_row_that_is_never_met_has_an_action_of_its_states() -> None:
    for first in range(2):
        met, other = {0: 2, 1: 4}, {2: 0, 3: 1}
        offers = [met, met, other, other] if first == 0 else [other, other, met, met]
        mdp = in_one_step(offers, start={2 * first: "1/2", 2 * first + 1: "1/2"})
        best = best_policy(mdp, ("row",))
        assert (best.value.value, best.nodes, best.proven) == (4, 1, True)
        assert best.actions == {f"row {first}": "1", f"row {1 - first}": "2"}


def test_the_default_limit_is_of_transitions_times_relaxations(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    limits = list[int]()

    def stop(limit: int, name: str) -> int:
        assert name == "node_limit"
        limits.append(limit)
        raise StopIteration

    monkeypatch.setattr(module, "mdp_of", lambda model: model)
    monkeypatch.setattr(module, "require_count", stop)
    for size in (1, 6_000, 10_000, 300_000, 400_000):
        model: Any = SimpleNamespace(n_transitions=size)
        with pytest.raises(StopIteration):
            best_policy(model)
    assert limits == [5000, 5000, 3355, 111, 100]  # 33,554,432 in all


@pytest.mark.parametrize("cyclic", [True, False])
def test_error_bounds_are_those_of_sums(cyclic: bool) -> None:
    """Of n terms a sum errs by n u / (1 - n u) of their size: Higham, Accuracy, section 3.1."""

    def grow(terms: int) -> F:
        unit = F(terms, 2**53)
        return unit / (1 - unit)

    mdp = in_columns(1, cyclic=cyclic)
    rows = PolicyRows(mdp, ("row",))
    most = max(len(row) for *_, row in oracle.rows_of(mdp))
    assert most == (5 if cyclic else 3)
    margins = margin_weights(mdp)
    reach = F(float(mdp.start_distribution @ margins.value)) / F(float(margins.smallest))
    slack = 1 + F(1, 2**20)
    gains = F(float(np.abs(mdp.table.compute_gains()).max()))
    value = np.array([[1.0, -0.25], [0.5, 0.0], [-3.0, 0.125], [0.0, 0.0], [0.0, 0.0]])
    apart = np.array([2.0**-50, 0.0])
    start, error = rows._at_start(value, apart)
    assert start.tolist() == [0.75, -0.125]
    for n, size in enumerate((3, F(1, 4))):
        rounding = grow(most + 8) * (gains + 2 * size)
        assert rows._bound_rounding(value)[n] == pytest.approx(float(rounding), rel=1e-9, abs=0)
        whole = (F(apart[n]) + rounding) * reach * slack + grow(2 + 2) * size
        assert error[n] == pytest.approx(float(whole * slack), rel=1e-9, abs=0)


def test_small_rewards_are_as_good_as_large_ones() -> None:
    for seed in range(5):
        mdp = in_columns(seed, cyclic=True)
        rows = [
            (s, a, [(p, t, r / 2**100) for p, t, r in mdp.table.row(pair)])
            for pair, (s, a) in enumerate(zip(mdp.pair_state, mdp.pair_action, strict=True))
        ]
        small = MDP.from_outcomes(rows, mdp.discount_exact, start=dict(mdp.start))
        allowed = np.ones((mdp.n_pairs, 1), dtype=bool)
        value, found = (Cycles(each).solve_allowed(allowed)[0] for each in (mdp, small))
        assert found * 2.0**100 == pytest.approx(value, rel=1e-10)


def test_policies_are_evaluated_in_parts_of_limited_size(monkeypatch: pytest.MonkeyPatch) -> None:
    rows = PolicyRows(in_columns(0, cyclic=False), ("row",))
    choices = np.zeros((9, 2), dtype=int)
    sizes, evaluate = list[int](), rows._passes.evaluate_pairs

    def counted(taken: Integers) -> Any:
        sizes.append(taken.size)
        return evaluate(taken)

    monkeypatch.setattr(module, "BLOCK", 10)
    monkeypatch.setattr(rows._passes, "evaluate_pairs", counted)
    rows.evaluate_choices(choices)
    assert (max(sizes), sum(sizes)) == (10, 45)


def test_a_search_splits_where_a_single_action_costs_most() -> None:
    """In row 0 a single action loses 1 / 4, in row 1 it loses 5 / 4."""
    mdp = in_one_step([{0: 1, 1: 0}, {0: 0, 1: 1}, {0: 7, 1: 0}, {0: 0, 1: 5}])
    rows = PolicyRows(mdp, ("row",))
    search = _BranchAndBound(rows)
    assert search.heap[0][3] == 1
    assert search.mixed == pytest.approx(14 / 4)
    search.split_nodes(1000)
    assert search.value == pytest.approx(8 / 4)
    assert search.upper == pytest.approx(8 / 4)
    # Bounds that are 1 too high never end the search before policies are alone.
    bound = rows.bound_relaxations

    def loose(nodes: Any) -> Any:
        upper, choice, lost = bound(nodes)
        return upper + 1, choice, lost

    high: Any = SimpleNamespace(
        bound_relaxations=loose,
        evaluate_choices=rows.evaluate_choices,
        available=rows.available,
        must_choose=rows.must_choose,
        mdp=mdp,
    )
    search = _BranchAndBound(high)
    search.split_nodes(1000)
    assert search.upper == pytest.approx(8 / 4 + 1)


def test_a_policy_is_kept_only_if_it_is_better_beyond_rounding() -> None:
    search = _BranchAndBound(PolicyRows(in_columns(0, cyclic=False), ("row",)))
    for value, error, better in (
        ([1.0, 0.0], [0.25, 0.9], True),
        ([0.0, 0.8], [0.9, 0.25], True),
        ([0.7, 0.0], [0.25, 0.0], False),
        ([0.75, 0.0], [0.25, 0.0], False),
    ):
        search.value, search.error, search.choice = 0.0, 0.5, np.array([0, 0])
        point = BoundedVector(value=np.array(value), error=np.array(error))
        stub: Any = SimpleNamespace(evaluate_choices=lambda choices, point=point: point)
        search.rows = stub
        search.offer_policies(np.array([[1, 1], [2, 2]]))
        best = int(np.argmax(value))
        kept = (value[best], error[best], best + 1) if better else (0, 0.5, 0)
        assert (search.value, search.error, search.choice[0]) == kept


# ---- policies that never end, or miss a goal -----------------------------------------------------


def endless(seed: int) -> Iterator[MDP]:
    """Questions at discount 1 about models of which some states need not be left."""
    rng, rows = np.random.default_rng(seed), list[Any]()
    for s in range(4):
        for a in range(3):
            targets = sorted(rng.choice(5, size=int(rng.integers(1, 3)), replace=False).tolist())
            amount = int(rng.choice([-3, -1, 0, 0, 2]))
            rows.append((s, a, [(F(1, len(targets)), t, amount) for t in targets]))
    rows.append((4, 0, [(1, 4, 0)]))
    space = StateSpace(
        columns=(Column(name="bed", size=2), Column(name="row", size=2)), extra=("end",)
    )
    goal = [s == 4 or (s == 3 and seed % 2 == 1) for s in range(5)]
    mdp = MDP.from_outcomes(rows, 1, start=int(seed % 3), labels={"goal": goal}).with_(space=space)
    yield from (mdp, mdp.with_(sense="min"), mdp.until("goal"), mdp.reaching("goal"))
    yield from (mdp.with_(sense="min").until("goal"), mdp.until("goal").within(3))


def each_worth(mdp: MDP, rows: PolicyRows) -> dict[tuple[int, ...], F | float]:
    """The exact value of every policy: that of the model in which nothing else can be done."""
    worth = dict[tuple[int, ...], F | float]()
    for choice in product(range(3), repeat=rows.space.size):
        taken = find_taken_pairs(mdp, rows.key, np.array([choice]))[:, 0]
        worth[choice] = certify(of_pairs(mdp, taken)).start_value
    return worth


def test_the_best_policy_where_some_never_end_or_miss_a_goal() -> None:
    infinite, finite = 0, 0
    for seed in range(10):
        for asked in endless(seed):
            # The search maximises; the end of all layers has no row.
            mdp = asked.maximised
            rows = PolicyRows.of(mdp, ("row",))
            if not isinstance(rows, EndlessRows):
                continue
            worth = each_worth(mdp, rows)
            most = max(worth.values())
            found = best_policy(mdp, ("row",))
            assert found.proven
            assert worth[tuple(rows.choices_of(found.policy).tolist())] == most
            cut = best_policy(mdp, ("row",), node_limit=1)
            own = worth[tuple(rows.choices_of(cut.policy).tolist())]
            assert most <= cut.upper_bound <= cut.mixed_upper_bound
            try:
                best = certify(mdp).start_value
            except ModelError:  # mixed policies earn without limit before the goal
                best = inf
            for one, exact in ((found, most), (cut, own)):
                assert exact <= one.upper_bound
                assert exact <= one.mixed_upper_bound
                assert one.mixed_upper_bound == pytest.approx(float(best), abs=1e-9)
                if isinstance(exact, float):
                    assert (one.value.value, one.error) == (exact, 0)
                else:
                    assert abs(F(one.value.value) - exact) <= F(one.error) <= F(1, 10**9)
            if isinstance(most, float):
                infinite += 1
                assert found.upper_bound == most
            else:
                finite += 1
                assert abs(found.upper_bound - float(most)) < 1e-9
            costs = best_policy(asked, ("row",)).value.value
            assert costs == pytest.approx(asked.sense.sign * found.value.value)
    assert min(infinite, finite) > 10


def test_the_best_average_of_policies_that_read_a_column() -> None:
    for seed in range(8):
        for sense in ("max", "min"):
            mdp = next(endless(seed)).with_(sense=sense, discount="1/2")
            rows = AverageRows(mdp, ("row",))
            worth = {
                choice: certify(
                    of_pairs(mdp, find_taken_pairs(mdp, rows.key, np.array([choice]))[:, 0]),
                    criterion="average",
                ).start_value
                for choice in product(range(3), repeat=rows.space.size)
            }
            most = (max if sense == "max" else min)(worth.values())
            found = best_policy(mdp, ("row",), criterion="average")
            assert found.proven
            assert abs(F(found.value.value) - most) <= F(found.error) <= F(1, 10**9)
            assert worth[tuple(rows.choices_of(found.policy).tolist())] == most
            assert found.upper_bound == pytest.approx(float(most), abs=1e-9)
            best = certify(mdp, criterion="average").start_value
            assert found.mixed_upper_bound == pytest.approx(float(best), abs=1e-9)


def test_relaxations_and_choices_of_endless_models_hold_the_exact_values() -> None:
    for seed in range(10):
        for mdp in (each.maximised for each in endless(seed)):
            rows = PolicyRows.of(mdp, ("row",))
            if not isinstance(rows, EndlessRows):
                continue
            rng = np.random.default_rng(seed)
            nodes = rng.random((3, rows.space.size, 3)) < 0.6
            nodes |= np.eye(3, dtype=bool)[rng.integers(0, 3, (3, rows.space.size))]
            upper, choice, lost = rows.bound_relaxations(nodes)
            worth = each_worth(mdp, rows)
            for node, bound, taken, short in zip(nodes, upper, choice, lost, strict=True):
                inside = [
                    value
                    for own, value in worth.items()
                    if all(node[k, a] for k, a in enumerate(own))
                ]
                assert max(inside) <= bound
                assert all(node[k, a] for k, a in enumerate(taken))
                # Where the relaxation's policy takes one action in each row, it is of the rows.
                if not short.any() and bound < inf:
                    exact = worth[tuple(taken.tolist())]
                    assert exact == pytest.approx(float(bound), abs=1e-9)
            pairs_of_nodes = rows._find_allowed_pairs(nodes)
            for place in np.flatnonzero(upper < inf).tolist():
                # How often the relaxation's policy takes each action of a row, where it comes to.
                node, pairs = nodes[place], np.flatnonzero(pairs_of_nodes[:, place])
                own_pairs = pairs[rows._solve_pairs(pairs).pairs]
                law = oracle.rows_of(mdp, own_pairs.tolist())
                met, before = {s for s, p in mdp.start if p}, set[int]()
                while met != before:
                    before = set(met)
                    met |= {t for s, _, _, row in law if s in before for t in row}
                times = np.zeros(node.shape, dtype=int)
                for s in met:
                    times[rows.key[s], law[s][1]] += bool(rows.free[s])
                most = [max(np.flatnonzero(own), key=times[k].item) for k, own in enumerate(node)]
                assert choice[place].tolist() == most
                assert lost[place].tolist() == [sum(each) - max(each) for each in times.tolist()]
            values = rows.evaluate_choices(np.array([*worth]))
            for exact, value, error in zip(worth.values(), values.value, values.error, strict=True):
                assert exact == value or abs(F(float(value)) - exact) <= F(float(error))


def test_a_start_that_may_mix_infinities_is_refused() -> None:
    """State 0 may earn forever; state 1 may lose forever, or end."""
    rows = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 2, 0)]), (1, 0, [(1, 1, -1)]), (1, 1, [(1, 2, 0)])]
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])], 1, start={0: "1/2", 1: "1/2"})
    for sense in ("max", "min"):
        for refused in (best_policy, PolicyRows.of):
            with pytest.raises(ModelError, match=r"\+∞ from one state of the start"):
                refused(mdp.with_(sense=sense).maximised, ())
    for start, best in ((0, inf), (1, 0)):
        assert best_policy(mdp.with_(start=start), ()).value.value == best
    alone = [*rows[:1], (0, 1, [(1, 0, -1)]), *rows[3:], (1, 0, [(1, 2, 1)])]
    one = MDP.from_outcomes([*alone, (2, 0, [(1, 2, 0)])], 1, start={0: "1/2", 1: "1/2"})
    assert PolicyRows.of(one, ()).mdp is one
    rows[2] = (1, 0, [(1, 1, 2)])
    same = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])], 1)
    both = same.with_(start={0: "1/2", 1: "1/2"})
    assert best_policy(both, ()).value.value == inf


def test_starts_may_be_compared_unless_some_policy_may_mix_infinities() -> None:
    """One start alone, or a goal, may be; the values of all states are proven for comparison."""
    refused = 0
    for seed in range(16):
        mdp = next(endless(seed))
        start = {0: F(1, 2), 1: F(1, 2)} if seed % 3 else {0: F(1, 3), 2: F(1, 3), 3: F(1, 3)}
        mdp = mdp.with_(start=start)
        if not mdp.ends.has_improper_policy:
            continue
        ends = [certify(mdp.with_(sense=sense)).value for sense in ("max", "min")]
        best, worst = (
            {s for s in start if each[s] == x} for each, x in zip(ends, (inf, -inf), strict=True)
        )
        if best and worst and len(best | worst) > 1:
            refused += 1
            with pytest.raises(ModelError, match="from one state of the start"):
                PolicyRows.of(mdp, ("row",))
        else:
            PolicyRows.of(mdp, ("row",))
        PolicyRows.of(mdp.until("goal"), ("row",))
        PolicyRows.of(mdp.with_(start=0), ("row",))
    assert refused > 1
