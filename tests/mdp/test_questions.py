"""Questions about labels, against the linear equations of every policy."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import negated
from oracle import best_within, each_choice, hitting, rows_of, until
from refusal_tables import table_of_refusals
from strategies import Rows, model_of, models

from exact_mdp import MDP, Policy, Scenario, certify, evaluate, solve

F = Fraction
SENSES = {"max": max, "min": min}


@st.composite
def asked(draw: st.DrawFn) -> MDP:
    """A model at discount 1, rewards of at least 0, end components, target and allowed states."""
    ending = draw(st.booleans())
    rows: Rows = draw(models(discounts=[F(1) if ending else F(1, 2)]))
    pairs = tuple((s, a, abs(r), law) for s, a, r, law in rows.pairs)
    flags = st.lists(st.booleans(), min_size=rows.n_states, max_size=rows.n_states)
    target, allowed = draw(flags.filter(any)), draw(flags.filter(any))
    start = draw(st.sampled_from([s for s, yes in enumerate(target) if yes or allowed[s]]))
    sense = draw(st.sampled_from(["max", "min"]))
    mdp = model_of(rows.n_states, pairs, F(1), start=start).with_(sense=sense)
    return mdp.with_(labels={"target": target, "allowed": allowed})


@settings(max_examples=40)
@given(asked(), st.booleans())
def test_the_probability_is_that_of_the_best_policy(mdp: MDP, avoiding: bool) -> None:
    target = mdp.labels["target"].tolist()
    allowed = mdp.labels["allowed"].tolist() if avoiding else [True] * mdp.n_states
    every = [hitting(rows_of(mdp, choice), target, allowed) for choice in each_choice(mdp)]
    best = [SENSES[mdp.sense](column) for column in zip(*every, strict=True)]
    model = mdp.reaching("target", "allowed" if avoiding else None)
    proof = certify(model)
    assert proof.value[: mdp.n_states].tolist() == best
    assert proof.violations() == []
    low, high = solve(model).start.interval
    assert low <= best[mdp.start[0][0]] <= high
    choice = next(each_choice(mdp))
    fixed = Policy.of(mdp, mdp.pair_action[list(choice)])
    mine = hitting(rows_of(mdp, choice), target, allowed)[mdp.start[0][0]]
    assert evaluate(model, fixed).mean == pytest.approx(float(mine), abs=1e-12)


@settings(max_examples=40)
@given(asked())
def test_the_reward_until_then_is_that_of_the_best_policy(mdp: MDP) -> None:
    """Infinite where the target is not reached almost surely: under some policy, or under all."""
    target = mdp.labels["target"].tolist()
    every = [until(rows_of(mdp, choice), target) for choice in each_choice(mdp)]
    best = [SENSES[mdp.sense](column) for column in zip(*every, strict=True)]
    model = mdp.until("target")
    assert model.goal is not None
    assert model.goal.tolist() == target
    missed = np.inf if mdp.sense == "max" else -np.inf
    assert (model.unreached, model.maximised.unreached) == (np.inf, missed)
    proof = certify(model)
    assert proof.value.tolist() == best
    assert proof.violations() == []
    values = solve(model).value
    assert values == pytest.approx([float(value) for value in best], rel=1e-9, abs=1e-9)


def test_components_keep_their_exact_values() -> None:
    exact = [[F(1, 3), F(2, 7)], [F(1), F(1)]]
    mdp = MDP.from_arrays(
        [[["1/3", "2/3"], [0, 1]]],
        [F(13, 21), 2],
        labels={"home": [False, True]},
        component_names=("a", "b"),
        components=exact,
    )
    assert certify(mdp.until("home", "a")).start_value == F(1, 2)
    assert certify(mdp.until("home", reward="b")).start_value == F(3, 7)
    both = mdp.until("home")
    assert certify(both).start_value == F(13, 14)
    assert evaluate(both, "random").components == pytest.approx({"a": 1 / 2, "b": 3 / 7})
    assert certify(negated(mdp).until("home", "b")).start_value == F(-3, 7)


def test_a_discount_ends_the_wait() -> None:
    """A run that never arrives has a finite worth then, and no state is a goal."""
    walk = [[["1/2", "1/2", 0], [0, 1, 0], [0, 0, 1]], [[0, 0, 1], [0, 1, 0], [0, 0, 1]]]
    mdp = MDP.from_arrays(walk, [1, 1, 0], "1/2", labels={"home": [False, True, False]})
    assert mdp.until("home").goal is None
    assert certify(mdp.until("home")).start_value == F(4, 3)
    timed = mdp.with_(discount=1).until("home").within(3)
    assert timed.labels["home"].sum() == 4
    assert certify(timed).start_value == np.inf
    assert certify(timed.with_(goal=None)).start_value == F(7, 4)


@settings(max_examples=40)
@given(asked(), st.booleans(), st.integers(1, 4))
def test_within_n_steps_means_the_same_before_and_after_a_question(
    mdp: MDP, avoiding: bool, steps: int
) -> None:
    """P[F<=N], and the reward until then, which is infinite unless N steps are surely enough."""
    target, start = mdp.labels["target"].tolist(), mdp.start[0][0]
    allowed = mdp.labels["allowed"].tolist() if avoiding else [True] * mdp.n_states
    through = "allowed" if avoiding else None
    ends = {s: F(on) for s, on in enumerate(target) if on}
    stops = {s: F(0) for s, on in enumerate(allowed) if not on} | ends
    best = best_within(mdp, steps, stops, F(0), 0)[start]
    cost = best_within(mdp, steps, dict.fromkeys(ends, F(0)), np.inf, 1)[start]
    for model, answer in (
        (mdp.reaching("target", through).within(steps), best),
        (mdp.within(steps).reaching("target", through), best),
        (mdp.until("target").within(steps), cost),
        (mdp.within(steps).until("target"), cost),
    ):
        proof = certify(model)
        assert (proof.start_value, proof.violations()) == (answer, [])
        low, high = solve(model).start.interval
        assert low <= answer <= high


def test_a_label_that_no_state_has_is_never_reached() -> None:
    for mdp in (LABELLED, LABELLED.within(2)):
        assert certify(mdp.reaching("no")).start_value == 0
        assert certify(mdp.until("no")).start_value == np.inf
        assert certify(mdp.with_(sense="min").until("no")).start_value == np.inf
    assert certify(LABELLED.reaching("no").within(2)).start_value == 0


def test_care_scenarios_name_their_states() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[2], readings={"skip_timestep": "own"})
    mdp = scenario.compile()
    assert list(mdp.labels) == ["end", "skipped", *scenario.statuses]
    for state in range(mdp.n_states):
        values = mdp.space.as_dict(state)
        on = [mdp.labels[name][state] for name in scenario.statuses]
        assert on == [digit == "1" for digit in values.get("status", "0000")]
        assert mdp.labels["end"][state] == ("status" not in values)
        skipping = values.get("trial") == str(mdp.space.column("trial").size - 1)
        assert mdp.labels["skipped"][state] == skipping
    often = certify(mdp.reaching("skipped")).start_value
    seldom = certify(mdp.with_(sense="min").reaching("skipped")).start_value
    assert 0 < seldom < often < 1
    # The probability of the event, counted on outcomes: nobody computes it from labels.
    best = solve(mdp.with_(sense="min").reaching("skipped"))
    assert evaluate(mdp.reaching("skipped"), best).mean == pytest.approx(float(seldom))
    random = evaluate(mdp.reaching("skipped"), "random").mean
    assert random == pytest.approx(evaluate(mdp, "random").skip_probability)


LABELLED = MDP.from_arrays(
    [[[0, 1, 0], [0, 1, 0], [0, 0, 1]]],
    [0, 0, 0],
    labels={"goal": [False, True, False], "start": [True, False, False], "no": [False] * 3},
)
test_bad_questions = table_of_refusals(__file__, globals())


@pytest.mark.parametrize("states", ["c", ["c"], {"c"}, 2, [2], {2}, np.array([2]), ("c",)])
def test_a_label_names_states_or_numbers_them(states: object) -> None:
    mdp = MDP.from_outcomes([(s, 0, [(1, s, 0)]) for s in range(3)], states=["a", "b", "c"])
    assert mdp.with_(labels={"goal": states}).labels["goal"].tolist() == [False, False, True]
    assert not mdp.with_(labels={"goal": []}).labels["goal"].any()
    assert mdp.with_(labels={"goal": {0, 1}}).labels["goal"].tolist() == [True, True, False]


def test_the_last_step_earns_the_terminal_value_discounted_once() -> None:
    mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [3, 0], discount="1/2")
    assert certify(mdp.within(1, terminal_value=[0, 8])).start_value == 3 + 4
    assert certify(mdp.within(2, terminal_value=[0, 8])).start_value == 3 + 2
