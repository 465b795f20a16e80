"""A policy's equations in rational arithmetic, forward and backward.

    x = c + γ P_π x   (values)          d = μ + γ P_πᵀ d   (visits)

By substitution where states are numbered along the transitions, otherwise by one exact linear
system over the states that do not end at once. Source: Puterman, Markov Decision Processes (1994),
sections 6.1 and 6.9.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from math import lcm
from typing import TYPE_CHECKING

import flint
import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import rational
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric.polynomial_rows import ratios
from exact_mdp.mdp.parametric.row_change import reward_entries, transition_entries
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.table import integers
from exact_mdp.solvers.exact.linear import Matrix, exact_solve
from exact_mdp.solvers.values.policy_chain import PolicyChain

if TYPE_CHECKING:
    from flint import fmpq


LARGEST = 300  # states of a model with cycles


class ExactChain:
    """A model under one policy, in rationals.

    Raises ModelError at discount 1 where an episode may never end, and for over 300 states with
    cycles.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    >>> chain = ExactChain(mdp, [0, 0])
    >>> [str(value) for value in chain.values(chain.reward)], [str(v) for v in chain.visits()]
    (['2', '0'], ['2', '0'])
    """

    def __init__(self, mdp: MDP, policy: PolicyLike) -> None:
        self.mdp, chain = mdp, PolicyChain.of(mdp, policy)
        self.whole = mdp.discount_exact == 1
        if self.whole:
            chain.require_end()
        self.rate = rational(mdp.discount_exact)
        self.reward: list[fmpq] = ratios(reward_entries(mdp))
        entries = transition_entries(mdp)
        self.rows: list[list[tuple[int, fmpq]]] = [[] for _ in range(mdp.n_pairs)]
        for key, p in zip(entries[0].tolist(), ratios(entries), strict=True):
            pair, state = divmod(key, mdp.n_states)
            self.rows[pair].append((state, p))
        weights = map(chain.exact_weights, range(mdp.n_states))
        self.weight = [[(pair, rational(w)) for pair, w in each.items()] for each in weights]
        self._acyclic = chain.order is not None
        order = range(mdp.n_states) if chain.order is None else np.argsort(chain.order).tolist()
        live = ~mdp.terminal & (chain.ends if self.whole else True)
        self._live = [state for state in order if live[state]]
        if not self._acyclic and len(self._live) > LARGEST:
            raise ModelError(
                f"{len(self._live)} states with cycles among them",
                where="exact arithmetic",
                fix=f"use at most {LARGEST} such states, or leave exact out",
            )

    def ahead(self, pair: int, value: Sequence[fmpq]) -> fmpq:
        """Return Σ P(l, s') x(s') for one pair."""
        return sum((p * value[state] for state, p in self.rows[pair]), rational(0))

    def values(self, amount: Sequence[fmpq]) -> list[fmpq]:
        """Return (S,) x = c + γ P_π x for amounts c of (L,) pairs; 0 in terminal states."""
        found = [rational(0)] * self.mdp.n_states
        if not self._acyclic:
            zero = rational(0)
            side = [sum((w * amount[pair] for pair, w in self.weight[s]), zero) for s in self._live]
            for state, value in zip(self._live, self._solve(side), strict=True):
                found[state] = value
            return found
        for state in self._live:
            gains = (
                w * (amount[pair] + self.rate * self.ahead(pair, found))
                for pair, w in self.weight[state]
            )
            found[state] = sum(gains, rational(0))
        return found

    def visits(self) -> list[fmpq]:
        """Return (S,) expected discounted visits; none to terminal states at discount 1."""
        found = [rational(0)] * self.mdp.n_states
        for state, weight in self.mdp.start:
            found[state] = rational(weight)
        if self._acyclic:
            for state in reversed(self._live):
                if found[state]:
                    self._spread(found, state, found[state])
        else:
            solved = self._solve([found[state] for state in self._live], transposed=True)
            for state, amount in zip(self._live, solved, strict=True):
                self._spread(found, state, amount)
            for state, amount in zip(self._live, solved, strict=True):
                found[state] = amount
        stay = rational(0) if self.whole else 1 / (1 - self.rate)
        live = set(self._live)
        return [d if state in live else d * stay for state, d in enumerate(found)]

    def uses(self) -> list[fmpq]:
        """Return (L,) expected discounted uses of each pair."""
        found, visits = [rational(0)] * self.mdp.n_pairs, self.visits()
        for state, weights in enumerate(self.weight):
            for pair, weight in weights:
                found[pair] = weight * visits[state]
        return found

    def _spread(self, found: list[fmpq], state: int, amount: fmpq) -> None:
        for pair, weight in self.weight[state]:
            step = self.rate * amount * weight
            for following, p in self.rows[pair]:
                found[following] += step * p

    @cached_property
    def _system(self) -> tuple[Matrix, list[int]]:
        """I - γ P_π over the live states, in integers, and what each row is multiplied by."""
        place = {state: number for number, state in enumerate(self._live)}
        row, column, entry, scale = list[int](), list[int](), list[int](), list[int]()
        for number, state in enumerate(self._live):
            shares = {number: rational(1)}
            for pair, weight in self.weight[state]:
                for following, p in self.rows[pair]:
                    if (to := place.get(following)) is not None:
                        shares[to] = shares.get(to, 0) - self.rate * weight * p
            scale.append(lcm(*(int(share.q) for share in shares.values())))
            row += [number] * len(shares)
            column += shares
            entry += [int((share * scale[-1]).p) for share in shares.values()]
        return Matrix.of(len(scale), np.array(row), np.array(column), integers(entry)), scale

    def _solve(self, side: list[fmpq], *, transposed: bool = False) -> list[fmpq]:
        """Return the solution of (I - γ P_π) x = side over the live states, or of its transpose."""
        if not side:
            return []
        matrix, scale = self._system
        given = side if transposed else [a * b for a, b in zip(side, scale, strict=True)]
        unit = lcm(*(int(number.q) for number in given))
        right = [int((number * unit).p) for number in given]
        top, below = exact_solve(matrix.transposed if transposed else matrix, right)
        found = [flint.fmpq(number, below * unit) for number in top]
        return [a * b for a, b in zip(found, scale, strict=True)] if transposed else found
