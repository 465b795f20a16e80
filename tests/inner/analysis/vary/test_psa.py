"""Probabilistic analyses against enumeration of all policies in every draw, and against loops."""

import json
from collections.abc import Iterator
from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import numpy as np
import pandas as pd
import pytest
from refusal_tables import refused
from scipy.stats import binomtest, sem

from exact_mdp import MDP, Family, ModelError, Parameter, psa
from exact_mdp.analysis.vary.distributions import Uncertain, Uncertainty, uncertainty
from exact_mdp.analysis.vary.information import PartialInformation, estimate_evppi, too_wide
from exact_mdp.analysis.vary.intervals import estimate_quantiles, mean_loss, tolerances_of
from exact_mdp.analysis.vary.psa import (
    MISSING,
    POOL,
    PSA,
    Candidate,
    _select_policies,
    groups_of,
    sample_parameters,
)
from exact_mdp.analysis.vary.study import Study, hash_policies
from exact_mdp.mdp.sense import Sense
from exact_mdp.solvers.claims import Estimated

# ---- numbers of a study that is made up ----------------------------------------------------------


def made_up(seed: int, *, sense: int = 1, draws: int = 40, policies: int = 3, **more: Any) -> PSA:
    """An analysis of random numbers: optima, policies below them, losses of two first actions."""
    rng = np.random.default_rng(seed)
    optimal = rng.normal(5, 2, draws)
    below = rng.exponential(1.0, (draws, policies)) * (rng.random((draws, policies)) < 0.6)
    lost = rng.exponential(1.0, (draws, 3)) * (rng.random((draws, 3)) < 0.7)
    lost[:, 1] = np.nan
    table = Study(
        names=("p.one", "p.two", "q"),
        points=rng.random((draws, 3)),
        optimal=sense * optimal,
        fixed=sense * (optimal[:, None] - below),
        error=np.full((draws, policies + 1), 1e-3),
        sense=Sense.MAX if sense > 0 else Sense.MIN,
        rows=np.zeros((1, 2), dtype=int),
        which=np.zeros(draws, dtype=int),
        counts=rng.integers(0, draws + 1, (2, 3)),
        lost=lost,
        cut=rng.random(draws) < 0.3,
    )
    parts = tuple(Uncertain.of(name, "uniform", low=0, high=1) for name in table.names)
    candidates = tuple(
        Candidate(name=f"policy {n}", weights=np.zeros(2), frequency=n, actions=None)
        for n in range(policies)
    )
    unused: Any = None
    made = PSA(
        model="made up", start=unused, uncertainty=Uncertainty(parts=parts, fixed={}), seed=3,
        table=table, candidates=candidates, labels=("here", "there"), actions=("a", "b", "c"),
        compiled=True,
    )  # fmt: skip
    return replace(made, **more)


@pytest.mark.parametrize("sense", [1, -1])
@pytest.mark.parametrize("seed", range(4))
def test_evpi_lies_between_what_the_first_action_and_the_best_policy_lose(
    seed: int, sense: int
) -> None:
    analysis = made_up(seed, sense=sense)
    table, count = analysis.table, len(analysis)
    worth = sense * table.fixed
    assert np.array_equal(analysis.gained, worth)
    means = [worth[:, n].sum() / count for n in range(3)]
    best = means.index(max(means))
    found = analysis.evpi()
    assert found.best == f"policy {best}"
    regret = [
        max(sense * (o - v), 0) for o, v in zip(table.optimal, table.fixed[:, best], strict=True)
    ]
    regret = [each if each > 2e-3 else 0 for each in regret]
    assert analysis.regret(best).tolist() == pytest.approx(regret)
    assert (found.high.value, found.high.standard_error) == pytest.approx(
        (np.mean(regret), sem(regret))
    )
    by_action = {a: table.lost[:, a] for a in (0, 2)}
    least = by_action[min(by_action, key=lambda a: by_action[a].mean())]
    assert (found.low.value, found.low.standard_error) == pytest.approx((least.mean(), sem(least)))
    most = worth.max(axis=1) - worth[:, best]
    assert analysis.evpi_of_candidates().value == pytest.approx(most.mean())
    assert analysis.value.value == pytest.approx(table.optimal.mean())
    assert analysis.value.standard_error == pytest.approx(sem(table.optimal))
    assert np.array_equal(analysis.regret(), table.regret[:, 0])
    assert np.array_equal(analysis.regret(2), table.regret[:, 2])


def test_losses_of_first_actions_within_the_errors_count_nothing() -> None:
    analysis = made_up(0)
    lost = np.full((40, 3), 10.0)
    lost[:, 2] = np.linspace(0, 1, 40)
    error = np.array([[0.1, 5.0, 0.2, 5.0]] * 40)  # of the optimum, and of each policy
    fixed = np.where(np.arange(3) == 1, analysis.table.optimal[:, None], 0.0)
    table = replace(analysis.table, lost=lost, error=error, fixed=fixed)
    found = replace(analysis, table=table).evpi()
    assert found.best == "policy 1"
    kept = [each if each > 0.1 + 0.2 else 0.0 for each in lost[:, 2]]
    assert found.low.value == pytest.approx(np.mean(kept))
    error = np.array([[0.25, 5.0, 0.5, 5.0]] * 40)
    both = replace(table, lost=np.full((40, 3), 0.75), error=error)
    least = replace(analysis, table=both).evpi().low
    assert (least.value, least.standard_error) == (0, 0)
    none = replace(analysis, table=replace(table, lost=np.empty((40, 0)))).evpi()
    assert (none.low.value, none.low.interval) == (0, (0, 0))


def test_acceptability_is_the_share_of_draws_that_lose_at_most_so_much() -> None:
    analysis = made_up(1)
    for candidate in (0, 2):
        regret = analysis.regret(candidate).tolist()
        tolerances = [0.0, *sorted(regret)[20:30:3], 100.0]
        share, low, high = analysis.acceptability(tolerances, candidate)
        for k, tolerance in enumerate(tolerances):
            inside = sum(each <= tolerance for each in regret)
            wanted = binomtest(inside, 40).proportion_ci(method="wilson")
            assert share[k] == inside / 40
            assert (low[k], high[k]) == pytest.approx((wanted.low, wanted.high), abs=1e-6)
    assert np.array_equal(analysis.acceptability(0.5)[0], analysis.acceptability([0.5], 0)[0][0])
    share, low, high = analysis.probability_optimal()
    assert share.shape == (2, 3)
    for x, a in product(range(2), range(3)):
        wanted = binomtest(int(analysis.table.counts[x, a]), 40).proportion_ci(method="wilson")
        assert share[x, a] == analysis.table.counts[x, a] / 40
        assert (low[x, a], high[x, a]) == pytest.approx((wanted.low, wanted.high), abs=1e-6)
    cut = analysis.clipped
    assert cut is not None
    assert cut.value == analysis.table.cut.mean()
    assert replace(analysis, compiled=False).clipped is None


def test_groups_are_valued_by_their_columns_and_doubted_where_policies_are_missing() -> None:
    analysis = made_up(2)
    gained, points = analysis.gained, analysis.table.points
    found = analysis.evppi()
    columns = {"p.one": [0], "p.two": [1], "q": [2], "p.*": [0, 1]}
    assert found.keys() == columns.keys()
    for label, each in columns.items():
        names = tuple(analysis.names[k] for k in each)
        wanted = estimate_evppi(gained, points[:, each], names)
        assert found[label].regression == wanted.regression
        assert found[label].lower == wanted.lower
    among, low = analysis.evpi_of_candidates(), analysis.evpi().low
    apart = 2 * (among.standard_error**2 + low.standard_error**2) ** 0.5
    for shift in (apart * 0.99, apart * 1.01):
        lost = np.full((40, 3), np.nan)
        lost[:, 0] = analysis.table.lost[:, 0] + 9
        own = mean_loss(lost[:, 0])
        target = among.value + 2 * np.hypot(among.standard_error, own.standard_error)
        lost[:, 0] += target - own.value + (shift - apart)
        moved = replace(analysis, table=replace(analysis.table, lost=lost))
        assert (MISSING in moved.evppi({"q": ["q"]})["q"].doubts) == (shift > apart)
    same = replace(analysis.table, lost=np.zeros((40, 3)), fixed=np.ones((40, 3)))
    assert MISSING not in replace(analysis, table=same).evppi({"q": ["q"]})["q"].doubts


def test_groups_are_those_given_or_each_alone_and_those_that_begin_alike() -> None:
    one = {name: Uncertain.of(name, "uniform", low=0, high=1)
           for name in ("a.x", "b", "a.y", "c.z", "d", "d.e")}  # fmt: skip
    row = Uncertain.of_row("row", ["r.u", "r.v"], [1, 2, 3])
    chosen = Uncertainty(parts=(one["a.x"], row, one["b"], one["a.y"], one["c.z"]), fixed={})
    assert groups_of(chosen, None) == [
        ("a.x", ("a.x",), [0]), ("row", ("r.u", "r.v"), [1, 2]), ("b", ("b",), [3]),
        ("a.y", ("a.y",), [4]), ("c.z", ("c.z",), [5]), ("a.*", ("a.x", "a.y"), [0, 4]),
    ]  # fmt: skip
    assert groups_of(chosen, {"some": ["a.y", "r.v"]}) == [("some", ("a.y", "r.v"), [4, 2])]
    assert groups_of(chosen, {}) == []
    bare = Uncertainty(parts=(one["d"], one["d.e"]), fixed={})
    assert [label for label, _, _ in groups_of(bare, None)] == ["d", "d.e"]
    group = '=give {"label": ["name", …]}'
    wrong: list[tuple[Any, str, str, str]] = [
        (["b"], "=['b'] names no groups", "=EVPPI", group),
        ({"some": "b"}, "={'some': 'b'} names no groups", "=EVPPI", group),
        ({"some": ["e"]}, "=unknown drawn parameter 'e'", "=EVPPI of some", "choose one of a.x"),
    ]
    for groups, *said in wrong:
        refused(partial(groups_of, chosen, groups), *said)
    fix = "=draw parameters, or give parameters= to CostEffectiveness.of"
    empty = Uncertainty(parts=(), fixed={})
    refused(lambda: groups_of(empty, None), "=no parameter of the draws is known", "=EVPPI", fix)


@pytest.mark.parametrize("draws", [1, 2, 19, 20, 40])
def test_the_report_has_the_numbers_of_the_analysis(draws: int) -> None:
    analysis = made_up(3, draws=draws)
    analysis = replace(analysis, start=psa(WAGERS, 1, uncertain=SAID).start)
    told = json.loads(analysis.report("mine", evppi=True).json())
    table, regret = analysis.table, analysis.regret()
    tolerances = tolerances_of([regret])
    share, low, high = analysis.acceptability(tolerances)
    accepted = told["acceptability"]
    assert accepted["policy"] == "mine"
    assert accepted["tolerance"] == pytest.approx(tolerances.tolist())
    assert accepted["probability"] == pytest.approx(share.tolist())
    assert accepted["low"] == pytest.approx(low.tolist())
    assert accepted["high"] == pytest.approx(high.tolist())
    for n in range(3):
        own = accepted["candidates"][f"policy {n}"]
        assert own == pytest.approx(analysis.acceptability(tolerances, n)[0].tolist())
        candidate = told["candidates"][n]
        assert candidate["mean"]["value"] == pytest.approx(table.fixed[:, n].mean())
        assert candidate["expected_loss"]["value"] == pytest.approx(analysis.regret(n).mean())
        assert candidate["probability_optimal"] == (analysis.regret(n) == 0).mean()
        assert candidate["draws_whose_optimum_it_was"] == n
    found = analysis.evpi()
    assert told["evpi"] == pytest.approx(found.high.value)
    assert told["evpi_bounds"]["low"]["value"] == pytest.approx(found.low.value)
    assert told["evpi_bounds"]["high"]["value"] == pytest.approx(found.high.value)
    assert told["evpi_bounds"]["best_policy"] == found.best
    assert told["evpi_of_candidates"]["value"] == pytest.approx(analysis.evpi_of_candidates().value)
    share, low, high = analysis.probability_optimal()
    for x, label in enumerate(("here", "there")):
        for a, action in enumerate("abc"):
            assert told["p_optimal"][label][action] == pytest.approx(
                {"probability": share[x, a], "low": low[x, a], "high": high[x, a]}
            )
    assert told["value"]["mean"] == pytest.approx(table.optimal.mean())
    assert told["regret"]["mean"] == pytest.approx(regret.mean())
    sd = np.std(table.optimal, ddof=1) if draws > 1 else None
    assert told["value"]["sd"] == (sd if sd is None else pytest.approx(sd))
    rows = analysis.report().tables["p_optimal"].rows
    assert rows == [
        {"": label, **{str(a): share[x, a] for a in range(3)}}
        for x, label in enumerate(("here", "there"))
    ]
    rows = analysis.report().tables["candidates"].rows
    assert [row["loss"] for row in rows] == [mean_loss(analysis.regret(n)) for n in range(3)]
    if draws >= 20:
        assert told["evppi"].keys() == {"p.one", "p.two", "q", "p.*"}
        values = [*told["evppi"].values()]
        assert values == sorted(values, reverse=True)
    else:
        assert told["evppi"] == {}
    every = estimate_quantiles(table.optimal)
    assert [each["value"] for each in told["value"]["quantiles"]] == [q["value"] for q in every]
    assert told["drawn"]["q"]["mean"] == 0.5
    assert told["drawn"]["q"]["sd"] == pytest.approx(12**-0.5)
    assert (told["draws"], told["seed"], told["claim"]) == (draws, 3, "estimated")
    reach = float(max((high - share).max(), (share - low).max()))
    title = analysis.report().tables["p_optimal"].title
    assert title.endswith(f"ends of Wilson's 95 % intervals are within {reach:.2g}")
    assert json.loads(analysis.report().json())["evppi"] == {}
    assert f"draws {draws};" in repr(analysis)


def test_what_is_drawn_fixed_and_assumed_is_counted() -> None:
    analysis = replace(made_up(3), start=psa(WAGERS, 1, uncertain=SAID).start)
    parts = analysis.uncertainty.parts
    facts = analysis.report().facts
    assert (facts["drawn"].text, facts["fixed"].text, facts["assumed"].text) == (
        "3 parameters", None, None,
    )  # fmt: skip
    assert "distributions are not stated" not in repr(analysis)
    other = Uncertainty(parts=parts[:1], fixed={"r": "no row", "s": "0"}, assumed=("p.one",))
    analysis = replace(analysis, uncertainty=other)
    facts = analysis.report().facts
    assert (facts["drawn"].text, facts["fixed"].text) == ("1 parameter", 2)
    assert (facts["fixed"].value, facts["assumed"].value) == (other.fixed, ("p.one",))
    said = "1 of 1 distributions are not stated, and rest on 100 observations each"
    assert facts["assumed"].text == other.assumption == said
    assert repr(analysis).endswith(f"; {said})")


def test_tables_have_16_rows_at_most_and_may_have_none() -> None:
    analysis = replace(made_up(3), start=psa(WAGERS, 1, uncertain=SAID).start)
    tables = analysis.report().tables
    assert [tables[key].first for key in ("p_optimal", "evppi_details")] == [16, 16]
    none = replace(analysis, labels=(), table=replace(analysis.table, counts=np.zeros((0, 3))))
    table = none.report().tables["p_optimal"]
    assert (table.rows, table.title.endswith("are within 0")) == ([], True)


def test_few_draws_that_carry_a_mean_are_told() -> None:
    analysis = replace(made_up(3), start=psa(WAGERS, 1, uncertain=SAID).start)
    (note,) = analysis.report().notes
    regret = mean_loss(analysis.regret())
    assert note.startswith(f"carried by few draws: regret by {regret.carried:.0f}, EVPI by ")
    nothing = replace(analysis.table, fixed=analysis.table.optimal[:, None] * np.ones(3),
                      lost=0 * analysis.table.lost)  # fmt: skip
    assert replace(analysis, table=nothing).report().notes == []


@pytest.mark.parametrize("above", [0, 1, 3, 4, 5])
def test_the_groups_whose_errors_are_above_evpi_are_told_with_their_remedy(
    above: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The three that are worth most are named, and the others counted."""
    analysis = replace(made_up(0), start=psa(WAGERS, 1, uncertain=SAID).start)
    among, known = analysis.evpi_of_candidates().value, dict[str, PartialInformation]()
    for k in range(6):
        error = among * (1.5 + k if k < above else 1.0)
        own = Estimated(value=k / 10, standard_error=error)
        known[f"group {k}"] = PartialInformation(parameters=(), regression=own, lower=own)
    monkeypatch.setattr(PSA, "evppi", lambda self: known)
    report = analysis.report(evppi=True)
    assert [*report.facts["evppi"].value] == [f"group {k}" for k in range(5, -1, -1)]
    notes = [note for note in report.notes if note.startswith("EVPPI")]
    named = [f"group {k}" for k in range(above - 1, -1, -1)]
    more = f" and {above - 3} more" if above > 3 else ""
    said = too_wide(among * (0.5 + above), among, 40) if above else []
    assert notes == [f"EVPPI of {', '.join(named[:3])}{more}: {each}" for each in said]


# ---- draws ---------------------------------------------------------------------------------------


def test_draws_come_in_blocks_of_streams_of_their_own_or_from_ones_sample() -> None:
    chosen = uncertainty(WAGERS, SAID)
    points = sample_parameters(WAGERS, chosen, 11, 5, 4)
    streams = np.random.SeedSequence(5).spawn(3)
    parts = [chosen.draw(s, n) for s, n in zip(streams, (4, 4, 3), strict=True)]
    assert np.array_equal(points, np.concatenate(parts))
    frame = pd.DataFrame({"q": [0.1, 0.2, 0.3], "p": [0.4, 0.5, 0.6]})
    sample = uncertainty(WAGERS, frame)
    assert sample_parameters(WAGERS, sample, None, 5, 4).tolist() == frame.to_numpy().tolist()
    assert sample_parameters(WAGERS, sample, 2, 5, 4).tolist() == frame.to_numpy()[:2].tolist()
    assert len(sample_parameters(WAGERS, sample, 3, 5, 4)) == 3
    wide = f"={2**40:,} points of 2 parameters take 70,369 GB of memory"
    cases: list[tuple[tuple[Any, Any], tuple[str, str, str]]] = [
        ((sample, 4), ("=4 draws of a sample of 3", "=n", "=ask for 3 or fewer")),
        ((chosen, None), ("=the number of draws is missing", "=n", "=say n=1000")),
        ((chosen, 0), ("0", "=n", "")),
        ((chosen, 2**40), (wide[1:], "=points", "=ask for fewer draws")),
        ((Uncertainty(parts=(), fixed={}), 5),
         ("=no parameter is uncertain", "=model", "state distributions (--uncertain FILE")),
    ]  # fmt: skip
    for how, said in cases:
        refused(partial(sample_parameters, WAGERS, *how, 5, 4), *said)
    outside = uncertainty(WAGERS, {"p": {"distribution": "normal", "mean": 0.5, "sd": 5}})
    fix = "=draw finite numbers within its range: a beta stays between 0 and 1, a gamma and a "
    fix += "log-normal above 0"
    refused(lambda: sample_parameters(WAGERS, outside, 20, 0, 8), "outside [0, 1]", "draw", fix)


def test_pieces_are_known_by_the_seed_and_what_is_drawn(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[Any, ...]] = []

    def note(solver: Any, points: Any, size: int, key: Any, how: Any) -> None:
        asked.append((key, how, size))
        raise ModelError("enough")

    monkeypatch.setattr("exact_mdp.analysis.vary.psa.StudyDraws", note)
    frame = pd.DataFrame({"q": [0.1, 0.2, 0.3], "p": [0.4, 0.5, 0.6]})
    betas = [["p", "beta", 1, 1], ["q", "beta", 2, 1]]
    own = [[["q", "sample"], ["p", "sample"]], hash_policies(frame.to_numpy())]
    usual = {"n_jobs": 1, "folder": None, "progress": False}
    other: dict[str, Any] = {"n_jobs": None, "folder": "here", "progress": True}
    for given, n, more, drawn in ((SAID, 2, {}, betas), (frame, None, other | {"rng": 7}, own)):
        with pytest.raises(ModelError, match="enough"):
            psa(WAGERS, n, uncertain=given, **more)
        how = usual | {name: more[name] for name in usual if name in more}
        assert asked.pop() == ({"seed": more.get("rng", 0), "drawn": drawn}, how, 64)


# ---- models --------------------------------------------------------------------------------------

P, Q = (Parameter(name=name, value="1/2", low=0, high=1) for name in "pq")


def wagers(at: Any) -> MDP:
    """Two steps of three wagers each, on p and on q; states 0 and 1 have the choices."""
    p, q = at["p"], at["q"]
    rows = [
        (0, 0, [(1, 1, p)]), (0, 1, [(1, 1, 1 - p)]), (0, 2, [(1, 1, "3/5")]),
        (1, 0, [(1, 2, q)]), (1, 1, [(1, 2, 1 - q)]), (1, 2, [(1, 2, 2 * q * p)]),
        (2, 0, [(1, 2, 0)]),
    ]  # fmt: skip
    return MDP.from_outcomes(rows, discount="1/2")


WAGERS = Family(parameters=(P, Q), build=wagers)
SAID = {"p": {"alpha": 1, "beta": 1}, "q": {"alpha": 2, "beta": 1}}


def policies() -> Iterator[tuple[int, int, int]]:
    for first, second in product(range(3), repeat=2):
        yield first, second, 0


def worth(policy: tuple[int, ...], points: np.ndarray, sense: int = 1) -> np.ndarray:
    p, q = points.T
    first = np.array([p, 1 - p, 0 * p + 0.6])[policy[0]]
    return np.asarray(sense * (first + np.array([q, 1 - q, 2 * p * q])[policy[1]] / 2))


Values = dict[tuple[int, int, int], np.ndarray]


def greedy(value: Values, given: list[tuple[int, int, int]], most: int = POOL) -> list[Any]:
    """Of the optima of the draws, add what wins most of what is left, until it is a hundredth."""
    best = np.max([*value.values()], axis=0)
    draws = range(len(best))
    optimum = [max(value, key=lambda each, d=d: value[each][d]) for d in draws]
    picked = [*given]

    def left() -> np.ndarray:
        behind = best - np.max([value[each] for each in picked], axis=0)
        return np.where(behind > 1e-12, behind, 0)

    def share(policy: tuple[int, int, int]) -> float:
        return float(sum(left()[d] for d in draws if optimum[d] == policy))

    total, some = left().sum(), np.sort(np.argsort(-left(), kind="stable")[:32])
    considered = sorted({*optimum}, key=share, reverse=True)[:most]
    pool = [each for each in considered if each not in picked and share(each) > 0]
    for _ in range(6):
        known = np.max([value[each] for each in picked], axis=0)
        gains = {
            each: max(np.maximum(value[each] - known, 0)[some].sum(), share(each)) for each in pool
        }
        first = max(gains, key=lambda each: gains[each], default=None)
        if first is None or gains[first] <= total / 100:
            break
        picked.append(first)
    return picked


@pytest.mark.parametrize("draws", [1, 2, 30, 32, 90])
@pytest.mark.parametrize("policy", ["optimal", [1, 1, 0]])
def test_candidates_are_added_while_they_win_a_hundredth(draws: int, policy: Any) -> None:
    for seed in range(3):
        analysis = psa(WAGERS, draws, rng=seed, uncertain=SAID, policy=policy)
        points = analysis.table.points
        value = {each: worth(each, points) for each in policies()}
        best = np.max([*value.values()], axis=0)
        assert analysis.table.optimal == pytest.approx(best)
        today = (2, 0, 0)
        given = [today] if policy == "optimal" else [(1, 1, 0), today]
        names = ["optimum today"] if policy == "optimal" else ["policy", "optimum today"]
        found = [tuple(int(x) for x in _row(each.weights)) for each in analysis.candidates]
        wanted = greedy(value, given)
        assert found == wanted
        added = [f"alternative {k + 1}" for k in range(len(wanted) - len(given))]
        assert [each.name for each in analysis.candidates] == names + added
        optimum = [max(value, key=lambda each, d=d: value[each][d]) for d in range(draws)]
        for n, each in enumerate(found):
            assert analysis.table.fixed[:, n] == pytest.approx(value[each])
            assert analysis.candidates[n].frequency == optimum.count(each)
            actions = analysis.candidates[n].actions
            assert actions == {"state 0": str(each[0]), "state 1": str(each[1])}
        assert analysis.labels == ("state 0", "state 1")
        assert analysis.actions == ("0", "1", "2")
        counts = [[sum(o[x] == a for o in optimum) for a in range(3)] for x in range(2)]
        assert analysis.table.counts.tolist() == counts
        firsts = [[max(v[d] for each, v in value.items() if each[0] == a) for a in range(3)]
                  for d in range(draws)]  # fmt: skip
        assert analysis.table.lost == pytest.approx(best[:, None] - np.array(firsts), abs=1e-12)
        assert analysis.start.value == pytest.approx(0.6 + 0.25)
        assert (analysis.model, analysis.seed, analysis.compiled) == ("model", seed, False)
        assert analysis.names == ("p", "q")


def _row(weights: np.ndarray) -> list[int]:
    return [int(weights[:3].argmax()), int(weights[3:6].argmax()), 0]


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("most", [3, POOL])
def test_candidates_are_chosen_among_those_that_win_most_where_there_are_many(
    seed: int, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six actions in each of two states, whose rewards are linear in two numbers."""
    monkeypatch.setattr("exact_mdp.analysis.vary.psa.POOL", most)
    rng = np.random.default_rng(seed)
    paid = rng.integers(-9, 10, (2, 6, 3))

    def build(at: Any) -> MDP:
        rows = [
            (s, a, [(1, s + 1, int(c) + int(d) * at["p"] + int(e) * at["q"])])
            for s in range(2)
            for a, (c, d, e) in enumerate(paid[s].tolist())
        ]
        return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])], discount="1/2")

    model = Family(parameters=(P, Q), build=build)
    wide = {name: {"distribution": "uniform", "low": 0, "high": 1} for name in "pq"}
    analysis = psa(model, 90, rng=seed, uncertain=wide, policy=[0, 1, 0])
    one = np.column_stack([np.ones(90), analysis.table.points])
    value = {
        (first, second, 0): one @ paid[0, first] + one @ paid[1, second] / 2
        for first, second in product(range(6), repeat=2)
    }
    center = np.array([1, 0.5, 0.5])
    today = max(value, key=lambda each: center @ paid[0, each[0]] + center @ paid[1, each[1]] / 2)
    found = [
        (int(each.weights[:6].argmax()), int(each.weights[6:12].argmax()), 0)
        for each in analysis.candidates
    ]
    assert found == greedy(value, [(0, 1, 0), today], most)
    assert len(found) > 2


class Tried:
    """Draws whose policies are numbers: what each is worth in each draw is a table (D, U)."""

    def __init__(self, worth: np.ndarray, sign: int, pool: int) -> None:
        self.worth, self.sign, self.pool = worth, sign, pool
        self.solver = self

    def hold_policy(self, row: np.ndarray) -> np.ndarray:
        return row

    def to_action_numbers(self, row: np.ndarray) -> np.ndarray:
        return row

    def evaluate_policies(self, points: np.ndarray, rows: list[np.ndarray]) -> dict[str, Any]:
        draws, policies = points[:, 0].astype(int), [int(row[0]) for row in rows]
        return {"value": self.sign * self.worth[np.ix_(draws, policies)]}

    def with_policies(self, table: Study, rows: list[np.ndarray]) -> Study:
        more = self.sign * self.worth[:, [int(row[0]) for row in rows]]
        error = np.hstack([table.error, table.error[:, 1:2] / 2])
        return replace(table, fixed=np.hstack([table.fixed, more]), error=error)


def select(
    worth: np.ndarray, error: np.ndarray, given: list[int], sign: int = 1, pool: int = 5
) -> tuple[list[int], list[int]]:
    """The numbers of the policies selected, and those of a search by loops."""
    draws, optimum = range(len(worth)), worth.argmax(axis=1)
    numbers, which = np.unique(optimum, return_inverse=True)
    table = replace(
        made_up(0, sense=sign, draws=len(worth)).table, optimal=sign * worth.max(axis=1),
        fixed=sign * worth[:, given], error=error, rows=numbers[:, None], which=which,
        points=np.arange(len(worth))[:, None],
    )  # fmt: skip
    named = [(f"given {k}", np.array([k])) for k in given]
    tried: Any = Tried(worth, sign, pool)
    found, after = _select_policies(tried, table, named)
    assert [name for name, _ in found[len(given) :]] == [
        f"alternative {k + 1}" for k in range(len(found) - len(given))
    ]
    assert np.array_equal(after.fixed, sign * worth[:, [int(row[0]) for _, row in found]])

    picked, off = [*given], error[:, 1:].max(axis=1) + error[:, 0]

    def lost(d: int) -> float:
        behind = worth[d].max() - worth[d, picked].max()
        return behind if behind > off[d] else 0.0

    def own(k: int) -> float:
        return sum(lost(d) for d in draws if optimum[d] == k)

    total = sum(map(lost, draws))
    most = sorted(draws, key=lambda d: -lost(d))[:pool]
    considered = sorted(numbers.tolist(), key=lambda k: -own(k))[:POOL]
    considered = [k for k in considered if own(k) > 0 and k not in given]

    def gain(k: int) -> float:
        best = worth[:, picked].max(axis=1)
        return max(own(k), sum(max(worth[d, k] - best[d], 0) for d in most))

    for _ in range(6):
        first = max(considered, key=gain, default=None)
        if first is None or gain(first) <= total / 100:
            break
        picked.append(first)
    return [int(row[0]) for _, row in found], picked


@pytest.mark.parametrize("sign", [1, -1])
def test_policies_are_selected_as_by_loops(sign: int) -> None:
    """Of numbers with many ties, in draws of which few count, and with errors that explain some."""
    counts = set()
    for seed in range(40):
        rng = np.random.default_rng(seed)
        draws, policies = int(rng.integers(1, 60)), int(rng.integers(2, 40))
        worth = rng.integers(-3, 4, (draws, policies)) * rng.choice([0.25, 1, 8], (draws, 1))
        error = rng.choice([0, 0.125, 0.25, 0.5, 4], (draws, 3))
        found, wanted = select(worth, error, rng.permutation(policies)[:2].tolist(), sign)
        assert found == wanted
        counts.add(len(found))
    assert counts >= {2, 3, 5, 8}


def test_at_most_six_are_added_of_24_and_the_first_of_those_that_are_alike() -> None:
    assert POOL == 24
    own = 1.0 + np.arange(40) % 3
    worth = np.hstack([np.zeros((40, 1)), np.diag(own)])
    nothing = np.zeros((40, 2))
    found, wanted = select(worth, nothing, [0])
    assert found == wanted == [0, 3, 6, 9, 12, 15, 18]


def test_a_hundredth_of_the_loss_is_too_little_and_so_is_what_errors_explain() -> None:
    nothing, worth = np.zeros((2, 2)), np.array([[0.0, 99.0, 0.0], [0.0, 0.0, 1.0]])
    assert select(worth, nothing, [0]) == ([0, 1], [0, 1])
    worth[1, 2] = 1.0625
    assert select(worth, nothing, [0]) == ([0, 1, 2], [0, 1, 2])
    # Of the optimum and the greatest of the policies: 1 + 4 in the first draw, 2 + 1 in the other.
    error = np.array([[1.0, 4.0, 2.0], [2.0, 0.5, 1.0]])
    for first, second, some in ((5.0, 3.0, []), (5.25, 3.0, [2]), (5.0, 3.25, [3]), (6, 4, [2, 3])):
        worth = np.array([[0.0, 0, first, 0], [0, 0, 0, second]])
        assert sorted(select(worth, error, [0, 1])[0]) == [0, 1, *some]


def test_costs_have_the_same_candidates() -> None:
    """The least cost is best: of the negated model, all values are the negated ones."""

    def costs(at: Any) -> MDP:
        return MDP.from_outcomes(
            [(s, a, [(1, n, -r)]) for s, a, ((_, n, r),) in _rows(at)], discount="1/2", sense="min"
        )

    def _rows(at: Any) -> list[Any]:
        p, q = at["p"], at["q"]
        from fractions import Fraction

        first, second = [p, 1 - p, Fraction(3, 5)], [q, 1 - q, 2 * q * p]
        rows: list[Any] = [(0, a, [(1, 1, r)]) for a, r in enumerate(first)]
        rows += [(1, a, [(1, 2, r)]) for a, r in enumerate(second)]
        return [*rows, (2, 0, [(1, 2, Fraction(0))])]

    one = psa(WAGERS, 60, rng=1, uncertain=SAID)
    other = psa(Family(parameters=(P, Q), build=costs), 60, rng=1, uncertain=SAID)
    assert [each.weights.tolist() for each in one.candidates] == [
        each.weights.tolist() for each in other.candidates
    ]
    assert np.array_equal(one.table.optimal, -other.table.optimal)
    assert np.array_equal(one.table.fixed, -other.table.fixed)
    assert other.evpi() == one.evpi()
    assert len(one.candidates) > 2


def test_the_size_of_what_is_not_stated_and_a_sample_of_ones_own() -> None:
    wide = psa(WAGERS, 200, rng=0, effective_sample_size=2)
    assert wide.uncertainty.default == 2
    frame = pd.DataFrame({"p": [0.25, 0.75], "q": [0.5, 1.0]})
    own = psa(WAGERS, uncertain=frame)
    assert own.table.points.tolist() == frame.to_numpy().tolist()
    assert own.table.optimal.tolist() == pytest.approx([0.75 + 0.25, 0.75 + 0.75])
