"""The record of a regret's certificate."""

from fractions import Fraction as F

from proof_models import LOOP, of

from exact_mdp import check
from exact_mdp.solvers.exact.regret import DrawnPairs


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
