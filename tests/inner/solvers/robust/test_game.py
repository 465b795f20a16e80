"""The game of the agent and nature: its policies, its margins, and its parts."""

from fractions import Fraction
from itertools import product

import numpy as np
import pytest

from exact_mdp import MDP, Intervals
from exact_mdp.solvers.endless.quotient import build_quotient
from exact_mdp.solvers.robust.game import Game, RobustModel, verify_margins

SHARE = 0.3


def ending(seed: int) -> MDP:
    """Return a model of three states with two actions, of two outcomes each, and an end."""
    rng = np.random.default_rng(seed)
    rows = []
    for state, action in product(range(3), range(2)):
        p = float(rng.uniform(0.2, 0.8))
        other = int(rng.integers(0, 3))
        rows.append((state, action, [(p, other, -1), (1 - p, 3, float(rng.normal()))]))
    return MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], 1)


def game_of(mdp: MDP, *, against: bool, weights: np.ndarray | None = None) -> Game:
    return Game(mdp, Intervals.relative(mdp, SHARE), against=against, weights=weights)


def values_by_hand(mdp: MDP, pairs: tuple[int, ...], *, against: bool) -> np.ndarray:
    """Return the values of a policy, nature trying both ends of each interval."""
    found = []
    for ends in product((0, 1), repeat=3):
        chain, earned = np.zeros((3, 3)), np.zeros(3)
        for state, (pair, end) in enumerate(zip(pairs, ends, strict=True)):
            (p, other, gain), (_, _, last) = mdp.table.row(pair)
            low = max(float(p) * (1 - SHARE), 1 - (1 - float(p)) * (1 + SHARE))
            high = min(float(p) * (1 + SHARE), 1 - (1 - float(p)) * (1 - SHARE))
            q = (low, high)[end]
            chain[state, other] = q
            earned[state] = q * float(gain) + (1 - q) * float(last)
        found.append(np.linalg.solve(np.eye(3) - chain, earned))
    return np.min(found, axis=0) if against else np.max(found, axis=0)


@pytest.mark.parametrize("against", [True, False])
@pytest.mark.parametrize("seed", range(5))
def test_improvement_ends_with_the_best_of_all_policies(seed: int, *, against: bool) -> None:
    mdp = ending(seed)
    each = {pairs: values_by_hand(mdp, pairs, against=against)
            for pairs in product((0, 1), (2, 3), (4, 5))}  # fmt: skip
    game = game_of(mdp, against=against)
    for first in each:
        pairs, value, gain = game.improve_policy(mdp, np.array([*first, 6]))
        assert value[:3] == pytest.approx(np.max([*each.values()], axis=0), abs=1e-9)
        assert each[tuple(pairs[:3].tolist())] == pytest.approx(value[:3], abs=1e-9)
        assert (gain.value <= gain.noise).all()
        assert gain.value[pairs] == pytest.approx(0, abs=1e-9)
        fixed = game.solve_nature(np.zeros(4), game.take_pairs(np.array([*first, 6])), None)
        assert fixed[:3] == pytest.approx(each[first], abs=1e-9)


def test_a_part_is_played_with_the_sets_of_the_model_that_it_comes_from() -> None:
    """States 0 and 1 become one, which may stop with 5; the outcomes keep their intervals."""
    mdp = ending(2)
    part = build_quotient(mdp, np.array([1, 2, 4]), np.array([0, 0, 1, -1]), stops=[(0, 5)])
    sets = Intervals.relative(mdp, SHARE)
    game = Game(mdp, sets, against=True, weights=None, part=part)
    whole = game_of(mdp, against=True)
    value = np.array([3.0, -2.0, 0.0])
    found = game.solve_inner_problem(value).value
    spread = np.array([3.0, 3.0, -2.0, 0.0])
    wanted = whole.solve_inner_problem(spread).value
    assert game.source.tolist() == [1, 2, -1, 4]
    assert found == pytest.approx([wanted[1], wanted[2], 5, wanted[4]])


def test_a_mixed_policy_that_may_stay_has_a_margin() -> None:
    """To stay is one of its two pairs: of the pairs alone one would have no margin."""
    rows = [(0, 0, [(1, 0, -1)]), (0, 1, [("1/2", 0, -1), ("1/2", 1, -1)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, 1)
    game = game_of(mdp, against=True, weights=np.array([0.5, 0.5, 1.0]))
    weight, margin = verify_margins(game)
    assert weight[0] == pytest.approx(1 / (0.5 * 0.35))
    kept = weight[0] * (0.5 + 0.5 * 0.65)
    assert 0 < margin[0] <= weight[0] - kept


def test_a_pair_is_kept_unless_another_is_better_beyond_rounding() -> None:
    mdp = MDP.from_outcomes([(0, a, [(1, 1, gain)]) for a, gain in enumerate((1, 1, 2))]
                            + [(1, 0, [(1, 0, 0)])], "1/2")  # fmt: skip
    game = game_of(mdp, against=True)
    asked, none = game.solve_inner_problem(np.zeros(2)), np.zeros(2)
    for before, doubt, after in ((1, 0.0, 2), (1, 0.4, 2), (1, 0.6, 1), (2, 0.0, 2)):
        share = game.take_pairs(np.array([before, 3]))
        kept = game.keep_pairs(share, asked, none + doubt)
        assert game.list_pairs(kept).tolist() == [after, 3]
    fixed = game_of(mdp, against=True, weights=np.array([0.5, 0.5, 0.0, 1.0]))
    share = fixed.choose_pairs(np.zeros(3))
    assert fixed.keep_pairs(share, fixed.solve_inner_problem(none), none).tolist() == [0.5, 0.5, 1]


def test_a_policy_stops_where_a_part_can() -> None:
    """State 0 moves on to 1 with its one pair; 1 has only a stop, worth 4."""
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 0)]), (0, 1, [(1, 0, 0)]), (1, 0, [(1, 1, 5)])], 1)
    stops = [(1, Fraction(4))]
    part = build_quotient(mdp, np.array([0, 1]), np.array([0, 1]), stops=stops)
    sets, weights = Intervals.relative(mdp, SHARE), np.array([1.0, 0.0, 1.0])
    game = Game(mdp, sets, against=True, weights=weights, part=part)
    assert game.source.tolist() == [0, -1]
    share = game.choose_pairs(np.zeros(2))
    assert share.tolist() == [1, 1]
    value = game.solve_chain(game.solve_inner_problem(np.zeros(3)), share, None)
    assert value.tolist() == [4, 4, 0]


def test_nature_closes_ways_whose_chance_may_be_nothing() -> None:
    mdp = ending(0)
    open_sets, closed = Intervals.relative(mdp, SHARE), Intervals.relative(mdp, 1)
    assert not RobustModel.of(mdp, open_sets, against=True, weights=None).closed.any()
    several = np.diff(mdp.table.offsets) > 1
    model = RobustModel.of(mdp, closed, against=True, weights=None)
    assert model.closed.tolist() == model.closed_of_mdp.tolist() == several.tolist()
    taken = np.array([1.0, 0, 0.5, 0.5, 0, 1, 1])
    wanted = several & (taken > 0)
    model = RobustModel.of(mdp, closed, against=True, weights=taken)
    assert model.closed.tolist() == wanted.tolist()
    assert model.closed_of_mdp.tolist() == [True, True, True, False]
