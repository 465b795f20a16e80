"""Gain, bias and share of time of a policy, beside the limit of its powers in fractions."""

import json
from collections.abc import Iterator
from fractions import Fraction as F
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import Chances, given, random_policy, small_model

from exact_mdp import MDP
from exact_mdp.solvers.claims import SolverError, Status
from exact_mdp.solvers.endless.chain import FloatChain
from exact_mdp.solvers.values import average as module
from exact_mdp.solvers.values.average import AverageEvaluation, evaluate_average
from exact_mdp.solvers.values.policy_chain import PolicyChain


def cases(seeds: int = 16) -> Iterator[tuple[MDP, Chances, PolicyChain]]:
    for seed in range(seeds):
        mdp = small_model(seed, "1/2", leaving=False, ends=seed % 3)
        total = [r for _, _, r, _ in oracle.rows_of(mdp)]
        amounts = [0 if mdp.terminal[s] else F(k, 3) for k, s in enumerate(mdp.pair_state)]
        other = [r - x for r, x in zip(total, amounts, strict=True)]
        mdp = mdp.with_(components={"one": amounts, "other": other})
        chances = random_policy(mdp, seed, pure=seed % 4 == 0)
        yield mdp, chances, PolicyChain.of(mdp, given(chances))


def holds(mdp: MDP, chances: Chances, law: AverageEvaluation, most: float) -> None:
    chain = oracle.mixed(oracle.rows_of(mdp), chances)
    gain, bias = oracle.gain_and_bias(chain)
    star = oracle.limit(chain)
    share = [sum((p * star[s].get(t, F(0)) for s, p in mdp.start), F(0)) for t in range(len(chain))]
    for value, error, exact in (
        (law.value, law.error, gain),
        (law.bias, law.bias_error, bias),
        (law.share.value, law.share.error, share),
    ):
        for x, off, wanted in zip(value, error, exact, strict=True):
            assert abs(F(float(x)) - wanted) <= F(float(off))
            assert off <= most * (1 + abs(float(wanted)))
    inner = {s for each in oracle.classes(chain) for s in each}
    moves = [{} if s in inner else row for s, _, _, row in chain]
    often = oracle.visits(dict(mdp.start), moves)
    for state, found in enumerate(law.visits):
        exact = share[state] if state in inner else often[state]
        assert found == pytest.approx(float(exact), rel=1e-9, abs=1e-12)
    amounts, below = mdp.table.expected_components_exact()
    for number, name in enumerate(mdp.component_names):
        earned = sum(
            (
                share[s]
                * chance
                * F(int(amounts[mdp.pair(s, a), number]), int(below[mdp.pair(s, a)]))
                for (s, a), chance in chances.items()
            ),
            F(0),
        )
        part = law.components[name]
        assert abs(F(part.value) - earned) <= F(part.error) <= F(1, 10**8) * (1 + abs(earned))


def test_gain_bias_and_shares_are_those_of_the_limit() -> None:
    for mdp, chances, chain in cases():
        law = evaluate_average(chain)
        holds(mdp, chances, law, 1e-8)
        assert law.mean == law.start.value
        assert law.mdp.discount == 1


def test_rationals_give_them_where_floats_cannot(monkeypatch: pytest.MonkeyPatch) -> None:
    def unbounded(_: Any) -> Any:
        raise SolverError(Status.NO_BOUND)

    for name in ("evaluate_chain", "compute_limit_distribution"):
        with monkeypatch.context() as patch:
            patch.setattr(FloatChain, name, unbounded)
            for mdp, chances, chain in cases(4):
                holds(mdp, chances, evaluate_average(chain), 1e-15)


def test_poor_floats_are_replaced_and_good_ones_are_not(monkeypatch: pytest.MonkeyPatch) -> None:
    used = list[int]()
    expand = module.compute_laurent_expansion

    def counting(*given: Any) -> Any:
        used.append(1)
        return expand(*given)

    monkeypatch.setattr(module, "compute_laurent_expansion", counting)
    rows: Any = [(0, 0, [(1, 1, 5)]), (1, 0, [(F(1, 2), 0, 1), (F(1, 2), 1, 2)])]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    evaluate_average(chain)
    assert not used
    for place in range(2):
        seen = list[int]()

        def poor(*_: Any, place: int = place, seen: list[int] = seen) -> bool:
            seen.append(1)
            return len(seen) == place + 1

        with monkeypatch.context() as patch:
            patch.setattr(module, "is_too_inaccurate", poor)
            evaluate_average(chain)
            assert len(used) == place + 1
    with monkeypatch.context() as patch:
        shares = FloatChain.compute_limit_distribution

        def endless(own: FloatChain) -> Any:
            share, arrivals = shares(own)
            share.error[0] = np.inf
            return share, arrivals

        patch.setattr(FloatChain, "compute_limit_distribution", endless)
        patch.setattr(module, "is_too_inaccurate", lambda *_: False)
        evaluate_average(chain)
        assert len(used) == 3


def test_chances_below_the_range_of_floats_are_kept() -> None:
    rare = F(1, 10**310)
    rows: Any = [
        (0, 0, [(rare, 1, 3), (1 - rare, 0, 3)]),
        (1, 0, [(2 * rare, 0, 3), (1 - 2 * rare, 1, 3)]),
    ]
    law = evaluate_average(PolicyChain.of(MDP.from_outcomes(rows), "random"))
    assert law.value.tolist() == [3, 3]
    assert law.share.value == pytest.approx([2 / 3, 1 / 3], rel=1e-15)


def test_a_report_lists_states_unless_there_are_many(monkeypatch: pytest.MonkeyPatch) -> None:
    for mdp, _, chain in cases(1):
        law = evaluate_average(chain)
        for most, listed in ((mdp.n_states, True), (mdp.n_states - 1, False)):
            monkeypatch.setattr(module, "MOST_LISTED", most)
            facts = json.loads(law.report().json())
            assert facts["mean"] == law.mean
            assert facts["error_bound"] == law.start.error
            assert facts["recurrent_classes"] == len(oracle.classes(chain_rows(chain)))
            assert facts["components"] == {k: x.value for k, x in law.components.items()}
            assert (facts["by_state"] is not None) == listed
            if listed:
                (first, *_) = facts["by_state"].values()
                assert first["gain"] == law.value[0]
                assert first["bias"] == law.bias[0]
                assert first["share"] == law.share.value[0]
        table = law.report().tables["states"]
        assert [row["gain"] for row in table.rows.to_dict("records")] == law.value.tolist()
        frame = law.frame()
        assert frame["gain error"].tolist() == law.error.tolist()
        assert frame["bias error"].tolist() == law.bias_error.tolist()
        assert frame["share error"].tolist() == law.share.error.tolist()
        assert frame["state"].tolist() == mdp.space.labels(range(mdp.n_states))


def chain_rows(chain: PolicyChain) -> list[oracle.Row]:
    return oracle.rows_of(chain.model)
