"""The handwashing assistant: its published tables, the rules of its memory, and its size."""

from __future__ import annotations

from fractions import Fraction
from functools import cache
from math import lcm

import numpy as np
import pytest
from cases import BY_NAME
from cases.handwashing import BEHAVIOURS, STEPS
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError, certify, check, evaluate, solve
from exact_mdp.analysis.cli import main
from exact_mdp.mdp.coach.model import Coach
from exact_mdp.mdp.coach.numbers import FILE, NUMBERS, OURS
from exact_mdp.mdp.io.load import load
from exact_mdp.solvers import SolverError

F = Fraction
CASE = BY_NAME["handwashing"]
FULL = Coach.full()
WHICH = {"wet_hands": "wet", "turnon_water": "taps", "turnoff_water": "taps"}
WHICH |= {"use_soap": "soap", "dry_hands": "dry", "rinse_hands": "wet"}
EFFECT = {"minimal": F(1, 2), "moderate": F(1), "maximal": F(3, 2)}
PRICE = {"minimal": F(1, 2), "moderate": F(1), "maximal": F(2)}


@cache
def published() -> MDP:
    return Coach().compile()


@cache
def numbers_of_case() -> list[int]:
    """Return the number that the published case gives to each state of the model."""
    found = []
    for state in range(180):
        at = published().space.as_dict(state)
        user = 2 * (at["responsive"] == "yes") + (at["aware"] == "yes")
        step, behaviour = "abcdeghjk".index(at["step"]), BEHAVIOURS.index(at["behaviour"])
        found.append(20 * step + 4 * behaviour + user)
    return found


def test_the_reduced_model_is_the_published_file_row_by_row() -> None:
    model, number = published(), numbers_of_case()
    assert (model.n_states, model.n_actions, model.n_pairs) == (180, 6, 1080)
    case = {(state, action): (reward, row) for state, action, reward, row in CASE.pairs}
    for pair in range(model.n_pairs):
        reward, row = case[number[model.pair_state[pair]], int(model.pair_action[pair])]
        found = {number[after]: chance for chance, after, _ in model.table.row(pair)}
        assert found == dict(row)
        assert {earned for *_, earned in model.table.row(pair)} == {reward}


def test_its_optimum_is_proven_and_has_the_known_values() -> None:
    proof = certify(published())
    assert proof.violations() == []
    for state, number in enumerate(numbers_of_case()):
        if number in CASE.values:
            assert float(proof.value[state]) == pytest.approx(float(CASE.values[number]), abs=0.005)


def test_every_number_says_where_it_comes_from() -> None:
    assert {number.source for number in NUMBERS.values()} == {FILE, OURS}
    assert all(number.about and number.moves in ("reward", "weight") for number in NUMBERS.values())
    ours = {name: F(7) for name, number in NUMBERS.items() if number.source == OURS}
    changed = Coach().with_numbers(ours).compile()  # the reduced model has none of ours
    np.testing.assert_array_equal(changed.reward, published().reward)
    assert (changed.transition != published().transition).nnz == 0


def test_sizes_are_the_published_ones() -> None:
    assert (FULL.n_states, FULL.n_actions) == (50_181_120, 20)
    assert FULL.space.size == FULL.n_states
    assert sum(chance for _, chance in FULL.start) == 1


# ---- the rules of memory, said once more in words ------------------------------------------------


def in_words(at: dict[str, str], action: str) -> tuple[dict[tuple[str, ...], Fraction], Fraction]:
    """Return {next values of all columns: chance} and the reward, straight from the description."""
    next_steps, right, reward = STEPS[at["step"]]
    now = {name: int(at[name]) for name in ("waited", "prompted", "ignored", "repeated")}
    memory = dict(now, level=at["level"], prompt=at["prompt"])
    aware, cost, weights = at["aware"] == "yes", F(0), {}
    for b in BEHAVIOURS:
        weights[b] = F(2) + (b in right) if aware else F(1, 2 if b == "nothing" else 10)
    slow = {"mild": F(1, 2), "moderate": F(1), "severe": F(2)}[at["dementia"]]
    weights["nothing"] *= slow * (1 + F(now["waited"], 10))
    if action == "call_caregiver":
        helped = {"a": "taps", "b": "wet", "g": "taps"}.get(at["step"]) or min(right)
        weights, cost = {b: F(b == helped) for b in BEHAVIOURS}, F(6)
        memory |= {"ignored": 0, "repeated": 0, "level": "none", "prompt": "wet_hands"}
    elif action != "nothing":
        prompt, level = action.split("-")
        same = at["level"] != "none" and at["prompt"] == prompt
        memory |= {"repeated": min(now["repeated"] + 1, 3) if same else 0, "level": level}
        memory |= {"prompt": prompt, "prompted": min(now["prompted"] + 1, 10)}
        memory |= {"ignored": min(now["ignored"] + 1, 7)}
        if at["responsive"] == "yes":
            lost = (1 - F(now["ignored"], 16)) * (1 - F(int(memory["repeated"]), 8))
            weights[WHICH[prompt]] += 2 * EFFECT[level] * lost
        cost = F(4, 5) if aware else F(1, 5)
        cost *= PRICE[level] * (1 + F(now["prompted"], 20))
        cost += F(1, 5) * (WHICH[prompt] == at["behaviour"])
    found = {}
    for b, there in zip(BEHAVIOURS, next_steps, strict=True):
        then = dict(memory, waited=min(now["waited"] + 1, 10))
        if there != at["step"]:
            then |= {"waited": 0, "ignored": 0}
        if weights[b]:
            users = (at["responsive"], at["aware"], at["dementia"])
            key = (*users, there, b, *(str(then[name]) for name in FULL.space.names[5:]))
            found[key] = weights[b] / sum(weights.values())
    return found, reward - cost


@settings(max_examples=150, deadline=None)
@given(state=st.integers(0, FULL.n_states - 1), action=st.integers(0, 19))
def test_the_full_model_does_what_its_words_say(state: int, action: int) -> None:
    outcomes, earned, cost = FULL.row(state, action)
    expected, reward = in_words(dict(FULL.space.as_dict(state)), FULL.actions[action])
    assert {tuple(FULL.space.as_dict(s).values()): p for p, s in outcomes} == expected
    assert earned - cost == reward


# ---- without a matrix ----------------------------------------------------------------------------


@settings(max_examples=3, deadline=None)
@given(
    sizes=st.fixed_dictionaries({name: st.integers(1, 2) for name in ("waited", "ignored")}),
    discount=st.fractions(0, F(19, 20), max_denominator=20),
    right=st.integers(0, 5),
    cost=st.fractions(0, 3, max_denominator=9),
)
def test_values_without_a_matrix_are_those_of_the_explicit_model(
    sizes: dict[str, int], discount: Fraction, right: int, cost: Fraction
) -> None:
    numbers = {"discount": discount, "weight.right": right, "cost.aware": cost}
    model = Coach(**sizes).with_numbers(numbers)
    found, explicit = solve(model, tol=1e-9), solve(model.compile())
    off = np.abs(found.value - explicit.value)
    assert (off <= found.error_bound + explicit.state_error).all()
    loss = evaluate(explicit.mdp, found.policy)
    assert explicit.start.interval[0] - loss.start.interval[1] <= found.regret_bound


def test_two_hundred_thousand_states_keep_their_bound() -> None:
    """|V - V*| ≤ e makes |TV - V| ≤ (1 + γ) e; the sample is of exact rows, not of the sweeps'."""
    model = Coach.full(waited=2, prompted=2, ignored=2, repeated=2)
    assert model.n_states == 207_360
    found = solve(model)
    assert found.error_bound <= 1e-6
    assert found.sweeps < 100
    most = (1 + model.numbers["discount"]) * F(found.error_bound)
    for state in np.random.default_rng(20).integers(0, model.n_states, 200).tolist():
        best = max(worth(model, found.value, state, action) for action in range(20))
        assert abs(best - F(found.value[state])) <= most
        assert best - worth(model, found.value, state, int(found.choice[state])) <= 2 * most


GRAIN = 2**32  # values are rounded to this part of a unit, and sums of them are whole numbers


def gains(model: Coach, value: np.ndarray, choice: np.ndarray) -> tuple[Fraction, Fraction]:
    """Return the greatest Q(s, a) - V(s), and the least of the actions chosen: of every row, exact.

    Values are rounded to 1 / GRAIN; all else is in whole numbers below 2^62.
    """
    shape = (model.n_users, len(STEPS), len(BEHAVIOURS), model.n_memory)
    v, chosen = np.rint(value * GRAIN).astype(np.int64).reshape(shape), choice.reshape(shape)
    rate, memory, biggest = model.numbers["discount"], model.memory, int(np.abs(v).max())
    high, low, largest = F(-1), F(1), 0
    for user, step, action in np.ndindex(*shape[:2], model.n_actions):
        letter, earned = "abcdeghjk"[step], model.rewards()[step]
        there = ["abcdeghjk".index(each) for each in STEPS[letter][0]]
        kinds = zip(memory.effect[action], memory.waited, memory.price[action], strict=True)
        members: dict[tuple[int, ...], list[int]] = {}
        for m, kind in enumerate(kinds):
            members.setdefault(tuple(map(int, kind)), []).append(m)
        for (effect, waited, price), alike in members.items():
            asked = model.asked[action]
            effect *= model.responds(user)
            chances = model._chances(user, step, asked, effect, waited)
            bottom, m = lcm(*(chance.denominator for chance in chances)), np.array(alike)
            ahead = sum(
                int(chance * bottom)
                * v[user, to, b, (memory.stayed if to == step else memory.moved)[action, m]]
                for b, (chance, to) in enumerate(zip(chances, there, strict=True))
            )
            for b in range(len(BEHAVIOURS)):
                gain = earned - model.prices(user)[price] - model.repeat * (asked == b)
                whole = lcm(gain.denominator, rate.denominator * bottom)
                own, share = int(gain * whole) * GRAIN, int(rate * whole / bottom)
                largest = max(largest, abs(own) + (share * bottom + whole) * biggest)
                found = own + share * ahead - whole * v[user, step, b, m]
                high = max(high, F(int(found.max()), whole * GRAIN))
                mine = found[chosen[user, step, b, m] == action]
                low = min(low, F(int(mine.min()), whole * GRAIN)) if len(mine) else low
    assert largest < 2**62
    return high, low


def test_the_proof_is_that_of_single_rows() -> None:
    """In the smallest model with every rule: rows one by one, in fractions."""
    model = Coach(levels=3, ignored=2, repeated=2)
    rng = np.random.default_rng(0)
    value = rng.integers(0, 100 * GRAIN, size=model.n_states) / GRAIN
    choice = rng.integers(0, 20, size=model.n_states)
    high, low = gains(model, value, choice)
    some = rng.integers(0, model.n_states, 60).tolist()
    for state in some:
        each = [worth(model, value, state, action) - F(value[state]) for action in range(20)]
        assert low <= each[choice[state]]
        assert max(each) <= high
    value[some[0]] -= 500  # one bad state is found, and what it gains
    worst = max(worth(model, value, some[0], action) for action in range(20)) - F(value[some[0]])
    assert gains(model, value, choice)[0] == worst


@pytest.mark.slow
def test_two_hundred_thousand_states_are_proven_row_by_row() -> None:
    """Q - V ≤ h for all 4,147,200 rows gives V* ≤ V + h / (1 - γ); of the choices, V^π likewise."""
    model = Coach.full(waited=2, prompted=2, ignored=2, repeated=2)
    found = solve(model)
    high, low = gains(model, found.value, found.choice)
    ahead = 1 / (1 - model.numbers["discount"])
    assert (high - low) * ahead + F(2, GRAIN) <= F(1, 10**6)
    assert high * ahead <= F(found.error_bound) + F(1, 10**9)


def worth(model: Coach, value: np.ndarray, state: int, action: int) -> Fraction:
    """Return the exact value of an action where next states are worth the floats given."""
    outcomes, earned, cost = model.row(state, action)
    ahead = sum((chance * F(value[after]) for chance, after in outcomes), F(0))
    return earned - cost + model.numbers["discount"] * ahead


@pytest.mark.slow
def test_every_rule_at_once_agrees_with_the_explicit_model() -> None:
    model = Coach(levels=3)
    found, explicit = solve(model, tol=1e-9), solve(model.compile())
    assert (np.abs(found.value - explicit.value) <= found.error_bound + explicit.state_error).all()


# ---- use, and misuse -----------------------------------------------------------------------------


def test_the_command_line_knows_it_by_name(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["solve", "coach", "--json"]) == 0
    assert '"start_value": 27.290143' in capsys.readouterr().out
    dear = load("coach", sets=["cost.unaware=1/2"], discount="1/2").mdp
    assert dear.discount == 0.5
    assert dear.reward.min() == -0.8


@pytest.mark.slow
def test_its_derivatives_are_certified_although_prompts_tie(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["sensitivity", "coach", "gradient", "--parameter", "reward.done"]) == 0
    assert "certified" in capsys.readouterr().out


def test_its_parameters_have_their_names() -> None:
    names = [parameter.name for parameter in load("coach").family.parameters]  # type: ignore[union-attr]
    assert names[:2] == ["reward.start", "reward.underway"]
    assert set(Coach().parametric().neighbours()) == {
        "weight.any",
        "weight.right",
        "weight.prompted",
    }


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Coach().with_numbers({"cost.awar": 1}), "unknown number 'cost.awar'"),
        (lambda: Coach().with_numbers({"discount": 1}), "the discount is 1"),
        (lambda: Coach().with_numbers({"weight.other": "-1/10"}), "weight of a behaviour"),
        (lambda: Coach().with_numbers({"weight.right": "x"}), "not a finite rational"),
        (lambda: Coach(waited=0), "waited is 0"),
        (lambda: Coach(levels=2), "levels is 2"),
        (lambda: Coach.full(ignored=18), "weight of a behaviour"),
        (lambda: FULL.compile(), "too many to write out"),
        (lambda: solve(Coach(), tol=0), "tol is 0"),
        (lambda: solve(Coach(), horizon=3), "Coach takes no horizon"),  # type: ignore[call-overload]
        (lambda: load("coach", sets=["cost.aware"]), "sets nothing"),
        (lambda: load("coahc"), "unknown model 'coahc'"),
    ],
)
def test_what_it_cannot_be_is_refused(make: object, what: str) -> None:
    with pytest.raises(ModelError, match=what):
        make()  # type: ignore[operator]


def test_more_than_doubles_can_give_is_refused() -> None:
    with pytest.raises(SolverError, match="double precision"):
        solve(Coach(), tol=1e-13)


def test_prompts_are_for_those_who_respond() -> None:
    """cppo3.txt says of users who do not respond that they ignore prompts: then each is a cost."""
    solution = solve(published())
    for state in range(180):
        silent = published().space.as_dict(state)["responsive"] == "no"
        assert not silent or published().actions[solution.policy[state]] == "nothing"
    assert check(published(), "always:nothing").regret.at_start.value > 10
