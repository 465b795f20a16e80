"""A policy's equations in rational arithmetic, forward and backward.

    x = c + γ P_π x   (values)          d = μ + γ P_πᵀ d   (visits)

By substitution where states are numbered along the transitions, otherwise by one exact linear
system over the states that do not end at once. Source: Puterman, Markov Decision Processes (1994),
sections 6.1 and 6.9.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.row_change import reward_entries, transition_entries
from exact_mdp.solvers.values.policy_chain import PolicyChain

if TYPE_CHECKING:
    from flint import fmpq, fmpq_mat

LARGEST = 300  # states of a model with cycles


class ExactChain:
    """A model under one policy, in rationals.

    Parameters
    ----------
    mdp : MDP
    policy : anything that `solvers.evaluate` takes

    Raises
    ------
    ModelError
        At discount 1 where an episode may never end; for over 300 states with cycles.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> chain = ExactChain(mdp, [0, 0])
    >>> [str(value) for value in chain.values(chain.reward)], [str(v) for v in chain.visits]
    (['2', '0'], ['2', '0'])
    """

    def __init__(self, mdp: MDP, policy: object) -> None:
        self.mdp = mdp
        self.chain = PolicyChain.of(mdp, policy)
        self.whole = mdp.discount_exact == 1
        if self.whole:
            self.chain.require_end()
        live = ~mdp.terminal & (self.chain.ends if self.whole else True)
        self.live: list[bool] = live.tolist()
        self.rate = rational(mdp.discount_exact)
        self.weight = _shares(mdp, self.chain)
        self.rows = _rows(mdp)
        _, top, bottom = reward_entries(mdp)
        self.reward = [rational(Fraction(int(a), int(b))) for a, b in zip(top, bottom, strict=True)]
        self._order = None if self.chain.order is None else np.argsort(self.chain.order).tolist()
        self._positions = [state for state, on in enumerate(self.live) if on]
        if self._order is None and len(self._positions) > LARGEST:
            raise ModelError(
                f"{len(self._positions)} states with cycles among them",
                where="exact arithmetic",
                fix=f"use at most {LARGEST} such states, or leave exact out",
            )

    def ahead(self, pair: int, value: Sequence[fmpq]) -> fmpq:
        """Return Σ P(l, s') x(s') for one pair."""
        return sum((p * value[state] for state, p in self.rows[pair]), rational(0))

    def values(self, amount: Sequence[fmpq], power: int = 1) -> list[fmpq]:
        """Return (S,) x = c + γ^power P_π x for amounts c of (L,) pairs; 0 in terminal states."""
        zero, rate = rational(0), self.rate**power
        found = [zero] * self.mdp.n_states
        constant = {
            state: sum((w * amount[pair] for pair, w in self.weight[state]), zero)
            for state in self._positions
        }
        if self._order is not None:
            for state in self._order:
                if self.live[state]:
                    step = (w * self.ahead(pair, found) for pair, w in self.weight[state])
                    found[state] = constant[state] + rate * sum(step, zero)
            return found
        solved = self._solve([constant[state] for state in self._positions], rate)
        for state, value in zip(self._positions, solved, strict=True):
            found[state] = value
        return found

    def discounted(self, start: Sequence[fmpq], power: int = 1) -> list[fmpq]:
        """Return (S,) d = μ + γ^power P_πᵀ d for μ (S,); below discount 1 terminal states stay."""
        zero, rate = rational(0), self.rate**power
        found = list(start)
        if self._order is not None:
            for state in reversed(self._order):
                if self.live[state] and found[state]:
                    self._spread(found, state, rate * found[state])
        else:
            mine = [start[state] for state in self._positions]
            solved = self._solve(mine, rate, transposed=True)
            for state in self._positions:
                found[state] = zero
            for state, value in zip(self._positions, solved, strict=True):
                self._spread(found, state, rate * value)
            for state, value in zip(self._positions, solved, strict=True):
                found[state] = value
        if not self.whole:
            stay = 1 / (1 - rate)
            found = [d if on else d * stay for d, on in zip(found, self.live, strict=True)]
        return found

    @property
    def start(self) -> list[fmpq]:
        """(S,) the start distribution."""
        found = [rational(0)] * self.mdp.n_states
        for state, weight in self.mdp.start:
            found[state] = rational(weight)
        return found

    @property
    def visits(self) -> list[fmpq]:
        """(S,) expected discounted visits; none to terminal states at discount 1."""
        found = self.discounted(self.start)
        if self.whole:
            return [d if on else rational(0) for d, on in zip(found, self.live, strict=True)]
        return found

    def uses(self, visits: Sequence[fmpq]) -> list[fmpq]:
        """Return (L,) uses of each pair from (S,) visits."""
        found = [rational(0)] * self.mdp.n_pairs
        for state, shares in enumerate(self.weight):
            for pair, share in shares:
                found[pair] = share * visits[state]
        return found

    def _spread(self, found: list[fmpq], state: int, amount: fmpq) -> None:
        for pair, share in self.weight[state]:
            for following, p in self.rows[pair]:
                found[following] += amount * share * p

    def _solve(self, side: list[fmpq], rate: fmpq, *, transposed: bool = False) -> list[fmpq]:
        from flint import fmpq_mat

        if not side:
            return []
        matrix = self._matrix(rate)
        matrix = matrix.transpose() if transposed else matrix
        return list(matrix.solve(fmpq_mat(len(side), 1, side)).entries())

    def _matrix(self, rate: fmpq) -> fmpq_mat:
        from flint import fmpq_mat

        place = {state: number for number, state in enumerate(self._positions)}
        count = len(place)
        entries = [rational(0)] * (count * count)
        for row, state in enumerate(self._positions):
            entries[row * count + row] += 1
            for pair, share in self.weight[state]:
                for following, p in self.rows[pair]:
                    if following in place:
                        entries[row * count + place[following]] -= rate * share * p
        return fmpq_mat(count, count, entries)


def rational(number: Fraction | int) -> fmpq:
    """Return a number as FLINT's rational."""
    from flint import fmpq

    return fmpq(number.numerator, number.denominator)


def fraction(number: fmpq) -> Fraction:
    """Return FLINT's rational as Python's."""
    return Fraction(int(number.p), int(number.q))


def _rows(mdp: MDP) -> list[list[tuple[int, fmpq]]]:
    key, top, bottom = transition_entries(mdp)
    rows: list[list[tuple[int, fmpq]]] = [[] for _ in range(mdp.n_pairs)]
    pair, state = np.divmod(key, mdp.n_states)
    for row, following, a, b in zip(pair.tolist(), state.tolist(), top, bottom, strict=True):
        rows[row].append((following, rational(Fraction(int(a), int(b)))))
    return rows


def _shares(mdp: MDP, chain: PolicyChain) -> list[list[tuple[int, fmpq]]]:
    """Return, for each state, its pairs and their exact probabilities."""
    states = map(chain.exact_weights, range(mdp.n_states))
    return [[(pair, rational(weight)) for pair, weight in each.items()] for each in states]
