"""A model laid out for sampling: alias tables give back its rows, and rows are shared rightly."""

import numpy as np
import pytest

from exact_mdp import MDP, Column, ModelError, Scenario, StateSpace
from exact_mdp.solvers.learning.sampler import (
    build_q_table_rows,
    build_sampling_tables,
    make_random_stream,
    spawn_child_seed,
)


@pytest.mark.parametrize("seed", range(8))
def test_alias_tables_give_each_outcome_its_probability(seed: int) -> None:
    """A column of n is drawn with 1/n; its cut says which part is its own, the rest its alias."""
    rng = np.random.default_rng(seed)
    rows = rng.dirichlet(np.full(5, 0.5), (3, 5))
    mdp = MDP.from_arrays(rows, rng.normal(size=(5, 3)), "9/10", start={1: "1/8", 3: "7/8"})
    laid = build_sampling_tables(mdp, build_q_table_rows(mdp))
    for pair in range(mdp.n_pairs):
        first, last = laid.offsets[pair], laid.offsets[pair + 1]
        chance = np.zeros(5)
        for i in range(first, last):
            chance[laid.next[2 * i]] += laid.cut[i] / (last - first)
            chance[laid.next[2 * i + 1]] += (1 - laid.cut[i]) / (last - first)
        s, a = mdp.pair_state[pair], mdp.pair_action[pair]
        assert chance == pytest.approx(rows[a, s])
        assert laid.gain[2 * first : 2 * last] == pytest.approx(mdp.reward[pair])
    assert (laid.start.tolist(), laid.start_total.tolist()) == ([1, 3], [0.125, 1.0])
    assert laid.entry[: mdp.n_pairs].tolist() == (mdp.pair_state * 3 + mdp.pair_action).tolist()


def test_states_that_agree_in_the_columns_share_a_row() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile()
    rows = build_q_table_rows(mdp)
    assert rows.space.size == 16
    labels = [mdp.space.label(s) for s in range(mdp.n_states)]
    for s, label in enumerate(labels):
        own = label.rpartition(" ")[2]
        assert rows.key[s] == (int(own, 2) if set(own) <= {"0", "1"} else 0)
    assert rows.offered[:, :4].all()
    assert build_q_table_rows(mdp, mdp.space.names).space.size >= mdp.n_states - 1


def test_states_of_different_actions_share_no_row() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 0, 0)]), (1, 0, [(1, 1, 0)])]
    offered = build_q_table_rows(MDP.from_outcomes(rows, "1/2")).offered
    assert offered.tolist() == [[True, True], [True, False]]
    space = StateSpace(columns=(Column(name="place", size=2), Column(name="side", size=2)))
    both = [(s, a, [(1, (s + a) % 4, 0)]) for s in range(4) for a in range(2 + (s == 1))]
    mdp = MDP.from_outcomes(both, "1/2").with_(space=space)
    with pytest.raises(ModelError, match="different actions"):
        build_q_table_rows(mdp, ["place"])
    assert build_q_table_rows(mdp, ["place", "side"]).offered[:, 2].tolist() == [
        False,
        True,
        False,
        False,
    ]


def test_a_child_is_the_one_that_numpy_spawns() -> None:
    children = np.random.SeedSequence(7).spawn(3)
    assert [spawn_child_seed(7, k).generate_state(2).tolist() for k in range(3)] == [
        each.generate_state(2).tolist() for each in children
    ]
    assert spawn_child_seed(spawn_child_seed(7, 1), 2).spawn_key == (1, 2)
    assert (
        make_random_stream(7).tolist()
        == np.random.SeedSequence(7).generate_state(4, np.uint64).tolist()
    )
