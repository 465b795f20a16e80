"""Published values of given policies, against a solver in exact rationals that shares no code.

Published optima are those of `test_certificate`, which is held against the same solver.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from fractions import Fraction

import pytest
from cases import BY_NAME, CASES, Case
from cases.case import Number
from oracle import evaluate_exact, every_policy_ends, mixed, solve_exact


def differences(
    case: Case, published: Mapping[int, Number], exact: Sequence[Fraction]
) -> dict[int, tuple[float, float]]:
    """The states where a published number is not the exact one, to as many digits as it has."""
    return {
        s: (float(number), float(exact[s]))
        for s, number in published.items()
        if not (
            number == exact[s]
            if isinstance(number, Fraction)
            else abs(number - exact[s]) <= case.tolerance
        )
    }


@pytest.mark.parametrize("case", CASES, ids=str)
def test_model_is_complete(case: Case) -> None:
    assert case.source
    assert BY_NAME[case.name] is case
    assert 0 <= case.discount <= 1
    assert {s for s, *_ in case.pairs} == set(range(case.n_states))
    assert len({(s, a) for s, a, *_ in case.pairs}) == len(case.pairs)
    for _, _, _, row in case.pairs:
        assert sum(row.values()) == 1
        assert min(row.values()) > 0
        assert set(row) <= set(range(case.n_states))


@pytest.mark.parametrize("case", [case for case in CASES if case.wrong_policy], ids=str)
def test_wrong_policy_is_worse(case: Case) -> None:
    values = evaluate_exact(case.n_states, case.pairs, case.discount, case.wrong_policy)
    best = solve_exact(case.n_states, case.pairs, case.discount)[0]
    assert all(v <= b for v, b in zip(values, best, strict=True))
    assert values[case.start] < best[case.start]
    assert differences(case, case.wrong_values, values) == {}


@pytest.mark.parametrize("case", [case for case in CASES if case.uniform_values], ids=str)
def test_uniform_policy(case: Case) -> None:
    many = Counter(s for s, *_ in case.pairs)
    chain = mixed(case.pairs, {(s, a): Fraction(1, many[s]) for s, a, *_ in case.pairs})
    values = evaluate_exact(case.n_states, chain, case.discount, dict.fromkeys(many, 0))
    assert differences(case, case.uniform_values, values) == {}


def test_reference_refuses() -> None:
    loop = [(0, 0, Fraction(-1), {0: Fraction(1)}), (1, 0, Fraction(0), {1: Fraction(1)})]
    assert not every_policy_ends(2, loop)
    with pytest.raises(ValueError, match="never ends"):
        solve_exact(2, loop, Fraction(1))
    with pytest.raises(ValueError, match="given twice"):
        solve_exact(2, [*loop, loop[0]], Fraction(1, 2))
    with pytest.raises(ValueError, match="not a distribution"):
        solve_exact(1, [(0, 0, Fraction(0), {0: Fraction(9, 10)})], Fraction(1, 2))
