"""The distribution of the return, against brute force in fractions and against `evaluate`."""

from collections import defaultdict
from fractions import Fraction as F
from math import inf, isinf, isnan

import numpy as np
import pytest
from hypothesis import assume, given, settings
from oracle import classes, limit
from policy_cases import LAWFUL, Case, brute_force, coin, geometric, is_acyclic
from strategies import Pairs, any_models, model_of

from exact_mdp import MDP, Claim, ModelError, evaluate, return_distribution, simulate

CYCLIC_STEPS = 8


@pytest.fixture(params=[None, 0], ids=["dense", "sparse"])
def kind(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    if request.param is not None:
        monkeypatch.setattr("exact_mdp.solvers.values.return_mass.DENSE", request.param)


@settings(max_examples=60)
@given(LAWFUL)
def test_the_law_is_that_of_brute_force(case: Case) -> None:
    assume(case.ends)
    acyclic = is_acyclic(case)
    wanted, rest = brute_force(case, case.n_states if acyclic else CYCLIC_STEPS)
    assume(rest < 0.05)  # else the chain takes long to end, and there are very many returns
    for widest in (8, 0):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("exact_mdp.solvers.values.return_mass.DENSE", widest)
            law = return_distribution(case.model, case.weights)
        listed = law.as_dict()
        assert list(listed) == sorted(listed)
        assert rest or set(listed) == set(wanted)
        for value, error in zip(law.values, law.error, strict=True):
            low = wanted.get(value, F(0))
            assert low - F(error) <= F(listed[value]) <= low + rest + F(error)
        assert all(mass <= F(law.remaining) for x, mass in wanted.items() if x not in listed)
        assert law.claim is Claim.BOUNDED
        assert law.remaining <= (0 if acyclic else 1.01e-12)
        total = float(sum(wanted.values())) if acyclic else 1
        assert law.probabilities.sum() == pytest.approx(total, abs=3e-9)
    evaluation = evaluate(case.model, case.weights)
    assert law.mean == pytest.approx(evaluation.mean, rel=1e-8, abs=1e-7)
    assert law.sd == pytest.approx(evaluation.sd, rel=1e-5, abs=1e-4)
    if acyclic:
        law = return_distribution(case.model, case.weights, exact=True)
        assert dict(zip(law.values, law.exact or (), strict=True)) == wanted
        assert law.probabilities.tolist() == [float(wanted[x]) for x in law.values]
        assert case.floats or sum(law.exact or ()) == 1
    elif any(t == s for s in case.reached for _, t, *_ in case.outcomes[s] if s in case.live):
        with pytest.raises(ModelError, match="lead back"):
            return_distribution(case.model, case.weights, exact=True)


def test_ways_too_rare_for_floats_are_followed_exactly(kind: None) -> None:
    rare = F(1, 10**400)
    rows = [
        (0, 0, [(rare, 1, 1), (1 - rare, 3, 0)]),
        (1, 0, [(1, 2, 1)]),
        (2, 0, [(1, 3, 1)]),
        (3, 0, [(1, 3, 0)]),
        (4, 0, [(1, 3, 7)]),
    ]
    mdp = MDP.from_outcomes(rows, start={0: 1 - rare, 4: rare})
    exact = return_distribution(mdp, "random", exact=True)
    assert exact.values == (0, 3, 7)
    assert exact.exact == ((1 - rare) ** 2, rare * (1 - rare), rare)
    law = return_distribution(mdp, "random")
    assert law.values == (0,)
    assert law.remaining < 1e-280


def test_too_many_returns_are_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exact_mdp.solvers.values.return_mass.CELLS", 50)
    monkeypatch.setattr("exact_mdp.solvers.values.return_mass.STEPS", 50)
    for rewards in ((0, 9000), (0, 7, 9001), (0, 10**7, 3)):
        mdp = coin(*rewards, 1, ways=8)
        with pytest.raises(ModelError, match="too many") as caught:
            return_distribution(mdp, "random")
        assert "coarser" in caught.value.fix


def test_cdf_and_quantiles() -> None:
    law = return_distribution(coin(0, 1), "random")
    assert [law.cdf(x) for x in (-1, "-1/10", 0, 0.5, 1, 2)] == [0, 0, 0.5, 0.5, 1, 1]
    assert [law.quantile(p) for p in (0, 0.2, 0.5, 0.51, 1)] == [0, 0, 0, 1, 1]
    # Ten times a tenth is 1 - 10^-16 in floats, and reaches the median all the same.
    tenths = return_distribution(coin(*range(10)), "random")
    assert [tenths.quantile(p / 10) for p in range(1, 11)] == list(range(10))


@settings(max_examples=20)
@given(any_models(4))
def test_runs_without_end_are_a_return_of_their_own(model: Pairs) -> None:
    """Against the limits of the chain, and all that happens in some steps."""
    size, pairs = model
    rows = [next(pair for pair in pairs if pair[0] == s) for s in range(size)]
    reward, star = [r for _, _, r, _ in rows], limit(rows)
    mdp, lost, over = model_of(size, rows, F(1)), dict[float, F](), set[int]()
    for each in classes(rows):
        mean = sum(star[each[0]][t] * reward[t] for t in each)
        over |= {*each}
        if mean:
            sign = inf if mean > 0 else -inf
            lost[sign] = lost.get(sign, F(0)) + sum(star[0][t] for t in each)
        elif any(reward[t] for t in each) and any(star[0][t] for t in each):
            with pytest.raises(ModelError, match="cancel forever"):
                return_distribution(mdp, [0] * size)
            return
    endless = return_distribution(mdp, [0] * size)
    chances, errors = endless.as_dict(), dict(zip(endless.values, endless.error, strict=True))
    assert {x for x in chances if isinf(x)} == {sign for sign, p in lost.items() if p}
    for sign in chances.keys() & lost.keys():
        assert abs(F(chances[sign]) - lost[sign]) <= F(errors[sign])
    moving: dict[tuple[int, F], F] = {(0, F(0)): F(1)}
    for _ in range(12):
        following: dict[tuple[int, F], F] = defaultdict(F)
        for (s, total), mass in moving.items():
            for t, p in rows[s][3].items() if s not in over else ((s, F(1)),):
                following[t, total + (reward[s] if s not in over else 0)] += mass * p
        moving = following
    resting = {s for s in over if not reward[s] and not any(star[s][t] * reward[t] for t in over)}
    law, left = endless.as_dict(), sum((p for (s, _), p in moving.items() if s not in over), F(0))
    for value, error in errors.items():
        if isinf(value):
            continue
        low = sum((p for (s, total), p in moving.items() if s in resting and total == value), F(0))
        assert low - F(error) <= F(law[value]) <= low + left + F(error)
    assert sum(law.values()) == pytest.approx(1, abs=1e-9)
    if endless.never_ends:
        assert isnan(endless.mean) or endless.mean == evaluate(mdp, [0] * size).mean
        sampled = simulate(mdp, [0] * size, 400, 0)
        assert sampled.never_ends == pytest.approx(endless.never_ends, abs=0.15)
        assert sampled.mean == endless.mean or isnan(endless.mean) or not sampled.never_ends


def test_runs_of_both_infinities_have_no_mean() -> None:
    """Half the runs gain for ever and half lose; `evaluate` gives the limit of discounted means."""
    rows = [(0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]), (1, 0, [(1, 1, 2)]), (2, 0, [(1, 2, -1)])]
    mdp = MDP.from_outcomes(rows)
    assert evaluate(mdp, "random").mean == inf
    answers = return_distribution(mdp, "random"), return_distribution(mdp, "random", exact=True)
    for answer in (*answers, simulate(mdp, "random", 100, 0)):
        assert (isnan(answer.mean), isnan(answer.sd)) == (True, True)
        assert "mean nan" in repr(answer)
    assert (answers[1].values, answers[1].exact) == ((-inf, inf), (F(1, 2), F(1, 2)))
    assert simulate(mdp, "random", 1, 0).mean in (inf, -inf)


def test_runs_that_miss_a_goal() -> None:
    rows = [(0, 0, [("1/4", 1, 3), ("3/4", 2, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, labels={"home": [False, True, False]})
    for sense in ("max", "min"):
        law = return_distribution(mdp.with_(sense=sense).until("home"), "random", exact=True)
        assert law.as_dict() == {F(3): 0.25, inf: 0.75}
        assert law.exact == (F(1, 4), F(3, 4))
        assert (law.mean, law.never_ends, isnan(law.sd)) == (inf, 0.75, True)
        assert [law.quantile(q) for q in (0.2, 0.25, 0.3, 1)] == [3, 3, inf, inf]
        assert law.cdf(10) == 0.25
        assert law.frame()["probability"].sum() == 1
        assert "never ends" in law.plot().get_title(loc="left")
    lost = MDP.from_outcomes([(0, 0, [(1, 0, -1)])])
    law = return_distribution(lost, "random")
    assert (law.as_dict(), law.quantile(1), law.mean) == ({-inf: 1.0}, -inf, -inf)


def test_exact_quantiles_know_a_coin_that_is_hardly_unfair() -> None:
    rare = F(1, 10**17)
    rows = [(0, 0, [(F(1, 2) - rare, 1, 0), (F(1, 2) + rare, 1, 1)]), (1, 0, [(1, 1, 0)])]
    law = return_distribution(MDP.from_outcomes(rows), "random", exact=True)
    assert [law.quantile(share) for share in (0, 0.5, 0.4999999999999999, 1)] == [0, 1, 0, 1]
    fair = return_distribution(coin(1, 0), "random", exact=True)
    assert fair.quantile(0.5) == 0


def test_few_returns_on_a_fine_lattice_are_found() -> None:
    law = return_distribution(coin(10**9, F(1, 10**9), ways=3), "random")
    assert law.probabilities.tolist() == [0.125, 0.375, 0.375, 0.125]
    assert law.values[1] == 10**9 + F(2, 10**9)
    assert law.multiples.dtype == np.int64 or law.multiples.dtype == object
    huge = return_distribution(coin(F(10) ** 30, F(1, 7) ** 30), "random")
    assert huge.values == (F(1, 7) ** 30, F(10) ** 30)
    assert huge.cdf(1) == 0.5


def test_a_loop_is_followed_until_little_is_left() -> None:
    law = return_distribution(geometric("1/2"), "random")
    assert law.values[-1] == 0
    steps = [-int(value) for value in law.values]
    assert law.probabilities.tolist() == [0.5 ** (step + 1) for step in steps]
    assert 0 < law.remaining <= 1e-12
    assert law.probabilities.sum() + law.remaining == pytest.approx(1, abs=1e-15)
    assert max(steps) == 39  # 2^-40 < 10^-12
    assert law.tail_mean("1/1024") == pytest.approx(
        -11, abs=1e-6
    )  # at least 10: one more on average
    with pytest.raises(ModelError, match="are not listed"):
        law.tail_mean(law.remaining)


def test_a_quantile_may_be_asked_for_as_a_fraction() -> None:
    law = return_distribution(
        MDP.from_outcomes([(0, 0, [("1/4", 1, 0), ("3/4", 1, 8)]), (1, 0, [(1, 1, 0)])]), [0, 0]
    )
    assert [law.quantile(share) for share in ("1/4", "1/3", 0.25, 1)] == [0, 8, 0, 8]


def test_states_that_are_hardly_ever_left_are_refused_before_they_are_swept() -> None:
    rare = F(1, 10**300)
    mdp = MDP.from_outcomes([(0, 0, [(1 - rare, 0, 1), (rare, 1, 0)]), (1, 0, [(1, 1, 0)])])
    with pytest.raises(ModelError, match="the end is still to come"):
        return_distribution(mdp, [0, 0])
