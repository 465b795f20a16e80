"""The law of the return, beside all runs of models without cycles and sums of geometric series."""

from bisect import bisect_right
from collections.abc import Iterator
from fractions import Fraction as F
from itertools import accumulate
from math import inf, isnan, sqrt
from typing import Any

import numpy as np
import pytest
from small_models import Chances, given, law_of_return, random_policy, small_model

from exact_mdp import MDP, ModelError, return_distribution
from exact_mdp.solvers.bounds.gains import UNIT
from exact_mdp.solvers.values import returns as module
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.returns import ReturnDistribution, tail_mean

SHARES = [F(1, 20), F(1, 3), F(1, 2), F(4, 5), F(1)]


def laws(exact: bool, seeds: int = 20) -> Iterator[tuple[dict[F, F], ReturnDistribution]]:
    for seed in range(seeds):
        mdp = small_model(seed, falling=True, by_outcome=seed % 2 == 0)
        chances: Chances = random_policy(mdp, seed, pure=seed % 3 == 0)
        law = return_distribution(mdp, given(chances), exact=exact)
        yield law_of_return(mdp, chances), law


def in_order(law: dict[F, F], share: F, highest: bool) -> F:
    """The mean of a share of the returns, from one end."""
    total, left = F(0), share
    for value in sorted(law, reverse=highest):
        part = min(left, law[value])
        total, left = total + part * value, left - part
    return total / share


def test_exact_laws_are_those_of_all_runs() -> None:
    for runs, law in laws(exact=True):
        assert law.exact is not None
        assert dict(zip(law.values, law.exact, strict=True)) == runs
        assert law.as_dict() == {value: float(chance) for value, chance in runs.items()}
        assert law.remaining == 0
        assert (law.error <= UNIT).all()
        below = [*accumulate(runs.values())]
        for share in SHARES:
            wanted = min(v for v, total in zip(runs, below, strict=True) if total >= share)
            assert law.quantile(share) == wanted
            assert law.tail_mean(share) == in_order(runs, share, False)
            assert law.tail_mean(share, highest=True) == in_order(runs, share, True)
        assert law.quantile(0) == min(runs)
        for total, value in zip(below, runs, strict=True):
            assert law.quantile(total) == value  # reached exactly


def test_float_laws_are_as_near_as_they_say() -> None:
    for runs, law in laws(exact=False):
        assert law.exact is None
        assert [*law.values] == [*runs]
        for chance, error, exact in zip(law.probabilities, law.error, runs.values(), strict=True):
            assert abs(F(float(chance)) - exact) <= F(float(error)) <= exact * F(1, 10**12)
        mean = sum(v * p for v, p in runs.items())
        assert law.mean == pytest.approx(float(mean), rel=1e-12, abs=1e-12)
        sd = sqrt(sum(v * v * p for v, p in runs.items()) - mean**2)
        assert law.sd == pytest.approx(sd, rel=1e-9, abs=1e-7)
        below = [*accumulate(runs.values())]
        for value in [*runs, min(runs) - 1, max(runs) + 1, *(v + F(1, 1000) for v in runs)]:
            count = bisect_right([*runs], value)
            wanted = float(below[count - 1]) if count else 0.0
            assert law.cdf(value) == pytest.approx(wanted, rel=1e-12, abs=0)
        for total, value in zip(below, runs, strict=True):
            assert law.quantile(total) == value  # a cdf that misses it by rounding reaches it
        for share in SHARES:
            wanted = float(in_order(runs, share, False))
            assert law.tail_mean(share) == pytest.approx(wanted, rel=1e-11, abs=1e-11)
        assert law.never_ends == 0
        assert law.remaining < 1e-280


def test_a_share_that_is_missed_by_more_than_rounding_is_not_reached() -> None:
    rows: Any = [(0, 0, [(F(1, 2), 1, 1), (F(1, 2), 1, 2)]), (1, 0, [(1, 1, 0)])]
    for exact in (True, False):
        law = return_distribution(MDP.from_outcomes(rows), "random", exact=exact)
        assert law.quantile("1/2") == law.quantile(0.5) == 1
        assert law.quantile("0.500000000001") == 2
        assert law.quantile(1) == 2
        for share in (-0.1, "11/10"):
            with pytest.raises(ModelError, match="no quantile is at"):
                law.quantile(share)


def test_a_law_is_listed_on_its_lattice() -> None:
    """The unit is the greatest of which all rewards that can be earned are multiples."""
    rows: Any = [
        (0, 0, [(F(1, 2), 1, F(3, 4)), (F(1, 2), 1, F(-9, 10))]),
        (0, 1, [(1, 1, F(1, 7))]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 1, F(1, 11))]),
    ]
    law = return_distribution(MDP.from_outcomes(rows), [0, 0, 0])
    assert law.unit == F(3, 20)
    assert law.multiples.tolist() == [-6, 5]
    assert law.values == (F(-9, 10), F(3, 4))
    assert return_distribution(MDP.from_outcomes(rows), [1, 0, 0]).unit == F(1, 7)
    nothing = return_distribution(MDP.from_outcomes(rows, start=1), [0, 0, 0])
    assert nothing.values == (0,)
    assert nothing.probabilities.tolist() == [1]


def test_long_multiples_are_integers_of_python() -> None:
    big = F(2**31)
    for far, kind in ((big - 1, np.int64), (big, object), (big * 10**30 + 1, object)):
        for sign in (1, -1):
            rows: Any = [(0, 0, [(1, 1, sign * far)]), (1, 0, [(1, 2, 1)]), (2, 0, [(1, 2, 0)])]
            law = return_distribution(MDP.from_outcomes(rows), "random")
            assert law.values == (sign * far + 1,)
            chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
            assert module.find_lattice(chain.table, chain.source >= 0)[0].dtype == kind


def test_runs_without_an_end_have_infinite_returns() -> None:
    rows: Any = [
        (0, 0, [(F(1, 2), 1, 3), (F(1, 6), 2, 1), (F(1, 3), 3, F(1, 2))]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 1)]),
        (3, 0, [(1, 3, -1)]),
    ]
    law = return_distribution(MDP.from_outcomes(rows), "random", exact=True)
    assert law.values == (-inf, 3, inf)
    assert law.exact == (F(1, 3), F(1, 2), F(1, 6))
    assert law.never_ends == pytest.approx(0.5)
    assert isnan(law.mean)
    assert isnan(law.sd)
    assert (law.quantile("1/3"), law.quantile("1/2"), law.quantile(1)) == (-inf, 3, inf)
    assert law.cdf(100) == pytest.approx(5 / 6)
    assert law.tail_mean("1/2", highest=True) == inf
    gaining = [(0, 0, [(F(1, 2), 1, 3), (F(1, 2), 2, 1)]), *rows[1:]]
    assert return_distribution(MDP.from_outcomes(gaining), "random").mean == inf


def test_a_cycle_is_a_geometric_series() -> None:
    """A state that stays with chance q pays q^(k-1) (1 - q) times k."""
    for q in (F(1, 10), F(1, 2)):
        rows: Any = [(0, 0, [(q, 0, 1), (1 - q, 1, 1)]), (1, 0, [(1, 1, 0)])]
        law = return_distribution(MDP.from_outcomes(rows), "random")
        assert 0 < law.remaining <= 1.1e-12
        for value, chance, error in zip(law.values, law.probabilities, law.error, strict=True):
            exact = q ** (int(value) - 1) * (1 - q)
            assert abs(F(float(chance)) - exact) <= F(float(error))
        assert 1 - law.probabilities.sum() <= law.remaining + 1e-15
        if q == F(1, 2):  # whose powers are floats
            assert 1 - sum(map(F, law.probabilities.tolist())) <= F(law.remaining)
        with pytest.raises(ModelError, match="are not listed"):
            law.tail_mean(F(law.remaining))
        assert law.tail_mean(F(law.remaining) * F(1001, 1000)) == 1
        with pytest.raises(ModelError, match="lead back to each other"):
            return_distribution(MDP.from_outcomes(rows), "random", exact=True)


def test_a_horizon_ends_runs() -> None:
    rows: Any = [(0, 0, [(F(1, 2), 0, 1), (F(1, 2), 1, 1)]), (1, 0, [(1, 1, 0)])]
    law = return_distribution(MDP.from_outcomes(rows), "random", exact=True, horizon=3)
    assert dict(zip(law.values, law.exact or (), strict=True)) == {
        1: F(1, 2),
        2: F(1, 4),
        3: F(1, 4),
    }
    with pytest.raises(ModelError, match="not on a lattice"):
        return_distribution(MDP.from_outcomes(rows, "1/2"), "random")


def test_a_table_is_read_as_it_is_said() -> None:
    choice = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])])
    table = np.array([[0.25, 0.75], [1, 0]])
    assert return_distribution(choice, table, kind="q").values == (2,)
    assert return_distribution(choice, table, kind="policy").values == (1, 2)


def law_of(probabilities: list[float], multiples: Any = None, unit: F = F(1)) -> ReturnDistribution:
    """A law without errors, of returns 1, 2, 3, … unless others are given."""
    listed = np.arange(1, len(probabilities) + 1) if multiples is None else np.array(multiples)
    return ReturnDistribution(
        multiples=listed,
        unit=unit,
        probabilities=np.array(probabilities),
        relative_error=0.0,
        remaining=0.0,
    )


def test_sums_that_are_rounded_reach_a_share() -> None:
    """Eight tenths, added up one by one, are less than 0.8."""
    law = law_of([0.1] * 10)
    assert law.probabilities[:8].cumsum()[-1] < 0.8
    for k in range(1, 11):
        assert law.quantile(F(k, 10)) == k
    assert law_of([0.25, 0.25]).quantile(1) == 2  # what is not listed is beyond all
    assert (law_of([0.0]).error > 0).all()  # underflow


def test_a_cdf_compares_exact_numbers() -> None:
    law = law_of([0.5, 0.5])
    assert law.cdf(1 - F(1, 10**30)) == 0
    assert law.cdf(1) == law.cdf(2 - F(1, 10**30)) == 0.5
    long = law_of([0.5, 0.5], unit=F(1, 3**50))
    assert long.cdf(F(1, 3**50)) == 0.5


def test_errors_count_all_roundings() -> None:
    """So many roundings n may be as much as n u / (1 - n u) of a number."""
    for seed in range(6):
        mdp = small_model(seed, falling=True)
        chain = PolicyChain.of(mdp, given(random_policy(mdp, seed)))
        flow = module.MassFlow(
            chain, module.find_lattice(chain.table, chain.source >= 0)[0], {}, exact=False
        )
        size = flow.carry_mass()[3] * F(UNIT)
        assert F(return_distribution(mdp, chain).relative_error) >= size / (1 - size)


def test_a_spread_beyond_floats_is_infinite() -> None:
    largest = law_of([1.0, 2.0**-52], [1, 1], F(2**1024 - 2**971))  # chances are rounded
    assert largest.mean == inf
    assert law_of([0.5, 0.5], [-1, 1], F(10**200)).sd == inf
    law = law_of([0.5, 0.5], np.array([1, inf], dtype=object))
    assert law.mean == inf
    assert isnan(law.sd)


def test_a_lattice_of_long_denominators() -> None:
    rows: Any = [(0, 0, [(1, 1, F(1, 3**40))]), (1, 0, [(1, 2, F(1, 7**30))]), (2, 0, [(1, 2, 0)])]
    law = return_distribution(MDP.from_outcomes(rows), "random")
    assert law.values == (F(1, 3**40) + F(1, 7**30),)


def test_the_share_of_a_tail_is_above_0_and_at_most_1() -> None:
    law = return_distribution(MDP.from_outcomes([(0, 0, [(1, 0, 0)])]), "random")
    for share in (0, "1.001", -1):
        with pytest.raises(ModelError, match="share is"):
            law.tail_mean(share)
    assert tail_mean({inf: F(1, 2), F(3): F(1, 2)}, F(1, 2)) == 3
    assert tail_mean({inf: F(1, 2), F(3): F(1, 2)}, F(1, 2), highest=True) == inf
    assert tail_mean({-inf: F(1, 2), F(3): F(1, 2)}, F(3, 4)) == -inf


def test_errors_are_relative_and_count_what_is_missing() -> None:
    law = ReturnDistribution(
        multiples=np.array([1, 2]),
        unit=F(1, 2),
        probabilities=np.array([0.25, 0.75]),
        relative_error=2.0**-10,
        remaining=2.0**-8,
    )
    assert law.error == pytest.approx([2.0**-12 + 2.0**-8, 0.75 * 2.0**-10 + 2.0**-8], rel=1e-15)
    # A cdf may miss a share by all of these, and by no more.
    slack = 2.0**-10 + 2.0**-8
    assert law.quantile(F(1, 4) + F(slack)) == F(1, 2)
    assert law.quantile(F(1, 4) + F(slack) * F(1001, 1000)) == 1
    assert law.quantile(1) == 1
    frame = law.frame()
    assert frame.index.tolist() == [F(1, 2), F(1)]
    assert frame["probability"].tolist() == [0.25, 0.75]
    assert frame["error"].tolist() == law.error.tolist()


def test_the_table_of_a_report_adds_up_chances() -> None:
    for runs, law in laws(exact=True, seeds=2):
        report = law.report()
        rows = report.tables["distribution"].rows
        assert [row["chance"] for row in rows] == law.probabilities.tolist()
        assert [row["sum"] for row in rows] == [*accumulate(law.probabilities.tolist())]
        assert report.tables["distribution"].first == module.MOST_LISTED
        assert report.facts["remaining"].value == law.remaining
        assert report.facts["never_ends"].value == law.never_ends
        assert report.facts["error_bound"].value == law.error.max()
        assert report.facts["remaining"].text == report.facts["never_ends"].text is None
        assert report.facts["mean"] == law.mean
        assert report.facts["sd"] == law.sd
        assert [*report.facts["exact_distribution"].values()] == [*runs.values()]
    rows: Any = [(0, 0, [(F(1, 2), 0, 1), (F(1, 4), 1, 1), (F(1, 4), 2, 0)]), (1, 0, [(1, 1, 0)])]
    law = return_distribution(MDP.from_outcomes([*rows, (2, 0, [(1, 2, 1)])]), "random")
    for name in ("remaining", "never_ends"):
        assert law.report().facts[name].text == getattr(law, name) > 0
