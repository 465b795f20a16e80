"""A certificate of a regret: its record, the model of a policy alone, its proof, the difference."""

from fractions import Fraction as F
from math import inf, isnan

import pytest
from oracle import mixed, rows_of
from proof_models import LOOP, of
from small_models import given, random_policy, small_model

from exact_mdp import certify, check, fingerprint
from exact_mdp.mdp.io import model_json
from exact_mdp.solvers.exact import checker, codec
from exact_mdp.solvers.exact.regret import (
    DrawnPairs,
    _compute_loss,
    _isolate_policy,
    _prove_value,
    certify_regret,
)
from exact_mdp.solvers.values.policy_chain import PolicyChain


def test_pairs_are_in_rising_order_with_their_probabilities() -> None:
    drawn = DrawnPairs.of({3: F(1, 3), 0: F(1), 2: F(2, 3)})
    assert drawn.pairs.tolist() == [0, 2, 3]
    assert drawn.weights.to_fractions().tolist() == [1, F(2, 3), F(1, 3)]
    assert drawn.to_numbers() == {0: 1, 2: F(2, 3), 3: F(1, 3)}


def test_it_shows_values_and_their_difference() -> None:
    mdp = of(LOOP, discount="1/2", sense="min")
    proof = check(mdp, {0: 1, 1: {0: "1/2", 1: "1/2"}}).certificate
    assert proof.criterion == "total"
    assert proof.start.value == proof.regret == proof.value.start_value - proof.optimum.start_value
    lost, own, best = (float(x) for x in (proof.regret, proof.value.start_value,
                                          proof.optimum.start_value))  # fmt: skip
    said = f"regret {lost:.12g}: worth {own:.12g} at the start, the optimum {best:.12g}"
    assert repr(proof) == f"RegretCertificate({said})"
    frame = proof.frame()
    assert frame["optimal"].tolist() == proof.optimum.value.tolist()
    assert frame["learned"].tolist() == proof.value.value.tolist()
    assert [*frame.columns] == ["state", "optimal", "learned"]


@pytest.mark.parametrize("pure", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_the_model_of_a_policy_alone_is_what_both_sides_make_of_it(seed: int, pure: bool) -> None:
    mdp = small_model(seed, "9/10", sense="min")
    chances = random_policy(mdp, seed, pure=pure)
    chain = PolicyChain.of(mdp, given(chances))
    alone = _isolate_policy(chain)
    assert rows_of(alone) == mixed(rows_of(mdp), chances)
    content = model_json.encode_model(mdp)
    proof = codec.build_file_content(certify_regret(chain, average=False), int)
    read = checker.Model(content).isolate(content, proof["policy"])
    assert read.digest() == fingerprint(alone) == proof["value"]["model"]


@pytest.mark.parametrize("average", [True, False])
def test_the_certificate_belongs_to_the_model_that_was_asked(average: bool) -> None:
    mdp = small_model(4, "9/10", sense="min", ends=0, leaving=False)
    proof = certify_regret(PolicyChain.of(mdp, "random"), average=average)
    assert proof.mdp is mdp
    assert proof.criterion == proof.value.kind == ("average" if average else "total")
    assert proof.regret == proof.value.start_value - proof.optimum.start_value > 0
    assert proof.violations() == []
    assert _isolate_policy(PolicyChain.of(mdp, "random")).actions == ("drawn",)


@pytest.mark.parametrize("criterion", ["total", "average"])
def test_the_proof_of_costs_is_that_of_negated_rewards(criterion: str) -> None:
    mdp = small_model(2, "1/2", sense="min")
    proof = certify(mdp.maximised, criterion=criterion).negated(mdp)
    assert proof.violations() == []
    assert proof.start_value == certify(mdp, criterion=criterion).start_value


def test_the_value_is_proven_as_the_optimum_is() -> None:
    endless = small_model(1, leaving=False, start=0)
    alone = _isolate_policy(PolicyChain.of(endless, given(random_policy(endless, 0))))
    for best in (certify(endless), certify(endless, criterion="average"), certify(alone)):
        proof = _prove_value(alone, best)
        assert (proof.kind, proof.g is None) == (best.kind, best.g is None)
        assert proof.violations() == []
    ends = small_model(1, falling=True)
    alone = _isolate_policy(PolicyChain.of(ends, given(random_policy(ends, 0))))
    proof = _prove_value(alone, certify(ends))
    assert proof.g is None is not proof.rank
    assert _prove_value(alone, certify(ends, criterion="average")).kind == "average"


def test_the_loss_of_values_that_may_be_infinite() -> None:
    reward, cost = small_model(0, "1/2"), small_model(0, "1/2", sense="min")
    assert _compute_loss(reward, F(3), F(1, 2)) == F(5, 2)
    assert _compute_loss(cost, F(1, 2), F(3)) == F(5, 2)
    huge = F(10) ** 400  # which no float holds
    assert _compute_loss(reward, inf, huge) == _compute_loss(reward, huge, -inf) == inf
    assert _compute_loss(cost, -inf, huge) == _compute_loss(cost, huge, inf) == inf
    assert isnan(_compute_loss(reward, inf, inf))
