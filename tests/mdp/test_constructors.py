"""Every constructor gives the same model: arrays of all layouts, pairs, outcomes and functions."""

import pickle
from collections import defaultdict
from collections.abc import Callable
from fractions import Fraction
from functools import cache
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import laws, negated, outcomes_of
from refusal_tables import refused
from strategies import Rows, models, outcome_rows

from exact_mdp import MDP, ModelError, Policy, ShapeError, StateSpace, certify, load, save, solve

HALF, THIRD, INF = Fraction(1, 2), Fraction(1, 3), float("inf")
P = np.array([[[0.5, 0.5, 0.0], [0, 0.25, 0.75], [0, 0, 1]], [[0, 1, 0], [0.5, 0, 0.5], [0, 0, 1]]])
R = np.array([[1.0, 2.0], [3.0, -4.0], [0.0, 0.0]])


def content(mdp: MDP) -> Any:
    return laws(mdp), mdp.discount_exact


def same(one: MDP, other: MDP) -> bool:
    return bool(content(one) == content(other))


@pytest.mark.parametrize("states", [4, 30_000])
def test_rows_that_lead_beyond_the_space_are_refused_at_any_size(states: int) -> None:
    pairs = np.arange(states - 1)
    rows = sp.csr_array(
        (np.ones(states - 1), pairs + 1, np.arange(states)), shape=(states - 1, states)
    )
    with pytest.raises(ModelError, match=f"no next state {states - 1}"):
        MDP.from_pairs(pairs, 0 * pairs, rows, 0.0 * pairs, space=StateSpace.plain(states - 1))


# ---- arrays --------------------------------------------------------------------------------------


def objects(matrices: Any) -> Any:
    array = np.empty(len(matrices), dtype=object)
    array[:] = [*matrices]
    return array


def matrix(rows: Any) -> Any:
    return np.asarray(rows).view(np.matrix)


FORMS: dict[str, Callable[[Any], Any]] = {
    "array": np.array,
    "list": lambda P: np.asarray(P).tolist(),
    "fractions": lambda P: np.vectorize(Fraction, otypes=[object])(P),
    "words": lambda P: np.vectorize(lambda x: str(Fraction(x)), otypes=[object])(P).tolist(),
    "single precision": lambda P: np.asarray(P, dtype=np.float32),
    **{kind: lambda P, kind=kind: [getattr(sp, kind)(each) for each in P]
       for kind in ("csr_array", "coo_array", "csc_matrix", "lil_matrix", "dok_array")},
    "array of matrices": objects,
    "array of sparse matrices": lambda P: objects([sp.csr_array(each) for each in P]),
    "np.matrix": lambda P: [matrix(each) for each in P],
    "dictionary": lambda P: dict(enumerate(P)),
    "dictionary of np.matrix": lambda P: {k: matrix(each) for k, each in enumerate(P)},
    "dictionary of sparse": lambda P: {k: sp.csc_array(each) for k, each in enumerate(P)},
    "dictionary of lists": lambda P: dict(enumerate(np.asarray(P).tolist())),
}  # fmt: skip


@cache
def readings() -> list[tuple[Any, dict[str, Any]]]:
    """All P of two states and two actions with rows from a few, and what each layout means."""
    state, action, read = [0, 0, 1, 1], [0, 1, 0, 1], []
    for rows in product(([1, 0], [0, 1], [0.5, 0.5]), repeat=4):
        cube = np.array(rows).reshape(2, 2, 2)
        wanted = {
            layout: MDP.from_pairs(state, action, turned.reshape(4, 2), [1, 2, 3, 5], "9/10")
            for layout, turned in (("ass", cube.transpose(1, 0, 2)), ("sas", cube))
        }
        read.append((cube, {layout: content(mdp) for layout, mdp in wanted.items()}))
    return read


@pytest.mark.parametrize("form", FORMS)
def test_where_the_shape_does_not_say_the_layout_it_is_asked_for(form: str) -> None:
    """Each reading against its pairs."""
    rewards = [[1, 2], [3, 5]]
    for cube, wanted in readings():
        for layout, meant in wanted.items():
            made = MDP.from_arrays(FORMS[form](cube), rewards, "9/10", layout=layout)
            assert content(made) == meant
        if wanted["ass"] == wanted["sas"]:
            made = MDP.from_arrays(FORMS[form](cube), rewards, "9/10")
            assert content(made) == wanted["ass"]
        else:
            with pytest.raises(ModelError, match="as many actions as states") as caught:
                MDP.from_arrays(FORMS[form](cube), rewards, "9/10")
            assert 'layout="sas"' in caught.value.fix
            assert 'layout="ass"' in caught.value.fix


@pytest.mark.parametrize("form", FORMS)
def test_elsewhere_the_shape_says_the_layout(form: str) -> None:
    """Three actions, two states; a stated layout is checked, of rewards as well."""
    P = np.array([[[0.5, 0.5], [0, 1]], [[1, 0], [0, 1]], [[0, 1], [1, 0]]])
    R = np.arange(12.0).reshape(3, 2, 2)
    wanted = MDP.from_arrays(P, R, layout="ass")
    assert same(MDP.from_arrays(FORMS[form](P), FORMS[form](R)), wanted)
    assert same(MDP.from_arrays(FORMS[form](P), FORMS[form](R), layout="ass"), wanted)
    refused(lambda: MDP.from_arrays(FORMS[form](P), FORMS[form](R), layout="sas"))
    with pytest.raises(ShapeError, match="rewards have shape"):
        MDP.from_arrays(FORMS[form](P), R.transpose(1, 0, 2), layout="ass")


@st.composite
def arrays(draw: st.DrawFn) -> tuple[Any, Any, Any]:
    """Transitions (A, S, S) in 64ths, rewards (S, A) in quarters, and which pairs are offered."""
    actions, states = draw(st.sampled_from([(1, 3), (2, 3), (3, 2), (2, 2), (4, 1)]))
    rng = np.random.default_rng(draw(st.integers(0, 2**32)))
    P = rng.multinomial(64, np.full(states, 1 / states), size=(actions, states)) / 64
    offered = rng.random((states, actions)) < 0.7
    offered[np.arange(states), rng.integers(actions, size=states)] = True
    offered[rng.integers(states), -1] = True  # what shows how many actions there are
    # No reward is whole: none is taken for a state or an action.
    return P, rng.integers(-8, 8, (states, actions)) / 4 + 1 / 8, offered


@given(arrays())
def test_every_form_is_the_same_model(given: tuple[Any, Any, Any]) -> None:
    """P and R as in QuantEcon, pymdptoolbox, mdpsolver and AI-Toolbox, against one row a pair."""
    P, R, offered = given
    actions, states = P.shape[:2]
    sas = P.transpose(1, 0, 2)
    state, action = np.nonzero(offered)
    wanted = MDP.from_pairs(state, action, sas[offered], R[offered], HALF)
    missing = np.where(offered, R, -np.inf)
    nonsense = np.where(offered[:, :, None], sas, 7.0)
    by_move = np.repeat(missing[:, :, None], states, axis=2)
    pairs = list(zip(state.tolist(), action.tolist(), strict=True))
    nested = [
        [sas[s, a].tolist() if offered[s, a] else None for a in range(actions)]
        for s in range(states)
    ]
    named = {s: {a: dict(enumerate(sas[s, a])) for t, a in pairs if t == s} for s in range(states)}
    by_name = {s: {a: R[s, a] for a in named[s]} for s in named}
    quadruples = [(s, a, t, sas[s, a, t]) for s, a in pairs for t in range(states)]
    order = np.random.default_rng(0).permutation(states * actions)
    every_state, every_action = np.divmod(order, actions)
    turned = sp.coo_matrix(nonsense.reshape(-1, states)[order])
    forms: list[MDP] = [
        MDP.from_pairs(every_state, every_action, turned, missing.reshape(-1)[order], HALF),
        MDP.from_arrays(nonsense, missing, HALF, layout="sas"),
        MDP.from_arrays(nonsense.transpose(1, 0, 2), missing, HALF, layout="ass"),
        MDP.from_arrays(nonsense, by_move, HALF, layout="sas"),
        MDP.from_arrays(nonsense.astype(object), missing.astype(object), HALF, layout="sas"),
        MDP.from_arrays([sp.csr_array(x) for x in nonsense], missing, HALF, layout="sas"),
        MDP.from_arrays(nested, missing.tolist(), HALF, layout="sas"),
        MDP.from_arrays(named, by_name, HALF),
        MDP.from_arrays(quadruples, by_name, HALF),
        MDP.from_pairs(
            every_state, every_action, nonsense.reshape(-1, states)[order],
            missing.reshape(-1)[order], HALF,
        ),
    ]  # fmt: skip
    for rewards in (R, missing, missing.tolist()):
        if actions in (3, 4) and len(pairs) == states:
            with pytest.raises(ModelError, match="the rewards may be"):
                MDP.from_arrays(quadruples, rewards, HALF)
        else:
            forms += [MDP.from_arrays(rows, rewards, HALF)
                      for rows in (named, quadruples, np.array(quadruples))]  # fmt: skip
    if actions != states:
        forms.append(MDP.from_arrays(nonsense, missing, HALF))
        forms.append(MDP.from_arrays([sp.coo_array(x) for x in nonsense], missing, HALF))
    for number, mdp in enumerate(forms):
        assert same(mdp, wanted), number
    wrong = [
        np.ones((states + 1, actions)), np.ones((states, actions + 1)), np.ones(states + 1),
        R[:-1], by_move,
    ]  # fmt: skip
    for rows, rewards in product((named, quadruples, np.array(quadruples)), wrong):
        with pytest.raises(ShapeError) as caught:
            MDP.from_arrays(rows, rewards, HALF)
        assert caught.value.where.startswith("R")
    costs = MDP.from_arrays(named, dict(enumerate(R.max(axis=1))), HALF)
    assert costs.reward.tolist() == R.max(axis=1)[state].tolist()


def test_arrays_mean_what_the_contract_says() -> None:
    mdp = MDP.from_arrays(P, R, discount=0.9)
    assert (mdp.n_states, mdp.n_actions, mdp.n_pairs) == (3, 2, 6)
    assert mdp.transition.toarray().reshape(3, 2, 3).tolist() == P.transpose(1, 0, 2).tolist()
    assert mdp.reward.reshape(3, 2).tolist() == R.tolist()
    assert MDP.from_arrays(P, [5.0, 6.0, 0.0]).reward.tolist() == [5, 5, 6, 6, 0, 0]
    by_move = np.arange(18.0).reshape(2, 3, 3)
    expected = (P * by_move).sum(axis=2).T.ravel()
    assert MDP.from_arrays(P, by_move, 0.9).reward == pytest.approx(expected)
    assert mdp.terminal.tolist() == [False, False, True]
    value = np.array([1.0, 2.0, 4.0])
    assert mdp.backup(value) == pytest.approx((R + 0.9 * (P @ value).T).reshape(-1))
    for form in (sp.csr_array, sp.csc_matrix, sp.coo_array, sp.lil_matrix):
        assert same(MDP.from_arrays(P, form(R), 0.9), mdp)
    swap = np.stack([np.eye(2), np.eye(2)[::-1]])  # (S, A) where S = A
    assert MDP.from_arrays(swap, [[1.0, 2.0], [3.0, 4.0]]).reward.tolist() == [1, 2, 3, 4]
    assert repr(MDP.from_arrays(P, R, "9/10", name="three")) == (
        "MDP(three: 3 states, 2 actions, 6 pairs, 9 transitions, discount 9/10)"
    )


def test_rewards_by_name_by_row_and_in_part() -> None:
    """A pair that is not available may be said to be so; matrices go by the name of an action."""
    quadruples, ragged = [(0, 0, 1, 1), (0, 1, 0, 1), (1, 0, 1, 1)], [[[0, 1], [1, 0]], [[0, 1]]]
    for rewards in ({0: {0: 7, 1: 8}, 1: 9}, {0: {0: {1: 7}, 1: {0: 8}}, 1: {0: 9}}):
        assert MDP.from_arrays(quadruples, rewards, HALF).R.tolist() == [[7, 8], [9, -INF]]
    for rewards in ([[7, 8], [9]], [[7, 8], [9, -5]]):
        mdp = MDP.from_arrays(ragged, rewards, HALF, layout="sas")
        assert mdp.R.tolist() == [[7, 8], [9, -INF]]
    named = [("a", "go", "b", 1), ("b", "go", "a", 1)]
    assert MDP.from_arrays(named, {"a": {"go": 3}, "b": 4}).reward.tolist() == [3, 4]
    two = {"a": {"x": {"a": 1}, "y": {"a": 1}}, "b": {"x": {"b": 1}}}
    for none in (-INF, np.nan, None):
        rewards = {"a": {"x": 1, "y": 2}, "b": {"x": 3, "y": none}}
        assert MDP.from_arrays(two, rewards, HALF).reward.tolist() == [1, 2, 3]
    closed = {"a": {"x": {"a": 1}, "y": None}, "b": {}}
    for rewards in (
        {"a": {"x": 1, "y": 5}},
        {"a": 1, "b": {"x": 0}},
        {"a": {"x": {"a": 1, "b": 7}}},
    ):
        assert MDP.from_arrays(closed, rewards, HALF).reward.tolist() == [1, 0]
    assert MDP.from_arrays(P, np.ma.array(R, mask=False)).reward.tolist() == R.ravel().tolist()
    assert MDP.from_arrays(P, pd.DataFrame(R)).reward.tolist() == R.ravel().tolist()
    stay, go = np.eye(3), np.roll(np.eye(3), 1, axis=1)
    by_name = {"stay": stay, "go": go}
    mdp = MDP.from_arrays(by_name, [[1, 4], [2, 5], [3, 6]])
    assert (mdp.actions, mdp.reward.tolist()) == (("stay", "go"), [1, 4, 2, 5, 3, 6])
    assert mdp.transition.toarray()[1::2].tolist() == go.tolist()
    by_state = {"x": [[1, 0]], "y": [[0, 1]]}
    assert MDP.from_arrays(by_state, [1, 2], layout="sas").space.label(1) == "state y"
    moves = MDP.from_arrays(by_name, {"stay": 2 * stay, "go": 3 * go})
    assert moves.reward.tolist() == [2, 3] * 3
    for wrong in ({"stay": 1, "go": 2}, {"stay": [1, 2, 3], "go": [3, 4, 5]}, {0: 1, 1: 2, 2: 3}):
        with pytest.raises(ModelError, match="the rewards are a dictionary"):
            MDP.from_arrays(by_name, wrong)
    tenths = dict.fromkeys(range(10), 0.1)  # which do not sum to 1 in floats
    mdp = MDP.from_arrays({s: {0: tenths} for s in range(10)}, dict.fromkeys(range(10), 3.0), 0.9)
    assert mdp.reward.tolist() == [3.0] * 10
    assert same(mdp, MDP.from_arrays(np.full((1, 10, 10), 0.1), [3.0] * 10, 0.9))


# ---- pairs and outcomes --------------------------------------------------------------------------


GAINS = st.fractions(-50, 50, max_denominator=40)
GAINS |= st.fractions(0, 1).map(lambda x: x + Fraction(1, 3**50))


@given(outcome_rows(GAINS), st.randoms(use_true_random=False))
def test_outcomes_are_kept_exactly_and_every_float_is_rounded_once(
    listed: list[Any], random: Any
) -> None:
    """In any order, as joint laws; `from_pairs` has the expected rewards alone."""
    random.shuffle(listed)
    mdp, size = MDP.from_outcomes(listed, "9/10"), 0
    exact: dict[tuple[int, str], dict[tuple[int, Fraction], Fraction]] = {}
    for state, action, outcomes in listed:
        law = exact[state, str(action)] = defaultdict(Fraction)
        for p, following, reward in outcomes:
            law[following, reward] += p
        size = max(size, state + 1)
    assert (laws(mdp), mdp.discount_exact) == (exact, Fraction(9, 10))
    state, action = [s for s, _, _ in listed], [a for _, a, _ in listed]
    chances = [[sum(p for p, t, _ in law if t == n) for n in range(size)] for *_, law in listed]
    pairs = MDP.from_pairs(
        state, action, chances, [sum(p * r for p, _, r in o) for *_, o in listed]
    )
    for model in (mdp, pairs):
        dense, first = model.transition.toarray(), model.table.offsets
        for pair in range(model.n_pairs):
            row, span = model.table.row(pair), slice(first[pair], first[pair + 1])
            assert model.table.compute_probabilities()[span].tolist() == [
                float(p) for p, _, _ in row
            ]
            assert model.table.compute_gains()[span].tolist() == [float(r) for _, _, r in row]
            key = int(model.pair_state[pair]), model.actions[model.pair_action[pair]]
            law = exact[key]
            assert sum(p * r for p, _, r in row) == sum(p * r for (_, r), p in law.items())
            assert model.reward[pair] == float(sum(p * r for (_, r), p in law.items()))
            for n in range(size):
                chance = sum(p for (t, _), p in law.items() if t == n)
                assert sum(p for p, t, _ in row if t == n) == chance
                assert dense[pair, n] == float(chance)


def test_what_a_matrix_remembers_of_its_order_is_not_believed() -> None:
    """SciPy keeps what it once found, though indices may be written in place since."""
    parts = (np.array([1.0, 0.5, 0.5, 1]), np.array([1, 0, 2, 2]), np.array([0, 1, 3, 4]))
    given = sp.csr_array(parts, shape=(3, 3))
    assert given.has_canonical_format
    given.indices[1:3] = [2, 0]
    mdp = MDP.from_pairs([0, 1, 2], [0] * 3, given, [1.0, 1, 0])
    assert mdp.table.next.tolist() == [1, 0, 2, 2]
    assert given.indices.tolist() == [1, 2, 0, 2]


def test_what_is_given_is_not_changed_and_what_is_made_is_frozen() -> None:
    sparse = [sp.csr_array(each) for each in P]
    state, action, eye, zero = np.array([0, 1]), np.array([0, 0]), np.eye(2), np.zeros(2)
    transition, reward = P.copy(), R.copy()
    mdp = MDP.from_arrays(transition, reward, 0.9, name="small")
    MDP.from_arrays(sparse, reward, 0.9)
    MDP.from_pairs(state, action, eye, zero)
    for array in (transition, reward, state, action, eye, zero, sparse[0].data):
        array[...] = 0
    assert (mdp.transition.toarray()[0].tolist(), mdp.reward[0]) == ([0.5, 0.5, 0], 1)
    for model in (mdp, pickle.loads(pickle.dumps(mdp))):
        assert same(model, mdp)
        assert (model.name, model.space) == (mdp.name, mdp.space)
        for array in (
            model.reward, model.components, model.pair_state, model.pair_action,
            model.pair_offsets, model.table.offsets, model.table.next, model.table.weight,
            model.table.gain, model.transition.data, model.transition.indices,
            model.start_distribution,
        ):  # fmt: skip
            with pytest.raises(ValueError, match="read-only"):
                array[0] = 0
        with pytest.raises(AttributeError):
            model.name = "other"


# ---- functions -----------------------------------------------------------------------------------


@given(models(discounts=(HALF,)), st.sampled_from([int, str, lambda s: (s, "x")]))
def test_exploring_finds_the_reachable_model(drawn: Rows, name: Callable[[int], Any]) -> None:
    """State by state it is the model that was listed; the optimum from the start is the same."""
    whole, back = drawn.model(), {name(s): s for s in range(drawn.n_states)}
    of_state: dict[int, dict[str, Any]] = defaultdict(dict)
    for s, a, r, following in drawn.pairs:
        of_state[s][f"a{a}"] = [(p, name(t), r) for t, p in following.items()]
    asked: list[Any] = []

    def outcomes(state: Any, action: str) -> Any:
        asked.append((state, action))
        return of_state[back[state]][action]

    mdp = MDP.from_function(name(0), lambda s: of_state[back[s]], outcomes, HALF)
    assert len(set(asked)) == len(asked) == mdp.n_pairs
    number = {s: mdp.space.number(name(s)) for s in range(drawn.n_states) if (name(s) in
              {state for state, _ in asked})}  # fmt: skip
    assert laws(mdp) == {
        (number[s], f"a{a}"): {(number[t], r): p for (t, r), p in law.items()}
        for (s, a), law in laws(whole).items()
        if s in number
    }
    assert certify(mdp).start_value == certify(whole).start_value


def test_what_exploring_keeps() -> None:
    """Two steps of a die with a start distribution; the ends are states without actions."""

    def outcomes(state: tuple[int, str], action: str) -> list[Any]:
        if action == "pass":
            return [(1, (2, state[1]), 0), (0, (99, "never"), 0)]
        return [("1/6", (state[0] + 1, str(face)), face) for face in range(1, 7)]

    mdp = MDP.from_function(
        {(0, "a"): "1/2", (1, "b"): "1/2"}, lambda s: [] if s[0] >= 2 else ["roll", "pass"],
        outcomes, labels={"over": lambda state: state[0] == 2},
    )  # fmt: skip
    assert mdp.labels["over"].tolist() == mdp.terminal.tolist()
    assert mdp.space.label(mdp.space.number((1, "3"))) == "state (1, '3')"
    assert mdp.n_states == 2 + 6 + 6 + 2
    assert certify(mdp).start_value == HALF * 7 + HALF * Fraction(7, 2)
    assert mdp.with_(start=(1, "3")).start == ((mdp.space.number((1, "3")), 1),)


def test_names_stay() -> None:
    mdp = MDP.from_arrays(
        {"<script>": {"$x$": {"b": "1/3", '"': "2/3"}, "go": {"b": 1}}, "b": {}, '"': {}},
        {"<script>": {"$x$": {"b": 1, '"': 0}, "go": {"b": "1/2"}}},
        start="<script>",
    )
    assert mdp.actions == ("$x$", "go")
    assert mdp.space.labels(range(3)) == ["state <script>", "state b", 'state "']
    assert certify(mdp).start_value == HALF
    renamed = MDP.from_arrays({"a": {"go": {"a": 1}}}, {"a": 0}, states=["x"], actions=["y"])
    assert (renamed.space.label(0), renamed.actions) == ("state x", ("y",))
    three = MDP.from_arrays(P, R, 0.9, actions=["stay", "go"], states=["a", "b", "c"])
    assert three.where(3) == "state b, action go"
    assert three.pair(1, "go") == three.pair(1, 1) == 3


def test_actions_may_be_the_last_index() -> None:
    law, by_move = np.moveaxis(P, 0, 2), np.arange(18.0).reshape(3, 3, 2)
    mdp = MDP.from_arrays(law, by_move, HALF, layout="ssa", components={"move": by_move})
    turned = np.moveaxis(by_move, 2, 0)
    other = MDP.from_arrays(P, turned, HALF, components={"move": turned})
    assert same(mdp, other)
    assert mdp.components.tolist() == other.components.tolist()
    assert same(MDP.from_arrays(law, R, HALF, layout="ssa"), MDP.from_arrays(P, R, HALF))


def test_lists_by_action_leave_rows_out() -> None:
    rows: list[Any] = [[[0, 1, 0], None, [0, 0, 1]], [[1, 0, 0], [HALF, HALF, 0], []]]
    mdp = MDP.from_arrays(rows, [[1, 2], [3, 4], [5, 6]], HALF)
    by_state = [[rows[action][state] for action in (0, 1)] for state in range(3)]
    assert same(mdp, MDP.from_arrays(by_state, [[1, 2], [3, 4], [5, 6]], HALF))
    assert [(s, a) for s, a, *_ in outcomes_of(mdp)] == [(0, 0), (0, 1), (1, 1), (2, 0)]
    square: list[Any] = [[[1, 0], None], [[0, 1], [1, 0]]]
    models = [MDP.from_arrays(square, [1, 2], HALF, layout=layout) for layout in ("ass", "sas")]
    assert [model.pair_state.tolist() for model in models] == [[0, 0, 1], [0, 1, 1]]


# The 4 x 3 world of Russell and Norvig, Artificial Intelligence: A Modern Approach, section 17.1.

MOVES = {"up": (0, 1), "down": (0, -1), "left": (-1, 0), "right": (1, 0)}
PLACES = [(x, y) for x in range(1, 5) for y in range(1, 4) if (x, y) != (2, 2)]
REWARDS = {place: Fraction(-4, 100) for place in PLACES} | {(4, 3): 1, (4, 2): -1}


def four_by_three() -> dict[Any, Any]:
    world: dict[Any, Any] = {(4, 3): {}, (4, 2): {}}
    for place in [each for each in PLACES if each not in world]:
        world[place] = {}
        for name, (x, y) in MOVES.items():
            chances: dict[Any, Any] = defaultdict(Fraction)
            for (east, north), chance in (((x, y), 8), ((y, x), 1), ((-y, -x), 1)):
                after = place[0] + east, place[1] + north
                chances[after if after in PLACES else place] += Fraction(chance, 10)
            world[place][name] = dict(chances)
    return world


def test_the_reward_of_an_end_is_earned_once() -> None:
    mdp = MDP.from_arrays(four_by_three(), REWARDS, start=(1, 1), labels={"exit": [(4, 3)]})
    value = {place: float(certify(mdp).value[mdp.space.number(place)]) for place in PLACES}
    published = {(1, 1): 0.705, (1, 3): 0.812, (3, 3): 0.918, (3, 2): 0.660, (4, 3): 1, (4, 2): -1}
    assert all(abs(value[place] - number) < 6e-4 for place, number in published.items())
    assert mdp.space.extra == ("end",)
    assert mdp.labels["exit"].sum() == 1


def test_the_reward_of_an_end_in_all_forms() -> None:
    law: dict[Any, Any] = {0: {0: {1: HALF, 2: HALF}}, 1: {}, 2: {}}
    for reward in ({0: 1, 1: 4, 2: -2}, [1, 4, -2], ["1", "4", "-2"], np.array([1.0, 4, -2])):
        flags = [False, True, False]
        mdp = MDP.from_arrays(law, reward, HALF, start=[1, 0, 0], labels={"x": flags})
        assert certify(mdp).value.tolist() == [Fraction(3, 2), 4, -2, 0]
        assert mdp.labels["x"].tolist() == [*flags, False]
        costs = MDP.from_arrays(law, reward, HALF, sense="min", states=["a", "b", "c"])
        assert certify(costs).value.tolist() == [Fraction(3, 2), 4, -2, 0]
        assert solve(mdp, criterion="average").value.tolist() == [0] * 4
    assert MDP.from_arrays(law, {0: 1, 1: "0", 2: float("nan")}).n_states == 3
    assert MDP.from_arrays(law, [[1], [0], [-INF]]).n_states == 3
    assert MDP.from_arrays({"end": {}}, {"end": 1}).space.extra == ("end'",)


def test_a_model_with_an_added_end_is_one_like_others(tmp_path: Path) -> None:
    law: dict[Any, Any] = {(0, 0): {"go": {(0, 1): 1}, "stay": {(0, 0): 1}}, (0, 1): {}}
    mdp = MDP.from_arrays(
        law, {(0, 0): 0, (0, 1): 5}, HALF, start=(0, 0), labels={"goal": [(0, 1)]}
    )
    save(mdp, tmp_path / "m.npz")
    assert certify(load(tmp_path / "m.npz")).start_value == Fraction(5, 2)
    assert certify(mdp.reaching("goal")).start_value == 1
    assert certify(mdp.within(2)).start_value == Fraction(5, 2)
    assert Policy.of(mdp, [0, 0]).weights(mdp)[:2].tolist() == [1, 0]  # without a row of the end
    assert Policy.of(mdp, {(0, 0): "go"}).weights(mdp)[:2].tolist() == [1, 0]


def test_components_are_dictionaries_as_rewards_are() -> None:
    law = {"a": {"x": {"a": HALF, "b": HALF}, "y": {"b": 1}}, "b": {}}
    part = {"once": {"a": 0, "b": 3}, "move": {"a": {"x": {"a": 2, "b": 4}, "y": 1}}}
    mdp = MDP.from_arrays(law, {"a": {"x": 3, "y": 1}}, components=part)
    assert mdp.component_names == ("once", "move", "rest")
    assert mdp.components.tolist() == [[0, 3, 0], [0, 1, 0], [3, 0, -3], [0, 0, 0]]
    assert mdp.reward.tolist() == [3, 1, 0, 0]
    numbers: dict[Any, Any] = {0: {0: {1: HALF, 2: HALF}}, 1: {}, 2: {}}
    for part, amounts in (([1, 0, 0], [1, 0, 0]), ({0: 1, 2: 4}, [1, 0, 4, 0])):
        mdp = MDP.from_arrays(numbers, [0] * 3, components={"a": part})
        assert mdp.components[:, 0].tolist() == amounts
    mdp = MDP.from_arrays(numbers, [0, 7, 0], components={"a": [[5], [0], [0]]})
    assert mdp.components.tolist() == [[5, -5], [0, 7], [0, 0], [0, 0]]


# ---- the start, components, and what a model tells -----------------------------------------------

STARTS = [2, "2", {2: 1}, {"2": "1/1", 0: 0}, [0, 0, 1], np.array([0.0, 0, 1]), (0, 0, 1),
          pd.Series([0, 1.0], [1, 2])]  # fmt: skip


@pytest.mark.parametrize("start", STARTS, ids=str)
def test_a_start_in_any_form(start: Any) -> None:
    eye, rows = np.eye(3), [(s, 0, [(1, s, 0)]) for s in range(3)]
    columns = ["episode", "state", "action", "reward", "next_state"]
    records = pd.DataFrame([(s, s, "go", 0, s) for s in range(3)], columns=columns)
    for mdp in (
        MDP.from_arrays([eye], [0, 0, 0], start=start),
        MDP.from_pairs([0, 1, 2], [0, 0, 0], eye, [0, 0, 0], start=start),
        MDP.from_outcomes(rows, start=start),
        MDP.from_arrays([eye], [0, 0, 0]).with_(start=start),
        MDP.from_gymnasium({s: {0: [(1, s, 0, False)]} for s in range(3)}, start=start),
        MDP.from_transitions(records, start=start),
    ):
        assert mdp.start == ((2, Fraction(1)),)


def test_a_start_goes_by_names_or_by_the_models_order() -> None:
    def still(*states: str) -> MDP:
        return MDP.from_arrays([np.eye(len(states))], [0] * len(states), states=states)

    assert still("x", "y", "2 or so").with_(start="2 or so").start == ((2, 1),)
    mdp = still("2", "0", "1").with_(start={"1": THIRD, "0": 1 - THIRD})
    assert mdp.start == ((1, 1 - THIRD), (2, THIRD))
    assert mdp.start_distribution == pytest.approx([0, 2 / 3, 1 / 3])
    assert mdp.with_(start=mdp.start).start == mdp.start
    words = still("a", "b")
    tuples = MDP.from_function(
        (0, 0), lambda s: ["go"] if s == (0, 0) else [], lambda s, a: [(1, (0, 1), 0)]
    )
    assert tuples.with_(start=(0, 1)).start == ((1, Fraction(1)),)
    timed = tuples.within(2)
    assert timed.with_(start=timed.start).start == timed.start
    for model, start, what in (
        (mdp, {1: THIRD, 2: 1 - THIRD}, "in the model's order, and the two differ"),
        (words, {"a": "1/3", 0: "2/3"}, "state a appears twice"),
        (tuples, [(0, 1)], "1 entries for 2 states"),
    ):
        with pytest.raises(ModelError, match=what):
            model.with_(start=start)
    rows = [(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 0, 0)]), (1, 1, [(1, 0, 1)])]
    time = MDP.from_outcomes(rows, states=["time out", "time in"], actions=["x", "y"]).within(2)
    printed = {time.space.label(s): "xy"[s % 2] for s in range(4)}
    for policy in ({"time out": "x", "time in": "y"}, printed):
        wanted = Policy.of(time, [0, 1]).weights(time)
        assert Policy.of(time, policy).weights(time).tolist() == wanted.tolist()


def amounts(mdp: MDP, name: str) -> list[Fraction]:
    return [Fraction(int(a), int(b)) for a, b in zip(*mdp.component(name), strict=True)]


def npz_of(mdp: MDP, folder: Path) -> MDP:
    save(mdp, folder / "m.npz")
    return load(folder / "m.npz")


AMOUNTS = st.one_of(st.fractions(-9, 9, max_denominator=7), st.floats(-4, 4), st.integers(-9, 9))


def test_a_component_that_is_the_reward_is_taken_where_its_mean_is_0() -> None:
    law = [[[0.1, 0.7, 0.2], [0, 1, 0], [0, 0, 1]]]
    reward = [[[7, -1, 0], [0] * 3, [0] * 3]]
    mdp = MDP.from_arrays(law, reward, "1/2", components={"x": reward})
    assert mdp.component_names == ("x",)


@pytest.mark.parametrize(("total", "part"), [(1e12 + 0.5, 1e12), (1 + 1e-13, 1.0)])
def test_little_that_is_left_of_a_large_reward_is_left(total: float, part: float) -> None:
    mdp = MDP.from_pairs([0], [0], [[1]], [total], "1/2", components={"x": [part]})
    assert mdp.component_names == ("x", "rest")
    assert mdp.components[0].tolist() == [part, total - part]


@settings(max_examples=30)
@given(
    st.lists(st.lists(AMOUNTS, min_size=3, max_size=3), min_size=1, max_size=3),
    st.permutations(range(3)),
)
def test_components_are_kept_exactly_and_what_is_left_is_the_rest(
    tmp_path_factory: pytest.TempPathFactory, parts: list[list[Any]], order: list[int]
) -> None:
    """By every constructor, in any order of the pairs, in a file, of costs, within some steps."""
    chances = np.array([[0, 1, 0], [0, 0, 1], [0, 0, 1]])
    reward, folder = ["1/7", 5, 0], tmp_path_factory.mktemp("kept")
    named = {f"c{number}": row for number, row in enumerate(parts)}
    turned = {name: [row[i] for i in order] for name, row in named.items()}
    arrays = MDP.from_arrays([chances], reward, "1/2", components={
        name: [[x] for x in row] for name, row in named.items()})  # fmt: skip
    outcomes = [(i, 0, [(1, int(chances[i].argmax()), reward[i])]) for i in order]
    table = {s: {0: [(1.0, int(chances[s].argmax()), 0.0, False)]} for s in range(3)}
    plain = SimpleNamespace(P=table)
    models = [
        arrays,
        MDP.from_pairs(order, [0] * 3, chances[order], [reward[i] for i in order], "1/2",
                       components=turned),
        MDP.from_outcomes(outcomes, "1/2", components=turned),
        MDP.from_outcomes(outcomes, "1/2").with_(components=named),
        npz_of(arrays, folder),
        negated(negated(arrays)),
    ]  # fmt: skip
    left = [Fraction(r) - sum(Fraction(row[s]) for row in parts) for s, r in enumerate(reward)]
    for mdp in models:
        assert all(amounts(mdp, name) == [Fraction(x) for x in row] for name, row in named.items())
        assert ("rest" in mdp.component_names) is any(left)
        assert not any(left) or amounts(mdp, "rest") == left
        assert np.allclose(mdp.components.sum(axis=1), mdp.reward)
    timed = arrays.within(2)
    pairs = [timed.pair(state, 0) for state in range(3)]
    for name, row in named.items():
        assert [amounts(timed, name)[pair] for pair in pairs] == [Fraction(x) for x in row]
        theirs = MDP.from_gymnasium(plain, "1/2", start=0, components={name: row})
        assert amounts(theirs, name) == [Fraction(x) for x in row]


def test_components_of_transitions_of_functions_and_of_scenarios(tmp_path: Path) -> None:
    """Amounts of outcomes are averaged exactly; wide ones survive files; old files are read."""
    chances = [[["1/3", "2/3"], [0, 1]], [["1/2", "1/2"], [0, 1]]]
    by_move = np.array([[[3, "3/2"], [0, 0]]] * 2, dtype=object)
    mdp = MDP.from_arrays(chances, by_move, components={"move": by_move}, layout="ass")
    assert (mdp.component_names, amounts(mdp, "move")) == (("move",), [2, Fraction(9, 4), 0, 0])
    outcomes = [("1/3", "b", {"care": "3/2", "time": -1}), ("2/3", "c", {"time": "-1/2"})]
    explored = MDP.from_function("a", lambda s: ["go"] * (s == "a"), lambda s, a: outcomes)
    assert explored.component_names == ("care", "time")
    assert [amounts(explored, n) for n in ("care", "time")] == [[HALF, 0, 0], [-2 * THIRD, 0, 0]]
    assert [r for _, _, r in explored.table.row(0)] == [HALF, -HALF]
    mixed = MDP.from_function(
        0, lambda s: "x" * (s < 1), lambda s, a: [(0.5, 1, {"x": 0.1}), (0.5, 2, 3)]
    )
    assert mixed.component_names == ("x", "rest")
    assert mixed.components[0].tolist() == [0.05, 1.5]
    wide = {"a": [Fraction(10**40 + 1, 3**50), 0], "b": ["1/3", 0]}
    ends = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(ends, components=wide)
    save(mdp, tmp_path / "m.umb")
    for again in (npz_of(mdp, tmp_path), load(tmp_path / "m.umb")):
        assert all(amounts(again, name) == amounts(mdp, name) for name in mdp.component_names)
    other = MDP.from_arrays(P, R + 1, 0.9)
    changed = MDP.from_arrays(P, R, 0.9).with_(table=other.table)
    assert changed.components[:, 0].tolist() == changed.reward.tolist() == other.reward.tolist()


@given(models())
def test_what_a_model_tells_can_be_given_back(drawn: Rows) -> None:
    mdp = drawn.model()
    last = mdp.n_states - 1
    flags = np.arange(mdp.n_states) == last
    mdp = mdp.with_(
        start={0: 1} if not last else {0: THIRD, last: 1 - THIRD}, labels={"last": flags},
        components={"pairs": np.arange(mdp.n_pairs)}, name="drawn",
    )  # fmt: skip
    names = ("start", "name", "sense", "space", "actions", "component_names")
    parts: dict[str, Any] = {name: getattr(mdp, name) for name in names}
    parts |= {"labels": mdp.labels, "action_objects": mdp.action_objects, "goal": mdp.goal}
    parts["components"], rate = mdp.components, mdp.discount_exact
    square = [mdp.P(action) for action in mdp.actions]
    for again in (
        MDP.from_arrays(square, mdp.R, rate, layout="ass", **parts),
        MDP.from_pairs(mdp.pair_state, mdp.pair_action, mdp.transition, mdp.reward, rate, **parts),
        MDP.from_outcomes(outcomes_of(mdp), rate, **parts),
        mdp.with_(**parts),
    ):
        for name in names:
            assert getattr(again, name) == getattr(mdp, name)
        assert again.components.tolist() == mdp.components.tolist()
        assert again.labels["last"].tolist() == flags.tolist()
        assert laws(again).keys() == laws(mdp).keys()
        assert pickle.loads(pickle.dumps(again)).start == mdp.start


def test_a_start_in_a_table_goes_by_its_labels() -> None:
    lake = MDP.from_gymnasium("FrozenLake-v1", "99/100")
    start = pd.Series(["1/4", "3/4"], [7, 2])
    assert lake.with_(start=start).start == ((2, Fraction(3, 4)), (7, Fraction(1, 4)))
    levels = pd.MultiIndex.from_tuples([(0, 1), (2, 3)], names=["column", "row"])
    with pytest.raises(ModelError, match="several levels of labels"):
        lake.with_(start=start.set_axis(levels))


def test_an_array_that_another_object_lends_is_not_changed() -> None:
    """Rows are normalized in a copy of it, also where it may not be written to."""
    given = np.array([[[0.1, 0.2, 0.6999999999998999], [0, 1, 0], [0, 0, 1]]])
    given.setflags(write=False)

    class Lent:
        def __array__(self, *_: Any, **__: Any) -> Any:
            return given

    assert MDP.from_arrays(Lent(), [[0], [0], [0]], layout="ass").table.row(0)[2][0] == Fraction(
        7, 10
    )
    assert given[0, 0, 2] == 0.6999999999998999
