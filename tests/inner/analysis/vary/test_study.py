"""Studies: at every point the optimum and policies of the model that the point makes."""

from dataclasses import replace
from fractions import Fraction as F
from functools import partial
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from oracle import best_average, gain_and_bias, mean, policies, policy_values, rows_of
from refusal_tables import refused

from exact_mdp import MDP, Family, Scenario, parametric, solve, study
from exact_mdp.analysis.vary.study import (
    CareSolver,
    ModelSolver,
    StudyDraws,
    _Drawn,
    finite_optimum,
    finite_worth,
    hash_policies,
    require_room_for_points,
    solver_of,
)
from exact_mdp.mdp.care.scenario import ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import MOST_BYTES
from exact_mdp.solvers.parallel import Arrays, run_pieces
from exact_mdp.solvers.stacked import StackedModel

POINTS = {"p": [F(1, 4), F(1, 2), F(3, 4)], "r": [F(0), F(-2), F(5)]}


def build(at: dict[str, F]) -> MDP:
    p, r = at["p"], at["r"]
    rows = [
        (0, 0, [(p, 0, r), (1 - p, 1, 1)]),
        (0, 1, [(1, 1, 2)]),
        (1, 0, [(F(1, 3), 0, 0), (F(2, 3), 1, -r)]),
        (1, 1, [(1 - p, 0, 1), (p, 1, 0)]),
    ]
    return MDP.from_outcomes(rows, "4/5", start={0: "1/4", 1: "3/4"})


@pytest.mark.parametrize("sense", ["max", "min"])
def test_each_point_is_its_model(sense: str) -> None:
    family = Family(parameters={"p": "1/2", "r": 0}, build=lambda at: build(at).with_(sense=sense))
    found = study(family, POINTS, policies=["optimal", "random", [0, 1]])
    today = family.at({})
    for d, (p, r) in enumerate(zip(*POINTS.values(), strict=True)):
        mdp = build({"p": p, "r": r})
        values = {tuple(a for _, a, _, _ in each): policy_values(each, F(4, 5))
                  for each in policies(rows_of(mdp))}  # fmt: skip
        start = {key: v[0] / 4 + 3 * v[1] / 4 for key, v in values.items()}
        best = (max if sense == "max" else min)(start.values())
        assert abs(F(found.optimal[d]) - best) <= F(found.error[d, 0]) < F(1, 10**9)
        assert start[tuple(found.rows[found.which[d]].tolist())] == best
        now = {tuple(a for _, a, _, _ in each): policy_values(each, F(4, 5))
               for each in policies(rows_of(today))}  # fmt: skip
        held = (max if sense == "max" else min)(now, key=lambda key: now[key][0])
        mean = [(s, 0, sum(r for u, _, r, _ in rows_of(mdp) if u == s) / 2,
                 {t: sum(law.get(t, F(0)) for u, _, _, law in rows_of(mdp) if u == s) / 2
                  for t in (0, 1)}) for s in (0, 1)]  # fmt: skip
        random = policy_values(mean, F(4, 5))
        wanted = [start[held], random[0] / 4 + 3 * random[1] / 4, start[0, 1]]
        for n, exact in enumerate(wanted):
            assert abs(F(found.fixed[d, n]) - exact) <= F(found.error[d, n + 1]) < F(1, 10**9)
            assert found.regret[d, n] == pytest.approx(abs(float(best - exact)), abs=1e-12)
    assert found.points.tolist() == [*map(list, zip(*POINTS.values(), strict=True))]
    optimum, fixed = found.bound_point_values(1)
    assert (optimum.value, fixed.value) == (found.optimal[1], found.fixed[1, 0])
    assert (optimum.error, fixed.error) == (found.error[1, 0], found.error[1, 1])


def test_a_digest_tells_policies_apart() -> None:
    one, other = np.array([0.0, 1.0]), np.array([1.0, 0.0])
    seen = {hash_policies(*each) for each in product([one, other], repeat=2)}
    assert len(seen) == 4
    assert hash_policies(one) == hash_policies(one.copy()) == hash_policies(np.array([0, 1]))
    thirds = np.array([F(1, 3), F(2, 3)])  # by their floats, not by where they lie in memory
    assert hash_policies(thirds) == hash_policies(thirds.astype(float))


def test_too_many_points_are_refused_before_any_work() -> None:
    require_room_for_points(10, 2, "fewer")
    with pytest.raises(ModelError):
        require_room_for_points(10**12, 50, "fewer")


# ---- optima and policies of a few models ---------------------------------------------------------


def varied(at: dict[str, F], sense: str = "max", start: Any = 0) -> MDP:
    """Three states with 2, 1 and 3 pairs; rewards are fares and tips."""
    p, r = at["p"], at["r"]
    rows: Any = [
        (0, 0, [(p, 1, {"fare": r, "tip": 1}), (1 - p, 2, {"fare": r, "tip": 1})]),
        (0, 1, [(1, 2, {"fare": 3, "tip": 0})]),
        (1, 1, [(1, 0, {"fare": -1, "tip": r})]),
        (2, 0, [(1, 1, {"fare": 1, "tip": 0})]),
        (2, 1, [(p, 0, {"fare": 0, "tip": 2}), (1 - p, 2, {"fare": 0, "tip": 2})]),
        (2, 2, [(1, 1, {"fare": 1, "tip": 0})]),
    ]
    return MDP.from_outcomes(rows, "3/4", sense=sense, start=start)


def exactly(mdp: MDP) -> tuple[list[F], list[F]]:
    """The optimum of each state and what each pair loses, by enumeration."""
    rows = [(s, a, mdp.sense.sign * r, law) for s, a, r, law in rows_of(mdp)]
    every = [policy_values(each, mdp.discount_exact) for each in policies(rows)]
    best = [max(v[s] for v in every) for s in range(mdp.n_states)]
    lost = [best[s] - r - mdp.discount_exact * mean(law, best) for s, _, r, law in rows]
    return [mdp.sense.sign * x for x in best], lost


PLACES = [{"p": F(1, 3), "r": F(2)}, {"p": F(1), "r": F(-3)}, {"p": F(1, 7), "r": F(7)}]


@pytest.mark.parametrize("together", [True, False])
@pytest.mark.parametrize("sense", ["max", "min"])
def test_models_are_solved_all_at_once_or_one_by_one(sense: str, together: bool) -> None:
    models = [varied({**at, "p": min(at["p"], F(6, 7))}, sense) for at in PLACES]
    stacked = StackedModel.of(models)
    assert stacked is not None
    assert stacked.size == stacked.rows.size == 3 * 6 * 3
    drawn = _Drawn(models[0], stacked if together else None, models)
    start, error, gap, doubt, policy = drawn.solve_models()
    for d, mdp in enumerate(models):
        best, lost = exactly(mdp)
        assert abs(F(start[d]) - best[0]) <= F(error[d]) < F(1, 10**9)
        for pair, exact in enumerate(lost):
            assert abs(F(gap[d, pair]) - exact) <= F(doubt[d, pair]) < F(1, 10**9)
        taken = {
            (int(mdp.pair_state[l]), int(mdp.pair_action[l])) for l, x in enumerate(lost) if not x
        }
        assert {*enumerate(policy[d].tolist())} <= taken
    weights = np.array([0.25, 0.75, 1, 0.5, 0.5, 0])
    nowhere = np.zeros(3, dtype=bool)
    value, off = (each[:, 0] for each in drawn.evaluate_policies([weights], [nowhere]))
    totals, far = drawn.compute_totals(weights, ["tip", "fare"], nowhere)
    for d, mdp in enumerate(models):
        for amounts, got, bound in (
            (mdp.reward, value[d], off[d]),
            (mdp.components[:, 1], totals[d, 0], far[d, 0]),
            (mdp.components[:, 0], totals[d, 1], far[d, 1]),
        ):
            pairs = [[F(w), F(float(x)), row] for w, x, row in
                     zip(weights.tolist(), amounts, rows_of(mdp), strict=True)]  # fmt: skip
            mixed = []
            for s in range(3):
                own = [each for each in pairs if each[2][0] == s]
                law = {t: sum(w * row[3].get(t, F(0)) for w, _, row in own) for t in range(3)}
                mixed.append((s, 0, sum(w * x for w, x, _ in own), law))
            exact = policy_values(mixed, F(3, 4))[0]
            assert abs(F(got) - exact) <= F(bound) + F(1, 10**12)
            assert bound < 1e-9


def test_errors_of_totals_follow_components_whose_order_differs_between_draws() -> None:
    def build(at: dict[str, F]) -> MDP:
        parts = {"cost": [F(10**9, 3), 0], "tip": [F(1, 3), 0]}
        if at["p"] > F(1, 2) and at["swap"]:
            parts = dict(reversed(parts.items()))
        rows = [(0, 0, [(at["p"], 0, 1), (1 - at["p"], 1, 1)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, "1/2", components=parts)

    found = []
    for swap in (0, 1):
        family = Family(parameters={"p": "1/2", "swap": swap}, build=build)
        solver = ModelSolver(family, ("p",))
        draws, policy = np.array([[0.25], [0.75]]), np.ones(2)
        found.append(solver.compute_totals(draws, [policy], ["cost", "tip"], 0))
    for straight, swapped in zip(*found, strict=True):
        assert straight.tolist() == swapped.tolist()


def test_components_that_go_on_in_a_terminal_state_are_counted_forever() -> None:
    """They cancel, so the state earns nothing and the model has no cycle but this one."""
    parts = {"cost": [0, -1], "tip": [1, 1]}
    rows = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    family = Family(
        parameters={"rate": "1/2"},
        build=lambda at: MDP.from_outcomes(rows, at["rate"], components=parts),
    )
    solver = ModelSolver(family, ("rate",))
    totals, _ = solver.compute_totals(np.array([[0.5], [0.75]]), [np.ones(2)], ["cost", "tip"], 0)
    assert totals[:, 0].tolist() == [pytest.approx([-1, 2]), pytest.approx([-3, 4])]


def test_a_study_counts_optimal_actions_and_what_first_actions_lose() -> None:
    family = Family(parameters={"p": "1/2", "r": 1}, build=varied)
    places = [{**at, "p": min(at["p"], F(6, 7))} for at in PLACES]
    table = {name: [at[name] for at in places] for name in ("p", "r")}
    found = study(family, table)
    counts = np.zeros((2, 3), dtype=int)
    for d, at in enumerate(places):
        mdp = varied(at)
        _, lost = exactly(mdp)
        for pair, exact in enumerate(lost):
            state, action = int(mdp.pair_state[pair]), int(mdp.pair_action[pair])
            if state != 1 and not exact:
                counts[state // 2, action] += 1
            if state == 0:
                assert found.lost[d, action] == pytest.approx(float(exact), abs=1e-12)
        assert np.isnan(found.lost[d, 2])
    assert (found.counts.tolist(), found.counts.dtype.kind) == (counts.tolist(), "i")
    assert (found.cut.tolist(), found.cut.dtype.kind) == ([False] * 3, "b")
    several = Family(
        parameters={"p": "1/2", "r": 1}, build=lambda at: varied(at, start={0: 1, 1: 0})
    )
    assert study(several, table).lost.shape[0] == 3
    halves = Family(
        parameters={"p": "1/2", "r": 1}, build=lambda at: varied(at, start={0: "1/2", 1: "1/2"})
    )
    assert study(halves, table).lost.shape == (3, 0)


def test_many_points_are_as_each_alone() -> None:
    """More points than a block holds: rows and places are joined in order."""
    family = Family(parameters={"p": "1/2", "r": 1}, build=varied)
    count = 75
    rng = np.random.default_rng(1)
    table = {"r": rng.integers(-5, 6, count).astype(float), "p": rng.integers(1, 8, count) / 8}
    whole = study(family, table, [[0, 1, 0], [1, 1, 1]])
    for d in (0, 31, 32, 33, 64, 74):
        alone = study(
            family, {name: column[d : d + 1] for name, column in table.items()}, [[1, 1, 1]]
        )
        assert whole.points[d].tolist() == alone.points[0].tolist()
        assert whole.optimal[d] == pytest.approx(alone.optimal[0], abs=1e-12)
        assert whole.fixed[d, 1] == pytest.approx(alone.fixed[0, 0], abs=1e-12)
        assert whole.rows[whole.which[d]].tolist() == alone.rows[0].tolist()
    assert whole.names == ("r", "p")
    assert repr(whole) == "Study(75 points of r, p)"
    frame = whole.frame()
    assert [*frame.columns] == [
        "r", "p", "value", "fixed_value_0", "regret_0", "fixed_value_1", "regret_1",
        "error_bound", "claim"]  # fmt: skip
    assert frame["regret_1"].tolist() == whole.regret[:, 1].tolist()
    assert frame["fixed_value_0"].tolist() == whole.fixed[:, 0].tolist()
    assert frame["r"].tolist() == table["r"].tolist()
    bounds = [row[0] + max(row[1:]) for row in whole.error.tolist()]
    assert frame["error_bound"].tolist() == bounds
    assert [*whole.frame(["a", "a"]).columns[:2]] == ["a", "a"]
    one = study(family, table, [[0, 1, 0]]).frame()
    assert [*one.columns[2:5]] == ["value", "fixed_value", "regret"]


def test_a_solver_says_what_a_policy_does() -> None:
    solver = ModelSolver(Family(parameters={"p": "1/2", "r": 1}, build=varied), ("p",))
    assert solver.labels == ("state 0", "state 2")
    assert solver.place.tolist() == [0, -1, 1]
    weights = np.array([0, 1, 1, 0, 0, 1.0])
    assert solver.to_action_numbers(weights).tolist() == [1, 1, 2]
    assert solver.describe_policy(weights) == {"state 0": "1", "state 2": "2"}
    first_actions = np.array([1, 0, 1, 1, 0, 0.0])
    assert solver.describe_policy(first_actions) == {"state 0": "0", "state 2": "0"}
    mixed = np.array([0.5, 0.5, 1, 0, 0, 1.0])
    assert solver.to_action_numbers(mixed).tolist() == [-1, 1, 2]
    assert solver.describe_policy(mixed) is None
    assert solver.hold_policy([1, 1, 2]).tolist() == weights.tolist()
    assert solver._describe_draw(np.array([[0.5], [0.25]]), 7, 1) == "draw 8, p = 0.25"
    assert solver._describe_draw(np.array([[0.5], [0.25]]), 7, 0) == "draw 7, today's parameters"
    value = solver.evaluate_policies(np.array([[0.25], [0.75]]), [weights, mixed], 0)
    assert value["value"].shape == value["error"].shape == (2, 2)
    totals, errors = solver.compute_totals(
        np.array([[0.25], [0.75]]), [weights, mixed], ["fare", "tip"], 0
    )
    assert totals.shape == errors.shape == (2, 2, 2)
    assert totals.sum(axis=2) == pytest.approx(value["value"])
    with pytest.raises(ModelError, match="components are fare, tip there"):
        solver.compute_totals(np.array([[0.25]]), [weights], ["toll"], 0)


# ---- the study of all draws ----------------------------------------------------------------------


def test_a_regret_within_the_errors_of_both_values_is_none() -> None:
    family = Family(parameters={"p": "1/2", "r": 1}, build=varied)
    found = study(family, {"p": [F(1, 4), F(1, 4)]}, [[0, 1, 0]])
    made = replace(
        found,
        optimal=np.array([5.0, 5.0]),
        fixed=np.array([[4.7], [4.7]]),
        error=np.array([[0.2, 0.05], [0.2, 0.2]]),
    )
    assert made.regret[:, 0].tolist() == [pytest.approx(0.3), 0]
    assert made.criterion_facts == {}
    of_averages = replace(made, criterion="average").criterion_facts["criterion"]
    assert (of_averages.value, of_averages.text) == ("average", "average reward per step")
    assert made.frame()["error_bound"].tolist() == [0.25, 0.4]
    assert study(family, {"p": [F(1, 4)]}, []).frame()["value"].tolist() == [found.optimal[0]]


def test_work_is_kept_in_a_folder_and_done_by_threads_if_they_share_it(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A folder of one draw tells models apart that are alike today."""
    asked = list[bool]()

    def note(*given: Any, threads: bool, **how: Any) -> list[Arrays]:
        asked.append(threads)
        return run_pieces(*given, threads=threads, **how)

    monkeypatch.setattr("exact_mdp.analysis.vary.study.run_pieces", note)

    def family_of(factor: int) -> Family:
        return Family(
            parameters={"p": 0},
            build=lambda at: MDP.from_outcomes(
                [(0, 0, [(1, 1, 1 + factor * at["p"])]), (1, 0, [(1, 1, 0)])]
            ),
        )

    assert study(family_of(1), {"p": [2]}, folder=tmp_path).optimal.tolist() == [3]
    with pytest.raises(ModelError, match="first_draw"):
        study(family_of(2), {"p": [2]}, folder=tmp_path)
    scenario = parametric(Scenario.load("yuan2025").with_(tasks=[1], max_trial=1))
    study(scenario, {"base.anger": [0.05]})
    assert asked == [False, False, True]


@pytest.mark.parametrize("stored", [True, False])
def test_policies_can_be_added_to_a_study(stored: bool, tmp_path: Path) -> None:
    family = Family(parameters={"p": "1/2", "r": 1}, build=varied)
    solver = solver_of(family, ["r", "p"])
    points = np.array([[1.0, 0.25], [2.0, 0.5], [-1.0, 0.75]])
    how = {"folder": tmp_path} if stored else {}
    draws = StudyDraws(solver, points, 2, {"draws": hash_policies(points)}, how)
    both = [solver.hold_policy(rule) for rule in ([0, 1, 0], [1, 1, 2])]
    whole, first = StudyDraws(solver, points, 2, {}, {}).run_study(both), draws.run_study(both[:1])
    more = draws.with_policies(first, both[1:])
    assert more.fixed.tolist() == whole.fixed.tolist()
    assert more.error.tolist() == whole.error.tolist()
    assert StudyDraws(solver, points, 2, {}, {}).run_study([]).fixed.shape == (3, 0)
    if stored:
        assert draws.run_study(both[:1]).fixed.tolist() == first.fixed.tolist()  # from the folder
        kept = {path.relative_to(tmp_path).parts[0] for path in tmp_path.rglob("*.npz")}
        mark = hash_policies(both[1])[:12]
        assert {"draws", f"values-{mark}"} <= kept
        assert any(path.name.startswith("00000002-1") for path in tmp_path.rglob("*.npz"))
        other = StudyDraws(solver, points + 0.0, 2, {"draws": "others"}, how)
        with pytest.raises(ModelError):
            other.run_study(both)  # the folder holds other points


def test_a_point_that_makes_no_model_is_named_by_its_number() -> None:
    def build(at: dict[str, F]) -> MDP:
        return MDP.from_outcomes(
            [(0, 0, [(at["p"], 0, 1), (1 - at["p"], 1, 1)]), (1, 0, [(1, 1, 0)])]
        )

    family = Family(parameters={"p": "1/2"}, build=build)
    points = np.full(100, 0.5)
    points[70] = 1.5
    with pytest.raises(ModelError) as caught:
        study(family, {"p": points}, [[0, 0]])
    assert "draw 70" in str(caught.value)
    assert caught.value.fix.startswith("choose ranges, or distributions")
    assert "draw probabilities of one row together" in caught.value.fix
    draws, solver, policy = points[:, None], ModelSolver(family, ("p",)), np.ones(2)
    for first in ((), (0,), (5,)):  # more than are in memory at a time
        number = sum(first, start=70)
        refused(partial(solver.solve_draws, draws, *first), "", f"draw {number}, p = 1.5")
        refused(partial(solver.evaluate_policies, draws, [policy], *first), "", f"draw {number},")
    what = "=[0.5] is not a table of points"
    fix = "=give {name: numbers}, or a pandas.DataFrame"
    refused(lambda: study(family, [0.5]), what, "=points", fix)  # type: ignore[arg-type]


def test_probabilities_that_are_cut_off_are_said_with_their_draw() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=1)
    family = parametric(scenario)
    names = [p.name for p in family.parameters if p.name.startswith("base.")][:2]
    usual = [float(p.value) for p in family.parameters if p.name in names]
    table = {names[0]: [usual[0], 0.99, usual[0]], names[1]: [usual[1], 0.98, usual[1]]}
    with pytest.warns(Warning, match="1 of 3 draws, the first of them draw 1") as seen:
        found = study(family, table)
    assert found.cut.tolist() == [False, True, False]
    assert names[0] in str(seen[0].message) or names[1] in str(seen[0].message)


# ---- averages ------------------------------------------------------------------------------------


def two_classes(at: dict[str, F], sense: str = "max") -> MDP:
    """A transient state that chooses between two recurrent classes with different gains."""
    p, r = at["p"], at["r"]
    rows: Any = [
        (0, 0, [(p, 1, 0), (1 - p, 3, 0)]),
        (0, 1, [(1, 1, -1)]),
        (1, 0, [(1, 2, r)]),
        (1, 1, [(p, 1, 1), (1 - p, 2, 1)]),
        (2, 0, [(F(1, 3), 1, 2), (F(2, 3), 2, 2)]),
        (2, 1, [(1, 1, r)]),
        (3, 0, [(1, 3, F(3, 2))]),
        (3, 1, [(1, 3, 1)]),
    ]
    return MDP.from_outcomes(rows, "3/4", sense=sense, start={0: "1/4", 2: "3/4"})


def exact_averages(mdp: MDP) -> tuple[F, list[F]]:
    """The best average at the start, and the loss of each pair: of gain, or else of bias."""
    sign, rows = mdp.sense.sign, []
    for s, a, r, law in rows_of(mdp):
        rows.append((s, a, sign * r, law))
    gain, bias = best_average(rows)
    losses = []
    for s, _, r, law in rows:
        lost = gain[s] - mean(law, gain)
        losses.append(lost or bias[s] - (r - gain[s] + mean(law, bias)))
    return sign * sum((p * gain[s] for s, p in mdp.start), F(0)), losses


@pytest.mark.parametrize("sense", ["max", "min"])
def test_averages_of_draws_are_those_of_all_policies(sense: str) -> None:
    places = [{"p": F(k, 7), "r": F(r)} for k in (1, 3, 6) for r in (-2, 1, 4)]
    models = [two_classes(at, sense) for at in places]
    drawn = _Drawn(models[0], None, models, criterion="average")
    start, error, gap, doubt, policy = drawn.solve_models()
    weights = np.array([0.5, 0.5, 0.25, 0.75, 1, 0, 0, 1])
    nowhere = np.zeros(4, dtype=bool)
    value, off = (each[:, 0] for each in drawn.evaluate_policies([weights], [nowhere]))
    for d, mdp in enumerate(models):
        best, losses = exact_averages(mdp)
        assert abs(F(start[d]) - best) <= F(error[d]) < F(1, 10**9)
        for pair, exact in enumerate(losses):
            assert abs(F(gap[d, pair]) - exact) <= F(doubt[d, pair]) < F(1, 10**9)
        kept = {pair for pair, exact in enumerate(losses) if not exact}
        assert {mdp.pair(s, a) for s, a in enumerate(policy[d].tolist())} <= kept
        mixed, rows = [], rows_of(mdp)
        for s in range(4):
            (_, _, r0, law0), (_, _, r1, law1) = rows[2 * s], rows[2 * s + 1]
            w0, w1 = F(weights[2 * s]), F(weights[2 * s + 1])
            law = {t: w0 * law0.get(t, F(0)) + w1 * law1.get(t, F(0)) for t in range(4)}
            mixed.append((s, 0, w0 * r0 + w1 * r1, {t: p for t, p in law.items() if p}))
        gain, _ = gain_and_bias(mixed)
        wanted = sum((p * gain[s] for s, p in mdp.start), F(0))
        assert abs(F(value[d]) - wanted) <= F(off[d]) < F(1, 10**9)


def test_a_study_of_averages_holds_today_s_best_and_leaves_first_actions_out() -> None:
    family = Family(parameters={"p": "3/7", "r": 1}, build=two_classes)
    table = {"p": [F(1, 7), F(6, 7)], "r": [F(4), F(-2)]}
    found = study(family, table, criterion="average")
    assert found.criterion == "average"
    assert found.lost.shape == (2, 0)
    for d, (p, r) in enumerate(zip(*table.values(), strict=True)):
        best, losses = exact_averages(two_classes({"p": p, "r": r}))
        assert found.optimal[d] == pytest.approx(float(best), abs=1e-12)
        optimal = np.array([not lost for lost in losses])
        counted = sum(
            np.array([not lost for lost in exact_averages(two_classes(at))[1]]).astype(int)
            for at in ({"p": F(1, 7), "r": F(4)}, {"p": F(6, 7), "r": F(-2)})
        )
        assert found.counts.ravel().tolist() == counted.tolist()
        taken = found.rows[found.which[d]]
        assert optimal[2 * np.arange(4) + taken].all()
    solver = solver_of(family, ["p"], "average")
    assert (type(solver), solver.criterion) == (ModelSolver, "average")
    today, _ = exact_averages(two_classes({"p": F(3, 7), "r": F(1)}))
    assert float(solver.solution.start.value) == pytest.approx(float(today), abs=1e-12)


# ---- the errors of solutions ---------------------------------------------------------------------


def noticed(doubt: np.ndarray, wanted: list[F]) -> None:
    """Each bound is a sum of errors, and the little that rounding adds."""
    for got, exact in zip(doubt.tolist(), wanted, strict=True):
        assert exact <= F(got) <= exact * (1 + F(1, 10**6))


@pytest.mark.parametrize("sense", ["max", "min"])
def test_gaps_are_as_uncertain_as_the_values_of_a_pair_and_of_what_follows(
    sense: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of values that are as far off as they may be, in each direction: |V - V*| = e."""
    mdp, off = varied({"p": F(1, 3), "r": F(2)}, sense), [F(1, 2**14), F(1, 2**10), F(1, 2**12)]
    solution, (_, lost) = solve(mdp), exactly(mdp)
    bound = [off[s] + F(3, 4) * mean(law, off) for s, _, _, law in rows_of(mdp)]
    for signs in product([-1, 1], repeat=3):
        value = solution.value + np.array(signs) * np.array(off, dtype=float)
        wrong = replace(solution, value=value, state_error=np.array(off, dtype=float))
        solved = "exact_mdp.analysis.vary.study.solve"
        monkeypatch.setattr(solved, lambda *_, wrong=wrong, **__: wrong)
        _, _, (gap,), (doubt,), _ = _Drawn(mdp, None, [mdp]).solve_models()
        noticed(doubt, bound)
        for got, most, exact in zip(gap.tolist(), doubt.tolist(), lost, strict=True):
            assert abs(F(got) - exact) <= F(most)


@pytest.mark.parametrize("sense", ["max", "min"])
def test_gaps_of_averages_are_as_uncertain_as_gain_and_bias(
    sense: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What a pair gives up is of gains; else of biases, less the gain of a step."""
    mdp, rng = two_classes({"p": F(1, 7), "r": F(4)}, sense), np.random.default_rng(0)
    of_gain, of_bias = (
        [F(int(k), 2**20) for k in rng.permutation([1, 10, 100, 1000])] for _ in range(2)
    )
    solution, (_, lost) = solve(mdp, criterion="average"), exact_averages(mdp)
    gain, _ = best_average([(s, a, mdp.sense.sign * r, law) for s, a, r, law in rows_of(mdp)])
    bound = []
    for s, _, _, law in rows_of(mdp):
        if gain[s] > mean(law, gain):
            bound.append(of_gain[s] + mean(law, of_gain))
        else:
            bound.append(2 * of_gain[s] + of_bias[s] + mean(law, of_bias))
    assert len({gain[s] > mean(law, gain) for s, _, _, law in rows_of(mdp)}) == 2
    for _ in range(20):
        signs = rng.choice([-1, 1], (2, 4))
        errors = np.array([of_gain, of_bias], dtype=float)
        wrong = replace(
            solution, value=solution.value + signs[0] * errors[0], state_error=errors[0],
            bias=solution.bias + signs[1] * errors[1], bias_error=errors[1],
        )  # fmt: skip
        solved = "exact_mdp.analysis.vary.study.solve"
        monkeypatch.setattr(solved, lambda *_, wrong=wrong, **__: wrong)
        drawn = _Drawn(mdp, None, [mdp], criterion="average")
        _, _, (gap,), (doubt,), _ = drawn.solve_models()
        noticed(doubt, bound)
        for got, most, exact in zip(gap.tolist(), doubt.tolist(), lost, strict=True):
            assert abs(F(got) - exact) <= F(most)


def test_where_no_gain_is_given_up_a_pair_loses_what_it_earns_less_at_first() -> None:
    rows = [(0, 0, [(1, 1, 2)]), (0, 1, [(1, 1, -1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows)
    _, _, (gap,), (doubt,), _ = _Drawn(mdp, None, [mdp], criterion="average").solve_models()
    assert gap.tolist() == [0, 3, 0]
    assert doubt.max() < 1e-12


def test_models_are_solved_one_by_one_if_they_cannot_be_solved_together(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    models = [varied({"p": F(1, k), "r": F(2)}) for k in (2, 3)]
    drawn = _Drawn(models[0], StackedModel.of(models), models)
    monkeypatch.setattr(StackedModel, "optimum", lambda self: None)
    start = drawn.solve_models()[0]
    assert start == pytest.approx([float(exactly(mdp)[0][0]) for mdp in models])


# ---- single draws --------------------------------------------------------------------------------


@pytest.mark.parametrize("sense", ["max", "min"])
def test_losses_next_to_infinite_values_are_infinite_or_none(sense: str) -> None:
    """From state 0 everything is finite; others may gain for ever, or only lose for ever."""
    sign = 1 if sense == "max" else -1
    rows: Any = [
        (0, 0, [(1, 3, sign)]), (0, 1, [(1, 3, 0)]),
        (1, 0, [(1, 1, sign)]), (1, 1, [(1, 3, 0)]),
        (2, 0, [(1, 2, -sign)]), (2, 1, [("1/2", 1, 0), ("1/2", 2, 0)]),
        (3, 0, [(1, 3, 0)]),
        (4, 0, [("1/2", 1, 0), ("1/2", 5, 0)]), (4, 1, [(1, 3, 0)]),
        (5, 0, [(1, 5, -sign)]),
    ]  # fmt: skip
    mdp = MDP.from_outcomes(rows, sense=sense)
    drawn = _Drawn(mdp, None, [mdp])
    start, error, gap, _, policy = drawn.solve_models()
    assert (start.tolist(), error[0] < 1e-12) == ([sign], True)
    assert gap[0].tolist()[:4] == [0, 1, 0, np.inf]
    assert gap[0].tolist()[7:9] == [np.inf, 0]
    assert policy[0, :2].tolist() == [0, 0]
    assert not np.isnan(gap).any()


def test_a_draw_is_described_by_three_parameters_at_most() -> None:
    names = ("a", "b", "c", "d")
    family = Family(
        parameters=dict.fromkeys(names, "1/2"),
        build=lambda at: MDP.from_outcomes([(0, 0, [(1, 0, at["a"])])], "1/2"),
    )
    solver = ModelSolver(family, names)
    draws = np.array([[0.25, 0.25, 0.25, 0.5], [0.25, 0.25, 0.25, 0.25]])
    assert solver._describe_draw(draws, 0, 0) == "draw 0, a = 0.25, b = 0.25, c = 0.25"
    assert solver._describe_draw(draws, 0, 1) == "draw 1, a = 0.25, b = 0.25, c = 0.25 and 1 more"


def test_a_silent_policy_is_refused_at_the_draw_in_which_it_matters() -> None:
    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 2, 1)]), (1, 0, [(1, 1, 0)])]
        rows += [(1, 1, [(1, 1, at["r"])]), (2, 0, [(1, 2, 0)])]
        return MDP.from_outcomes(rows, "1/2")

    solver = ModelSolver(Family(parameters={"r": 0}, build=build), ("r",))
    weights = solver.hold_policy({0: 0})  # all is over in state 1 today
    value = solver.evaluate_policies(np.array([[0.0], [0.0]]), [weights])["value"]
    assert value[:, 0].tolist() == [1, 1]
    with pytest.raises(ModelError, match="names no action") as caught:
        solver.evaluate_policies(np.array([[0.0], [2.0]]), [weights], 5)
    assert "draw 6, r = 2" in str(caught.value)


def test_models_of_draws_are_kept_and_not_sent_along() -> None:
    made = list[F]()

    def build(at: dict[str, F]) -> MDP:
        made.append(at["p"])
        return varied(at)

    solver = ModelSolver(Family(parameters={"p": "1/2", "r": 1}, build=build), ("p",))
    draws, policy = np.array([[0.25], [0.75]]), solver.hold_policy([1, 1, 2])
    before = len(made)
    solver.solve_draws(draws)
    solver.evaluate_policies(draws, [policy])
    assert len(made) == before + 2
    assert solver.__getstate__()["drawn"] == {}
    exactly_drawn = np.array([[F(1, 4)]], dtype=object)
    solver.evaluate_policies(exactly_drawn, [policy])
    assert len(made) == before + 3
    solver.evaluate_policies(exactly_drawn + F(1, 10**30), [policy])  # the same as a float
    assert len(made) == before + 4
    with pytest.raises(ModelError, match="start"):
        ModelSolver(
            Family(parameters={"p": "1/2"}, build=lambda at: two_starts(at["p"])), ("p",)
        ).solve_draws(np.array([[0.25]]))


def two_starts(p: F) -> MDP:
    """A model whose only start moves with the parameter."""
    rows = [(0, 0, [(1, 0, 1)]), (1, 0, [(1, 0, 1)])]
    return MDP.from_outcomes(rows, "1/2", start=int(p < F(1, 2)))


# ---- care scenarios ------------------------------------------------------------------------------


def test_draws_of_a_care_scenario_are_as_its_models() -> None:
    scenario = parametric(Scenario.load("yuan2025").with_(tasks=[2, 1], max_trial=2))
    today = scenario.parameters[0]
    name = today.name
    draws = np.array([[float(today.value)], [float(today.value) * 0.5]])
    fast, slow = solver_of(scenario, [name]), ModelSolver(scenario, [name])
    assert isinstance(fast, CareSolver)
    one, other = fast.solve_draws(draws), slow.solve_draws(draws)
    assert one["start"] == pytest.approx(other["start"], rel=1e-12)
    for d in range(2):
        assert (one["rows"][one["which"][d]] == other["rows"][other["which"][d]])[fast.tried].all()
    assert one["lost"] == pytest.approx(other["lost"][:, : one["lost"].shape[1]], abs=1e-9)
    held = fast.hold_policy("optimal")
    mine, theirs = (each.evaluate_policies(draws, [held], 0) for each in (fast, slow))
    assert mine["value"] == pytest.approx(theirs["value"], rel=1e-12)
    assert mine["error"].shape == (2, 1)
    assert mine["value"][0, 0] == pytest.approx(one["start"][0])
    # What is done is told of states with a choice: at the end, and in a skip, there is none.
    own = parametric(scenario.scenario.with_(readings={"skip_timestep": "own"}))
    for solver in (fast, solver_of(own, [name])):
        for action in solver.mdp.actions[:4]:
            told = solver.describe_policy(solver.hold_policy(f"always:{action}"))
            assert told == dict.fromkeys(solver.labels, action)
    statuses = len(scenario.scenario.statuses)
    assert fast.labels == tuple("".join(bits) for bits in product("01", repeat=statuses))
    space = fast.mdp.space
    for state in np.flatnonzero(fast.tried).tolist():
        assert fast.labels[fast.place[state]] in space.label(state)
    assert (
        type(solver_of(Family(parameters={"p": "1/2", "r": 1}, build=varied), ["p"])) is ModelSolver
    )


@pytest.mark.parametrize("room", [0, 1, 2.5, 40])
def test_as_many_draws_of_a_scenario_are_in_memory_as_have_room(
    room: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = parametric(Scenario.load("yuan2025").with_(tasks=[1], max_trial=1))
    draws = np.linspace(0.01, 0.1, 5)[:, None]
    usual = solver_of(scenario, ["base.anger"])
    assert isinstance(usual, CareSolver)
    block = int(room * usual.stack.rows)
    monkeypatch.setattr("exact_mdp.analysis.vary.study.BLOCK", block)
    solver = solver_of(scenario, ["base.anger"])
    assert solver.together == max(1, int(room))
    assert solver.solve_draws(draws)["start"].tolist() == usual.solve_draws(draws)["start"].tolist()


def test_scenarios_of_six_statuses_and_127_actions_are_solved_by_their_rules(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for name in ("CareSolver", "ModelSolver"):
        monkeypatch.setattr(
            f"exact_mdp.analysis.vary.study.{name}", lambda *_, name=name, **__: name
        )
    for statuses, actions, wanted in (
        (6, 127, "CareSolver"), (7, 127, "ModelSolver"), (6, 128, "ModelSolver"),
    ):  # fmt: skip
        tables: Any = SimpleNamespace(statuses=range(statuses), actions=range(actions))
        family = ScenarioFamily(scenario=tables)
        assert str(solver_of(family, ["p"])) == wanted
        assert str(solver_of(family, ["p"], "average")) == "ModelSolver"
        assert str(solver_of(family.with_question(lambda mdp: mdp), ["p"])) == "ModelSolver"


# ---- what is refused -----------------------------------------------------------------------------


def test_room_ends_at_the_most_bytes() -> None:
    require_room_for_points(MOST_BYTES // 32, 1, "fewer")
    require_room_for_points(MOST_BYTES // 96, 3, "fewer")
    for count, parameters in ((MOST_BYTES // 32 + 1, 1), (MOST_BYTES // 96 + 1, 3)):
        what = f"={count:,} points of {parameters} parameters take "
        what += (
            f"{32 * count * parameters / 1e9:,.0f} GB of memory, more than {MOST_BYTES / 1e9:g} GB"
        )
        call = partial(require_room_for_points, count, parameters, "ask for fewer")
        refused(call, what, "=points", "=ask for fewer")


def test_infinite_values_are_refused_with_the_ways_out() -> None:
    endless = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])])
    with pytest.raises(ModelError, match="the optimum is infinite") as caught:
        finite_optimum(endless, "today's parameters")
    assert "within(N)" in caught.value.fix
    assert "another policy" not in caught.value.fix
    assert "ranges" not in caught.value.fix
    with pytest.raises(ModelError, match="the policy held fixed is infinite") as caught:
        finite_worth(endless, [0, 0], "draw 3")
    assert "another policy" in caught.value.fix
    assert "ranges in which every value is finite" in caught.value.fix
    assert finite_worth(endless, [1, 0], "draw 3").value == 1


def test_values_are_finite_unless_infinite_ones_are_asked_for() -> None:
    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 0, at["x"])]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows)

    family, stay = Family(parameters={"x": -1}, build=build), np.array([1.0, 0.0, 1.0])
    draws = np.array([[-1.0], [2.0]])
    for solver in (solver_of(family, ["x"]), ModelSolver(family, ["x"])):
        refused(lambda solver=solver: solver.solve_draws(draws), "the optimum is infinite, so",
                "=the total at discount 1, draw 1, x = 2")  # fmt: skip
        refused(lambda solver=solver: solver.evaluate_policies(draws, [stay]),
                "the policy held fixed is infinite, so", "draw 0")  # fmt: skip
    solver = solver_of(family, ["x"], finite=False)
    assert solver.solve_draws(draws)["start"].tolist() == [1, np.inf]
    assert solver.evaluate_policies(draws, [stay])["value"][:, 0].tolist() == [-np.inf, np.inf]
    endless = Family(parameters={"x": 3}, build=build)
    one = endless.at({})
    refused(_Drawn(one, None, [one]).solve_models, "the optimum is infinite, so")
    for usual in (solver_of(endless, ["x"]), ModelSolver(endless, ["x"])):
        where = "=the total at discount 1, today's parameters"
        refused(lambda usual=usual: usual.solution, "the optimum is infinite, so", where)
    assert ModelSolver(endless, ["x"], finite=False).solution.start.value == np.inf
    averages = ModelSolver(endless, ["x"], "average", finite=False)
    assert averages.solution.start.value == 3
    assert averages.evaluate_policies(draws, [stay])["value"][:, 0].tolist() == [-1, 2]


def test_both_actions_of_a_state_in_which_all_is_over_are_optimal() -> None:
    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, at["x"])]), (1, 0, [(1, 1, 0)]), (1, 1, [(1, 1, 0)])]
        return MDP.from_outcomes(rows)

    solver = ModelSolver(Family(parameters={"x": 1}, build=build), ["x"])
    assert solver.solve_draws(np.array([[1.0], [2.0]]))["counts"].tolist() == [[2, 2]]
