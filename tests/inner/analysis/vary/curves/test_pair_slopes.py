"""The change of what pairs earn, against the same sums over rows that are written out."""

from fractions import Fraction as F

import numpy as np
import pytest
from flint import fmpq

from exact_mdp import MDP, Family, ModelError, Parameter
from exact_mdp.analysis.vary.curves.pair_slopes import (
    compute_pair_slopes,
    find_newly_live_states,
    list_slopes,
    make_tie_error,
    refuse_silence,
)
from exact_mdp.mdp.exact import from_flint
from exact_mdp.mdp.parametric.row_change import find_pieces, row_change, transition_entries


def build(at: dict[str, F]) -> MDP:
    """From 0 to 1 with chance t², at discount t / 2; 0 earns 3 t, and 1 a (t - 1/2) from 1/2 on.

    States 2 and 3 end; the second, without a choice, earns t - 1/2 as well.
    """
    t = at["t"]
    rows = [(0, a, [(t**2, 1, 3 * t), (1 - t**2, 0, 3 * t)]) for a in (0, 1)]
    rows += [(1, a, [(1, 1, a * (t - F(1, 2)))]) for a in (0, 1)]
    rows += [(2, a, [(1, 2, 0)]) for a in (0, 1)]
    return MDP.from_outcomes([*rows, (3, 0, [(1, 3, t - F(1, 2))])], discount=t / 2)


FAMILY = Family(
    parameters=(Parameter(name="t", value="1/2", low=0, high=1),), build=build, degrees={"t": 2}
)


@pytest.mark.parametrize("exact", [True, False])
def test_what_a_pair_earns_changes_with_reward_chance_and_discount(exact: bool) -> None:
    mdp = FAMILY.at({})
    _, piece = find_pieces(FAMILY, "t", F(1, 2))
    assert piece is not None
    change = row_change(FAMILY, "t", piece, mdp)
    keys, top, bottom = transition_entries(mdp)
    ratios = [F(int(a), int(b)) for a, b in zip(top, bottom, strict=True)]
    value = [F(5), F(7), F(0), F(3)]
    if exact:
        kind, to = (lambda x: x), lambda x: fmpq(x.numerator, x.denominator)
    else:
        kind, to = (lambda x: float(from_flint(x))), float
    rows = keys, np.array([to(x) for x in ratios], dtype=object if exact else float)
    values = np.array([to(x) for x in value], dtype=object if exact else float)
    earned = compute_pair_slopes(*list_slopes(mdp, change, kind, rows), values, mdp.n_pairs)
    # 3 + γ 2 t (7 - 5) + (1/4 · 7 + 3/4 · 5) / 2; the others stay.
    first = 3 + F(1, 4) * 2 + F(11, 2) / 2
    wanted = [first, first, F(7) / 2, 1 + F(7) / 2, F(0), F(0), 1 + F(3) / 2]
    assert [float(from_flint(x) if exact else x) for x in earned] == [float(x) for x in wanted]


def test_states_that_begin_need_an_action() -> None:
    mdp = FAMILY.at({})
    _, piece = find_pieces(FAMILY, "t", F(1, 2))
    assert piece is not None
    begun = find_newly_live_states(mdp, row_change(FAMILY, "t", piece, mdp))
    assert begun.tolist() == [False, True, False, False]
    refuse_silence(mdp, begun & False, "t")
    with pytest.raises(ModelError, match="names no action in a state that is term") as refused:
        refuse_silence(mdp, begun, "t")
    assert refused.value.where == "parameter t, state 1"
    assert (
        refused.value.fix == "give an action there, too, by a mapping or an array over all states"
    )
    tie = make_tie_error("state 1")
    assert tie.where == "state 1"
    assert tie.fix == "ask for exact=True, which gives one-sided derivatives at a tie"
