"""Where runs end, against all deterministic policies of small models, and searches for paths."""

from dataclasses import replace
from fractions import Fraction as F
from functools import cache
from itertools import product
from typing import Any

import networkx as nx
import numpy as np
import pytest
from cases import CASES
from hypothesis import given, settings
from oracle import every_policy_ends
from refusal_tables import refused
from strategies import Rows, models, of_case

from exact_mdp import MDP, Scenario
from exact_mdp.mdp.ends import Ends
from exact_mdp.mdp.questions.advice import (
    require_termination,
)

STATES = 5
QUESTIONS = ("max", "min", "max until", "min until", "min until, maximised", "discounted")


def drawn(seed: int, question: str) -> MDP:
    """Return a random model of five states, some of which earn nothing or have a single action."""
    rng = np.random.default_rng(seed)
    words = question.split()
    # In two of three models nothing is gained, and few steps cost nothing.
    worst = -1 if words[0] == "max" else 1
    amounts = [[0, worst, worst, worst], [worst], [-1, 0, 1]][seed % 3]
    rows: list[Any] = []
    for state in range(STATES):
        ends = rng.random() < 0.4
        for action in range(rng.integers(1, 3)):
            following = rng.choice(STATES, size=rng.integers(1, 3), replace=False).tolist()
            if ends:
                following = [state]
            rewards = [int(rng.choice(amounts))] * len(following)
            if ends and rng.random() < 0.8:
                rewards = [0]
            each = zip(following, rewards, strict=True)
            rows.append((state, action, [(F(1, len(following)), t, r) for t, r in each]))
    start = {k: F(1, 2) for k in rng.choice(STATES, size=2, replace=False).tolist()}
    sense, discount = words[0], 1
    if question == "discounted":
        sense, discount = "max", F(1, 2)
    goal = rng.random(STATES) < 0.4
    goal[rng.integers(STATES)] = True
    mdp = MDP.from_outcomes(rows, discount, start=start, sense=sense, labels={"goal": goal})
    if len(words) > 1:
        mdp = mdp.until("goal")
    if words[-1] == "maximised":
        return mdp.maximised
    return mdp


ALL = [pytest.param(seed, question) for seed in range(12) for question in QUESTIONS]


def edges_of(mdp: MDP, pairs: Any) -> nx.DiGraph:
    """Return the edges of some pairs, without those of terminal states to themselves."""
    edges = nx.DiGraph()
    edges.add_nodes_from(range(mdp.n_states))
    for pair in pairs:
        state = int(mdp.pair_state[pair])
        if not mdp.terminal[state]:
            edges.add_edges_from((state, after) for _, after, _ in mdp.table.row(pair))
    return edges


def policies(mdp: MDP) -> list[tuple[int, ...]]:
    """Return all deterministic policies, as the pair of each state."""
    return [*product(*map(mdp.pairs_of, range(mdp.n_states)))]


def find_sure(edges: nx.DiGraph, target: set[int]) -> set[int]:
    """Return the states from which a chain reaches the target with probability 1.

    They cannot reach a state that has no way to the target.
    """
    going = edges.copy()
    going.remove_edges_from([(s, t) for s, t in edges.edges if s in target])
    lost = {s for s in going if not target & {s, *nx.descendants(going, s)}}
    return {s for s in going if not lost & {s, *nx.descendants(going, s)}}


def find_classes(edges: nx.DiGraph, mdp: MDP) -> list[set[int]]:
    """Return the recurrent classes of a chain, but for terminal states."""
    parts = map(set, nx.strongly_connected_components(edges))
    return [
        part
        for part in parts
        if all({*edges.successors(s)} <= part for s in part) and not mdp.terminal[[*part]].any()
    ]


@pytest.mark.parametrize(("seed", "question"), ALL)
def test_states_are_terminal_or_alike_by_their_rows(seed: int, question: str) -> None:
    mdp = drawn(seed, question)
    ends, rows = mdp.ends, [[mdp.table.row(p) for p in mdp.pairs_of(s)] for s in range(STATES)]
    idle = [all(row == [(1, s, 0)] for row in own) for s, own in enumerate(rows)]
    assert ends.terminal.tolist() == mdp.terminal.tolist() == ends.over.tolist() == idle
    assert ends.forced.tolist() == mdp.forced.tolist() == [len(own) == 1 for own in rows]
    assert ends.alike.tolist() == [all(row == own[0] for row in own) for own in rows]
    several = [len(own) > 1 and not over for own, over in zip(rows, idle, strict=True)]
    assert ends.must_choose.tolist() == several
    assert ends.choice_matters.tolist() == (several & ~ends.alike).tolist()


@pytest.mark.parametrize("seed", range(12))
def test_an_episode_is_not_over_where_amounts_are_counted(seed: int) -> None:
    mdp, rng = drawn(seed, "max"), np.random.default_rng(seed)
    amount = rng.integers(0, 2, size=mdp.n_pairs)
    amounts = {"one": amount, "other": mdp.reward - amount}
    counted = [any(amount[p] for p in mdp.pairs_of(s)) for s in range(STATES)]
    over = mdp.with_(components=amounts).ends
    assert over.over.tolist() == (mdp.terminal & ~np.array(counted)).tolist()
    assert over.terminal.tolist() == mdp.terminal.tolist()
    # Events of an outcome count as well, and make actions differ.
    happens = np.zeros(len(mdp.table.next), dtype=np.uint8)
    happens[rng.integers(len(happens))] = 1
    events = mdp.with_(table=replace(mdp.table, event=happens), events=("one",))
    state = int(mdp.pair_state[mdp.table.pair[happens.argmax()]])
    wanted = mdp.over.copy()
    wanted[state] = False
    assert events.over.tolist() == wanted.tolist()
    if not mdp.forced[state]:
        assert not events.ends.alike[state]


def test_actions_are_alike_in_each_component() -> None:
    """The first state has the same amounts for both actions; the second has them exchanged."""
    rows = [(s, a, [("1/2", 1 - s, 0), ("1/2", 2, 0)]) for s in (0, 1) for a in (0, 1)]
    mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])
    amounts = {"one": [1, 1, 1, -1, 0], "other": [-1, -1, -1, 1, 0]}
    assert mdp.ends.alike.tolist() == [True, True, True]
    assert mdp.with_(components=amounts).ends.alike.tolist() == [True, False, True]
    same = {"one": [1, 1, 1, 1, 0], "other": [-1, -1, 2, -1, 0], "third": [0, 0, -3, 0, 0]}
    assert mdp.with_(components=same).ends.alike.tolist() == [True, False, True]
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])])
    assert mdp.with_(components={"one": [1, 1, 0], "other": [-1, -1, 0]}).ends.alike.all()


@pytest.mark.parametrize(("seed", "question"), ALL)
def test_a_run_that_ends_beside_the_goal_has_missed_it(seed: int, question: str) -> None:
    mdp, asks = drawn(seed, question), "until" in question
    ends, ended = mdp.ends, set(np.flatnonzero(mdp.terminal).tolist())
    goal = set(np.flatnonzero(mdp.labels["goal"]).tolist()) if asks else ended
    assert ends.has_goal == asks
    assert set(np.flatnonzero(ends.destination).tolist()) == goal
    assert set(np.flatnonzero(ends.outside_goal).tolist()) == ended - goal
    every = np.ones(STATES, dtype=bool)
    assert ends.find_missed(every).tolist() == [asks and s not in goal for s in range(STATES)]
    assert ends.missing_pays == (question == "max until")


@pytest.mark.parametrize(("seed", "question"), ALL)
def test_every_policy_ends_or_one_is_named_that_does_not(seed: int, question: str) -> None:
    mdp = drawn(seed, question)
    ends, ended = mdp.ends, set(np.flatnonzero(mdp.terminal).tolist())
    goal, chains = set(np.flatnonzero(ends.destination).tolist()), {}
    for policy in policies(mdp):
        chains[policy] = edges_of(mdp, policy)
    stuck: set[int] = set()
    for edges in chains.values():
        stuck |= {s for s in edges if not ended & {s, *nx.descendants(edges, s)}}
    assert ends.every_policy_ends == (not stuck)
    assert set(np.flatnonzero(ends.rank < 0).tolist()) == stuck
    pairs = ends.find_endless_pairs()
    assert mdp.pair_state[pairs].tolist() == sorted(stuck)
    inside = [{t for _, t, _ in mdp.table.row(pair)} <= stuck for pair in range(mdp.n_pairs)]
    for state, pair in zip(sorted(stuck), pairs.tolist(), strict=True):
        assert pair == next(each for each in mdp.pairs_of(state) if inside[each])
    improper = any(len(find_sure(edges, goal)) < STATES for edges in chains.values())
    assert ends.has_improper_policy == (improper and question != "discounted")


@pytest.mark.parametrize(("seed", "question"), ALL)
def test_the_optimum_of_a_shortest_path_ends(seed: int, question: str) -> None:
    """The classes of all policies that keep to states from which some policy surely arrives."""
    mdp = drawn(seed, question)
    goal = set(np.flatnonzero(mdp.ends.destination).tolist())
    chains = {policy: edges_of(mdp, policy) for policy in policies(mdp)}
    sure = set().union(*(find_sure(edges, goal) for edges in chains.values()))
    staying: set[int] = set()
    for policy, edges in chains.items():
        for part in find_classes(edges, mdp):
            if part <= sure:
                staying |= {policy[state] for state in part}
    needed = set(range(STATES))
    if "until" in question and question != "max until":
        needed = {state for state, _ in mdp.start}
    expected = needed <= sure and all(mdp.sense.sign * mdp.reward[pair] < 0 for pair in staying)
    if question == "max until":
        expected = expected and not staying
    assert mdp.ends.is_shortest_path == expected
    proper = all(len(find_sure(edges, goal)) == STATES for edges in chains.values())
    assert mdp.ends.has_finite_optimum == (expected or proper or question == "discounted")


def test_the_questions_above_have_both_answers() -> None:
    for question in QUESTIONS[:5]:
        found = [drawn(seed, question).ends for seed in range(12)]
        assert {ends.is_shortest_path for ends in found} == {True, False}
        assert {ends.every_policy_ends for ends in found} == {True, False}


# ---- the order of states, and proofs of termination ----------------------------------------------


def proves(mdp: MDP, rank: np.ndarray) -> bool:
    """Whether `rank` proves that every policy ends: every pair reaches a smaller one in a step."""
    matrix, going = mdp.transition, ~mdp.terminal
    least = np.minimum.reduceat(rank[matrix.indices], matrix.indptr[:-1])
    falls = (least < rank[mdp.pair_state])[going[mdp.pair_state]].all()
    return bool(falls and (rank[going] > 0).all() and not rank[~going].any())


def test_a_state_that_may_stay_is_not_in_order() -> None:
    rows = [(0, 0, [(1, 1, 1)]), (1, 0, [("1/2", 1, 1), ("1/2", 2, 1)]), (2, 0, [(1, 2, 0)])]
    for last, in_order in ((rows[1], False), ((1, 0, [(1, 2, 1)]), True)):
        ends = MDP.from_outcomes([rows[0], last, rows[2]]).ends
        assert (ends.numbered_in_order, ends.is_acyclic) == (in_order, in_order)
        assert ends.every_policy_ends


@settings(max_examples=40)
@given(models(discounts=(F(1, 2), F(1))))
def test_in_how_many_steps_a_run_ends_and_whether_it_does(rows: Rows) -> None:
    mdp = rows.model()
    edges = edges_of(mdp, range(mdp.n_pairs))
    steps = mdp.ends.most_steps
    assert mdp.ends.is_acyclic == (steps is not None) == nx.is_directed_acyclic_graph(edges)
    rising = all(state < after for state, after in edges.edges) and bool(mdp.terminal[-1])
    assert mdp.ends.numbered_in_order == rising

    @cache
    def longest(state: int) -> int:
        return max((1 + longest(after) for after in edges.successors(state)), default=0)

    assert steps is None or steps.tolist() == [longest(s) for s in range(mdp.n_states)]
    sure = every_policy_ends(rows.n_states, rows.pairs)
    assert mdp.ends.every_policy_ends == sure == proves(mdp, mdp.ends.rank)
    if sure:
        require_termination(mdp.with_(discount=1))
        return
    pairs = mdp.ends.find_endless_pairs()
    trapped = set(mdp.pair_state[pairs].tolist())  # where that policy stays forever
    assert trapped
    assert not trapped & set(np.flatnonzero(mdp.terminal))
    assert all({t for _, t, _ in mdp.table.row(pair)} <= trapped for pair in pairs)
    refused(lambda: require_termination(mdp.with_(discount=1)), "discount 1 needs every policy to")


def test_models_end_as_they_say() -> None:
    for case in CASES:
        assert case.discount < 1 or of_case(case).ends.every_policy_ends == case.proper
    care = Scenario.load("yuan2025").with_(tasks=[1000]).compile()
    steps = care.ends.most_steps
    assert steps.max() == 5000  # four further trials of each subtask, then the next
    assert proves(care, steps)
    assert proves(care, care.ends.rank)


def test_a_model_is_freed_without_its_ends() -> None:
    """Ends keep no model alive, and are computed once."""
    mdp = drawn(0, "max")
    assert mdp.ends is mdp.ends
    assert isinstance(mdp.ends, Ends)
    assert all(value is not mdp for value in vars(mdp.ends).values())
