"""What every deterministic policy of a small model is worth, by linear equations in rationals.

Nothing here is shared with the toolkit but the model's own table of outcomes.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from itertools import product

import flint

from exact_mdp import MDP

F = Fraction
Choice = tuple[int, ...]


def policies(mdp: MDP) -> Iterator[Choice]:
    """Every choice of one pair for each state."""
    return product(*(mdp.pairs_of(state) for state in range(mdp.n_states)))


def discounted(mdp: MDP, choice: Choice) -> list[Fraction]:
    """V = r + γ P V, for a discount below 1."""
    rate = mdp.discount_exact
    rows = [mdp.table.row(pair) for pair in choice]
    earned = [sum((p * r for p, _, r in row), F(0)) for row in rows]
    return _solved([{t: rate * p for p, t, _ in _merged(row)} for row in rows], earned)


def hitting(
    mdp: MDP, choice: Choice, target: Sequence[bool], allowed: Sequence[bool]
) -> list[Fraction]:
    """The probability of reaching the target through allowed states: 0 where no path leads to it,
    and there the equations are not asked, so that they have one solution."""
    rows = [_merged(mdp.table.row(pair)) for pair in choice]
    some = _backwards(rows, [bool(t) for t in target], lambda s: bool(allowed[s]))
    open_ = [bool(some[s] and allowed[s] and not target[s]) for s in range(len(rows))]
    moves = [{t: p for p, t, _ in row} if open_[s] else {} for s, row in enumerate(rows)]
    return _solved(moves, [F(bool(t)) for t in target])


def until(mdp: MDP, choice: Choice, target: Sequence[bool]) -> list[Fraction | float]:
    """The expected reward until the target; infinite where it is not reached almost surely."""
    sure = hitting(mdp, choice, target, [True] * mdp.n_states)
    rows = [mdp.table.row(pair) for pair in choice]
    open_ = [sure[s] == 1 and not target[s] for s in range(len(rows))]
    moves = [{t: p for p, t, _ in _merged(row)} if open_[s] else {} for s, row in enumerate(rows)]
    earned = [
        sum((p * r for p, _, r in row), F(0)) if open_[s] else F(0) for s, row in enumerate(rows)
    ]
    value = _solved(moves, earned)
    return [v if chance == 1 else float("inf") for v, chance in zip(value, sure, strict=True)]


def hitting_within(
    mdp: MDP, target: Sequence[bool], allowed: Sequence[bool], steps: int
) -> list[Fraction]:
    """The best probability of reaching the target within N steps, through allowed states."""
    best, value = max if mdp.sense == "max" else min, [F(bool(t)) for t in target]
    for _ in range(steps):
        after = value
        value = [
            F(bool(target[s] or allowed[s]))
            and (
                F(1)
                if target[s]
                else best(sum((p * after[t] for p, t, _ in mdp.table.row(l)), F(0)) for l in pairs)
            )
            for s, pairs in enumerate(map(mdp.pairs_of, range(mdp.n_states)))
        ]
    return value


def until_within(mdp: MDP, target: Sequence[bool], steps: int) -> list[Fraction | float]:
    """The best reward until the target; at discount 1 infinite unless N steps are surely enough."""
    best = max if mdp.sense == "max" else min
    missed = float("inf") if mdp.discount_exact == 1 else F(0)
    value: list[Fraction | float] = [F(0) if t else missed for t in target]
    for _ in range(steps):
        after = value
        value = [
            F(0)
            if target[s]
            else best(
                sum((p * (r + mdp.discount_exact * after[t]) for p, t, r in mdp.table.row(l)), F(0))
                for l in pairs
            )
            for s, pairs in enumerate(map(mdp.pairs_of, range(mdp.n_states)))
        ]
    return value


def _merged(row: Sequence[tuple[Fraction, int, Fraction]]) -> list[tuple[Fraction, int, Fraction]]:
    found: dict[int, Fraction] = {}
    for chance, then, _ in row:
        found[then] = found.get(then, F(0)) + chance
    return [(chance, then, F(0)) for then, chance in found.items()]


def _backwards(
    rows: Sequence[Sequence[tuple[Fraction, int, Fraction]]],
    found: list[bool],
    through: Callable[[int], bool],
) -> list[bool]:
    """Whether a path leads to the states found, step by step, through some states."""
    while True:
        more = [
            found[s] or (through(s) and any(found[t] for _, t, _ in row))
            for s, row in enumerate(rows)
        ]
        if more == found:
            return found
        found = more


def _solved(moves: Sequence[dict[int, Fraction]], right: Sequence[Fraction]) -> list[Fraction]:
    """x = right + moves x."""
    size = len(moves)
    left = flint.fmpq_mat(size, size)
    for s, row in enumerate(moves):
        for t, chance in row.items():
            left[s, t] -= flint.fmpq(chance.numerator, chance.denominator)
        left[s, s] += 1
    column = flint.fmpq_mat(size, 1, [flint.fmpq(v.numerator, v.denominator) for v in right])
    found = left.solve(column)
    return [F(int(found[s, 0].p), int(found[s, 0].q)) for s in range(size)]


def solution(
    rows: Sequence[Sequence[Fraction]], right: Sequence[Fraction]
) -> list[Fraction] | None:
    """x with rows x = right; None where it is not the only one."""
    left = flint.fmpq_mat([[flint.fmpq(v.numerator, v.denominator) for v in row] for row in rows])
    if left.det() == 0:
        return None
    column = flint.fmpq_mat([[flint.fmpq(v.numerator, v.denominator)] for v in right])
    found = left.solve(column)
    return [F(int(found[k, 0].p), int(found[k, 0].q)) for k in range(len(right))]
