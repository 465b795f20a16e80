"""Derivatives where some policy never ends: against differences of exact optima."""

from fractions import Fraction as F
from math import inf, isfinite

import pytest
from endless_oracle import best
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from strategies import Pairs, any_models, model_of

from exact_mdp.analysis.sensitivity import gradient, thresholds, value_function
from exact_mdp.mdp import MDP, ModelError, moving
from exact_mdp.solvers import certify

STEP = F(1, 10**9)
WAIT = [
    (0, 0, [(1, 0, 0)]),
    (0, 1, [(1, 2, 5)]),
    (1, 0, [(1, 1, -1)]),
    (2, 0, [(1, 2, 0)]),
]


@given(model=any_models(3), data=st.data())
@settings(max_examples=40)
def test_slopes_of_rewards(model: Pairs, data: st.DataObject) -> None:
    """The optimum is linear in a reward near today's: a difference is the derivative."""
    size, pairs = model
    rewards = sorted({r for *_, r, _ in pairs})
    own = data.draw(st.sampled_from(rewards))
    values, swings = best(pairs, size)
    assume(not swings)

    def optimum(step: F) -> F | float:
        moved = [(s, a, r + step * (r == own), row) for s, a, r, row in pairs]
        return best(moved, size)[0][0]

    family = moving(model_of(size, pairs, F(1)), {}, {"x": own})
    try:
        found = gradient(family, names=["x"])["x"]
    except ModelError as error:
        near = [optimum(STEP), values[0], optimum(-STEP)]
        told = str(error)
        assert (
            not all(map(isfinite, near))
            or "infinite" in told
            or "cancel" in told
            or ("terminal" in told)
        )
        return
    for side, sign in ((found.left, -1), (found.right, 1)):
        assert side is not None
        assert side.value == (optimum(sign * STEP) - values[0]) / (sign * STEP)


@given(model=any_models(3), data=st.data())
@settings(max_examples=40)
def test_slopes_of_chances_and_of_the_discount(model: Pairs, data: st.DataObject) -> None:
    size, pairs = model
    mdp = model_of(size, pairs, F(1))
    spread = [(s, a, t, p) for s, a, _, row in pairs for t, p in row.items() if len(row) > 1]
    assume(spread and not best(pairs, size)[1])
    s, a, t, p = data.draw(st.sampled_from(spread))
    family = moving(mdp, {"p": [(mdp.pair(s, a), t)]})
    name = data.draw(st.sampled_from(["p", "discount"]))
    try:
        found = gradient(family, names=[name])[name]
        today = certify(mdp).start_value
    except ModelError:
        return
    step = F(1, 10**7)
    for side, sign in ((found.left, -1), (found.right, 1)):
        if side is None:
            continue
        near = certify(family.at({name: (p if name == "p" else 1) + sign * step})).start_value
        slope = (near - today) / (sign * step)
        assert float(side.value) == pytest.approx(float(slope), rel=1e-3, abs=1e-3)


def test_waiting_attains_nothing() -> None:
    mdp = MDP.from_outcomes(WAIT)
    found = gradient(mdp)
    assert [found["reward.5"].left, found["reward.5"].right] == [found["reward.5"].value] * 2
    assert found["reward.5"].value.value == 1
    assert found["discount"].left.value == 0


def test_what_may_be_infinite_is_refused() -> None:
    # What is lost and what comes back cancel; a little more, and it gains for ever.
    around = [(0, 0, [(1, 1, -7)]), (1, 0, [(1, 0, 7)]), (1, 1, [(1, 2, 9)]), (2, 0, [(1, 2, 0)])]
    with pytest.raises(ModelError, match="rewards cancel for ever"):
        gradient(moving(MDP.from_outcomes(around), {}, {"x": -7}), names=["x"])
    idle = moving(MDP.from_arrays([[[0, 1], [1, 0]]], [0, 0]), {}, {"x": 0})
    with pytest.raises(ModelError, match="falls without end"):
        gradient(idle, names=["x"])
    lost = MDP.from_outcomes([(0, 0, [(1, 0, -1)])])
    with pytest.raises(ModelError, match="the optimal value is -∞"):
        gradient(lost)
    assert certify(lost).start_value == -inf


def test_thresholds_and_curves() -> None:
    mdp = MDP.from_outcomes(WAIT)
    for engine in (thresholds, value_function):
        assert engine(mdp, "discount").range.high < 1
    # Rows of floats that sum to a little more than 1 count as divided by their sums.
    thirds = [0.1, 0.2, 0.3, 0.4 + 1e-16]
    row = [(p, to, 0.0) for to, p in enumerate([*thirds[:3], 1 - sum(thirds[:3])])]
    floats = MDP.from_outcomes(
        [
            (0, 0, row),
            (1, 0, [(1, 0, 0)]),
            (2, 0, [(1 / 3, 1, 0), (1 / 3, 2, 0), (1 / 3 + 1e-16, 0, 0)]),
            (2, 1, [(1, 2, 0)]),
            (3, 0, [(1, 4, 1)]),
            (4, 0, [(1, 4, 0)]),
        ]
    )
    curve = value_function(floats, "discount")
    assert curve.violations() == []
    assert float(curve.at("1/2")) == pytest.approx(
        float(certify(floats.with_(discount="1/2")).start_value)
    )
