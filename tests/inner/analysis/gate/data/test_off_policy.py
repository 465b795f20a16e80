"""Trajectories of another policy, reweighted: beside a loop over episodes."""

from fractions import Fraction as F
from typing import Any

import numpy as np
import pandas as pd
import pytest
from records import NAMES, POLICY, STAGES, recorded

from exact_mdp import MDP, ModelError, OffPolicy, Robust
from exact_mdp.analysis.gate.data.off_policy import _read_trajectories
from exact_mdp.analysis.vary.intervals import mean_at_least
from exact_mdp.mdp.io import transitions

Episode = tuple[float, float, int, bool]


def own_of(mdp: MDP, actions: Any = POLICY) -> np.ndarray:
    taken = mdp.pair_action == np.array(actions)[..., mdp.pair_state]
    return np.asarray(taken | mdp.forced[mdp.pair_state], dtype=float)


def looped(
    mdp: MDP, frame: pd.DataFrame, own: np.ndarray, chance: np.ndarray, horizon: int | None
) -> list[Episode]:
    """Weight, return, length and whether it was cut off, episode by episode."""
    found = list[Episode]()
    for _, rows in frame.groupby("episode", sort=False):
        weight, total, steps = 1.0, 0.0, 0
        for _, row in rows.iterrows():
            if horizon is not None and steps == horizon:
                break
            pair = mdp.pair(str(row["state"]), str(row["action"]))
            policy = own[min(steps, len(own) - 1)] if own.ndim > 1 else own
            weight *= policy[pair] / chance[pair]
            total += mdp.discount**steps * row["reward"]
            steps += 1
        ended = rows.iloc[-1]["next_state"] is None and not rows.iloc[-1].get("truncated", False)
        found.append((weight, total, steps, not ended and (horizon is None or steps < horizon)))
    return found


def data(seed: int, cut: bool = False) -> tuple[pd.DataFrame, MDP]:
    frame = recorded(np.random.default_rng(seed), 120)
    if cut:
        frame["truncated"] = False
        last = frame.groupby("episode").tail(1).index
        some = last[: len(last) // 3]
        frame.loc[some, "next_state"] = 0
        frame.loc[some, "truncated"] = True
    return frame, MDP.from_transitions(frame, discount="9/10")


@pytest.mark.parametrize("horizon", [None, 3])
@pytest.mark.parametrize("cut", [False, True])
def test_weights_and_returns_are_those_of_a_loop(horizon: int | None, cut: bool) -> None:
    for seed, sense in ((0, "max"), (1, "min")):
        frame, mdp = data(seed, cut)
        mdp = mdp.with_(sense=sense)
        own = own_of(mdp, STAGES if horizon else POLICY)
        chance = np.where(mdp.forced[mdp.pair_state], 1.0, 0.25 + 0.5 * mdp.pair_action)
        ratio = np.atleast_2d(own) / chance
        record = transitions.TransitionRecord(frame, None)
        w, returns, steps, cuts, ended = _read_trajectories(mdp, ratio, record, horizon)
        wanted = looped(mdp, frame, own, chance, horizon)
        assert w == pytest.approx([each[0] for each in wanted])
        assert returns == pytest.approx([mdp.sense.sign * each[1] for each in wanted])
        assert steps.tolist() == [each[2] for each in wanted]
        assert cuts.tolist() == [each[3] for each in wanted]
        assert ended == 0


@pytest.mark.parametrize("behaviour", ["random", None])
@pytest.mark.parametrize("cut", [False, True])
def test_an_interval_is_made_of_both_means(behaviour: Any, cut: bool) -> None:
    for seed, sense in ((0, "max"), (1, "min")):
        frame, mdp = data(seed, cut)
        mdp = mdp.with_(sense=sense)
        own, ends = own_of(mdp), (0.0, 8.0)
        by = OffPolicy(records=frame, behaviour=behaviour, rewards=(0, 1), returns=ends)
        interval = by.interval(mdp, own, F(9, 10))
        seen = np.asarray(mdp.observations, dtype=float)
        total = np.add.reduceat(seen, mdp.pair_offsets[:-1])[mdp.pair_state]
        chance = np.where(total > 0, seen / np.maximum(total, 1), 1.0)
        if behaviour:
            chance = np.where(mdp.forced[mdp.pair_state], 1.0, 0.5)
        w, returns, steps, cuts = map(
            np.array, zip(*looped(mdp, frame, own, chance, None), strict=True)
        )
        returns = mdp.sense.sign * returns
        low, high = ends if sense == "max" else (-8.0, 0.0)
        left = np.where(cuts, 0.9**steps, 0.0)
        above = np.clip(returns + left * low, low, high) - low
        below = high - np.clip(returns + left * high, low, high)
        least = min(low + mean_at_least(w * above, 0.1 / 4), high)
        most = max(high - mean_at_least(w * below, 0.1 / 4), low)
        own_ends = (least, most) if sense == "max" else (-most, -least)
        assert interval.found["learned_value"] == pytest.approx(own_ends, abs=1e-12)
        bounds = Robust(rewards=(0, 1), returns=ends).bounds(mdp, own, 0.1 / 2)
        best = bounds.at_start(mdp.maximised, bounds.best)
        assert interval.low == pytest.approx(max(best[0] - most, 0))
        assert interval.high == pytest.approx(max(best[1] - least, 0))
        assert interval.found["optimal_value"] == pytest.approx(bounds.at_start(mdp, bounds.best))
        terms = w * returns
        assert interval.found["weighted"] == pytest.approx(mdp.sense.sign * terms.sum() / w.sum())
        assert interval.found["ordinary"] == pytest.approx(mdp.sense.sign * terms.mean())
        error = terms.std(ddof=1) / np.sqrt(len(w))
        assert interval.found["standard_error"] == pytest.approx(error)
        size = w.sum() ** 2 / (w**2).sum()
        assert interval.found["effective_sample_size"] == pytest.approx(size)
        assert interval.found["episodes"] == 120
        assert interval.found["cut_off"] == cuts.sum() == (40 if cut else 0)
        said = "as stated" if behaviour else "the confidence is approximate"
        assert any(said in each for each in interval.assumptions[-1:])


def test_records_that_do_not_fit_are_refused() -> None:
    frame, mdp = data(0)
    own = own_of(mdp)

    def refused(words: str, model: MDP = mdp, policy: Any = own, **how: Any) -> None:
        with pytest.raises(ModelError, match=words):
            OffPolicy(**({"records": frame, "rewards": (0, 1)} | how)).interval(
                model, policy, F(1, 2)
            )

    refused("no trajectories are given", records=None)
    refused("has a start of its own", mdp.with_(start={0: "1/2", 1: "1/2"}))
    refused("begins in a state in which the model never starts", mdp.with_(start=2))
    refused("never takes an action that the policy takes", behaviour="always:1")
    refused(
        "never takes an action that was recorded",
        policy=own_of(mdp, [1, 1, 1, 0]),
        behaviour="always:1",
    )
    refused("no transitions", records=frame.iloc[:0])
    rows: Any = [(0, "a", "x", 0, None), (1, "a", "y", 0, None), (2, "b", "y", 0, None)]
    less = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="1/2")
    other = pd.DataFrame([*rows, (3, "b", "x", 0, None)], columns=NAMES)
    said = r"action x was taken in \(state b\), where the model does not offer it"
    refused(said, less, own_of(less, [0] * less.n_states), records=other)
    said = r"\(pairs of this kind: 2\)\n  where: state 1, action 0"  # the first is named
    refused(said, policy=own_of(mdp, [1, 0, 0, 0]), behaviour="always:1")
    seldom: Any = [*((n, "a", "x", 0, None) for n in range(9)), (9, "a", "y", 0, None)]
    once = pd.DataFrame(seldom, columns=NAMES)
    model = MDP.from_transitions(once, discount="1/2")
    own = own_of(model, [0] * model.n_states)
    said = "an action that was recorded\n  where: state a, action y"
    refused(said, model, own, records=once, behaviour="always:x")


def test_a_start_of_one_state_may_be_given() -> None:
    rows: Any = [(n, "a", "xy"[n % 2], n % 2, None) for n in range(60)]
    frame = pd.DataFrame(rows, columns=NAMES)
    mdp = MDP.from_transitions(frame, discount="1/2")
    own = own_of(mdp, [1] * mdp.n_states)
    by = OffPolicy(records=frame, behaviour="random", rewards="known", returns=(0, 1))
    one, other = (by.interval(each, own, F(9, 10)) for each in (mdp, mdp.with_(start="a")))
    assert one.found["learned_value"] == other.found["learned_value"]
    assert one.found["effective_sample_size"] == 30


def test_ends_that_were_only_entered_are_counted() -> None:
    rows: Any = [(n, "a", "xy"[n % 2], 1, "b" if n % 3 else None) for n in range(60)]
    frame = pd.DataFrame(rows, columns=NAMES)
    mdp = MDP.from_transitions(frame, discount="1/2")
    by = OffPolicy(records=frame, behaviour="random", rewards=(0, 1), returns=(0, 1))
    interval = by.interval(mdp, own_of(mdp, [0] * mdp.n_states), F(9, 10))
    assert interval.found["taken_for_ended"] == 40
    assert interval.found["cut_off"] == 0


def test_what_neither_behaviour_nor_records_have_is_not_refused() -> None:
    rows: Any = [(n, "a", "xy"[n < 20], n % 2, None) for n in range(40)]
    frame = pd.DataFrame(rows, columns=NAMES)
    mdp = MDP.from_transitions(frame, discount="1/2")
    assert np.asarray(mdp.observations).tolist() == [20, 20, 0]
    some = mdp.with_(observations=np.array([0, 20, 0]))  # x is offered, and was never taken
    by = OffPolicy(records=frame.iloc[:20], behaviour="always:y", rewards=(0, 1), returns=(0, 1))
    found = by.interval(some, own_of(mdp, [1] * mdp.n_states), F(9, 10)).found
    assert (found["weighted"], found["effective_sample_size"]) == (0.5, 20)
    # What is estimated from counts is never taken, too, where a state was met only once.
    seldom = frame.iloc[19:]
    once = MDP.from_transitions(seldom, discount="1/2")
    once = once.with_(observations=np.array([0, 1, 0]))
    by = OffPolicy(records=seldom.iloc[:1], rewards=(0, 1), returns=(0, 1))
    with pytest.raises(ModelError, match="never takes an action that the policy takes"):
        by.interval(once, own_of(mdp, [0] * mdp.n_states), F(9, 10))


def test_returns_outside_the_stated_range_are_refused() -> None:
    """Each reward fits, and two of them do not: 1 + 1 / 2."""
    rows: Any = []
    for n in range(20):
        rows += [(n, "a", "xy"[n % 2], 1, "b"), (n, "b", "x", 1 - n % 2, None)]
    frame = pd.DataFrame(rows, columns=NAMES)
    for sense in ("max", "min"):
        mdp = MDP.from_transitions(frame, discount="1/2").with_(sense=sense)
        own = own_of(mdp, [0] * mdp.n_states)
        for most, fits in ((1.5, True), (1.25, False)):
            by = OffPolicy(records=frame, behaviour="random", rewards=(0, 1), returns=(0, most))
            if fits:
                assert by.interval(mdp, own, F(9, 10)).found["episodes"] == 20
                continue
            with pytest.raises(ModelError, match=r"returns from 1 to 1\.5 were recorded"):
                by.interval(mdp, own, F(9, 10))


def test_a_loss_is_proven_by_many_records() -> None:
    """Action y earns 1 more, twice: x loses between 1 and 3 of 1 + 1."""
    rows: Any = [(n, "a", "xy"[n % 2], 2 * (n % 2), None) for n in range(4000)]
    frame = pd.DataFrame(rows, columns=NAMES)
    mdp = MDP.from_transitions(frame, discount="1/2")
    behaviour = np.full((mdp.n_states, 2), 0.5)  # probabilities, though they may be action values
    by = OffPolicy(records=frame, behaviour=behaviour, rewards=(0, 2), returns=(0, 2))
    interval = by.interval(mdp, own_of(mdp, [0] * mdp.n_states), F(9, 10))
    best, own = interval.found["optimal_value"], interval.found["learned_value"]
    assert best[0] < best[1]
    assert own[0] < own[1]
    assert (interval.low, interval.high) == (best[0] - own[1], best[1] - own[0])
    assert 1 < interval.low < 2 <= interval.high
    # Where nothing can be lost the upper end says so, too.
    same = frame.assign(reward=0.5)
    mdp = MDP.from_transitions(same, discount="1/2")
    by = OffPolicy(records=same, behaviour="random", rewards=(0.5, 0.5), returns=(0.5, 0.5))
    interval = by.interval(mdp, own_of(mdp, [0] * mdp.n_states), F(9, 10))
    assert (interval.low, interval.high) == (0, pytest.approx(0, abs=1e-9))


def test_episodes_that_the_policy_never_has_weigh_nothing() -> None:
    rows: Any = [(0, "a", "x", 1, "b"), (0, "b", "y", 1, None), (1, "a", "y", 1, "b"),
                 (1, "b", "x", 1, None)]  # fmt: skip
    frame = pd.DataFrame(rows, columns=NAMES)
    mdp = MDP.from_transitions(frame, discount="1/2")
    by = OffPolicy(records=frame, behaviour="random", rewards=(0, 1), returns=(0, 2))
    found = by.interval(mdp, own_of(mdp, [0] * mdp.n_states), F(9, 10)).found
    assert np.isnan(found["weighted"])
    assert (found["effective_sample_size"], found["ordinary"]) == (0, 0)
    # A policy that nearly always does what was never recorded: weights 1/4 and 3/8, returns 3/2.
    own = np.where(mdp.pair_action == 0, 0.875, 0.125)
    own[mdp.forced[mdp.pair_state]] = 1
    found = by.interval(mdp, own, F(9, 10)).found
    assert found["weighted"] == pytest.approx(1.5)
    assert found["ordinary"] == pytest.approx(1.5 * 4 * 0.875 * 0.125)
    assert found["effective_sample_size"] == pytest.approx(2)


def test_a_policy_by_time_is_weighted_by_time() -> None:
    frame, mdp = data(0)
    own = own_of(mdp, STAGES)
    by = OffPolicy(records=frame, behaviour="random", rewards=(0, 1))
    found = by.interval(mdp, own, F(9, 10)).found
    chance = np.where(mdp.forced[mdp.pair_state], 1.0, 0.5)
    w, returns, _, _ = map(np.array, zip(*looped(mdp, frame, own, chance, 3), strict=True))
    assert found["weighted"] == pytest.approx((w * returns).sum() / w.sum())
    assert found["cut_off"] == 0


def test_one_episode_is_read_to_its_end() -> None:
    """An end may be the first of all states, and an episode may be cut off without a next state."""
    rows: Any = [
        (0, "b", "x", 1, "d", False),
        (0, "d", "y", 2, "a", False),
        (1, "b", "y", 1, None, True),
        (2, "b", "x", 1, "d", False),
        (2, "d", "x", 0, None, False),
        (3, "b", "x", 1, "d", True),
        (4, "b", "x", 1, "c", False),
    ]
    frame = pd.DataFrame(rows, columns=[*NAMES, "truncated"])
    mdp = MDP.from_transitions(frame, discount="1/2")
    assert mdp.space.labels([0, 2]) == ["state a", "state c"]
    assert mdp.terminal[[0, 2]].all()
    ratio = np.full((1, mdp.n_pairs), 0.5)
    record = transitions.TransitionRecord(frame, None)
    w, returns, steps, cut, ended = _read_trajectories(mdp, ratio, record, None)
    assert w.tolist() == [0.25, 0.5, 0.25, 0.5, 0.5]
    assert returns.tolist() == [2, 1, 1, 1, 1]
    assert steps.tolist() == [2, 1, 2, 1, 1]
    assert cut.tolist() == [False, True, False, True, False]
    assert ended == 2  # in the states a and c, which were entered and never left
    for episode in (0, 2):
        only = frame[frame["episode"] == episode]
        record = transitions.TransitionRecord(only, None)
        w, returns, steps, cut, _ = _read_trajectories(mdp, ratio, record, None)
        assert (w.tolist(), steps.tolist(), cut.tolist()) == ([0.25], [2], [False])


def test_an_end_that_records_name_is_no_state_that_was_only_entered() -> None:
    rows: Any = [(0, "a", "x", 1, None), (1, "a", "x", 1, "a"), (1, "a", "x", 0, None)]
    mdp = MDP.from_transitions(pd.DataFrame(rows, columns=NAMES), discount="1/2")
    frame = pd.DataFrame([(*row[:4], row[4] or "end") for row in rows], columns=NAMES)
    record = transitions.TransitionRecord(frame, None)
    *_, cut, ended = _read_trajectories(mdp, np.ones((1, mdp.n_pairs)), record, None)
    assert cut.tolist() == [False, False]
    assert ended == 0
