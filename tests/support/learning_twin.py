"""Tabular learning once more, in plain Python from the text of the methods; shares only the stream.

Random words are xoshiro256++ on Python integers. Probabilities come from the alias columns of the
laid-out model, which a test of their own compares with the model's exact rows.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

WORD = 2**64 - 1


class Stream:
    """Doubles in [0, 1) from four 64-bit words."""

    def __init__(self, words: Sequence[int]) -> None:
        self.s = [int(word) for word in words]

    def __call__(self) -> float:
        s = self.s
        mixed = (s[0] + s[3]) & WORD
        drawn = (self.rotated(mixed, 23) + s[0]) & WORD
        shifted = (s[1] << 17) & WORD
        s[2] ^= s[0]
        s[3] ^= s[1]
        s[1] ^= s[2]
        s[0] ^= s[3]
        s[2] ^= shifted
        s[3] = self.rotated(s[3], 45)
        return (drawn >> 11) / 2**53

    @staticmethod
    def rotated(word: int, by: int) -> int:
        return ((word << by) | (word >> (64 - by))) & WORD


@dataclass
class Twin:
    """A learner with dictionaries, by the settings of another one."""

    tables: Any  # the laid-out model
    actions: int
    learner: Any

    def run(self, words: Sequence[int], numbers: Collection[int]) -> None:
        """Learn; keep the greedy policies after the episodes of these numbers, from 1."""
        own = self.learner
        self.discount, self.power = float(own.discount), own.rate_power
        self.initial: float = own.initial
        rates = (each.values(own.epochs) for each in (own.exploration, own.rate))
        self.random = Stream(words)
        self.q: list[dict[int, float]] = [{}, {}]
        self.double = own.method == "double-q-learning"
        self.seen: Counter[int] = Counter()
        self.steps = self.cut = 0
        self.returns, self.policies, episode = [], {}, 0
        for eps, alpha in zip(*rates, strict=True):
            total = 0.0
            for _ in range(own.episodes):
                total = self.episode(eps, alpha, own.max_steps, total)
                episode += 1
                if episode in numbers:
                    self.policies[episode] = self.greedy_policy()
            self.returns.append(total / own.episodes)

    # ---- values and choices ------------------------------------------------------------------

    def value(self, entry: int) -> float:
        if self.double:
            return self.one(0, entry) + self.one(1, entry)
        return self.one(0, entry)

    def one(self, table: int, entry: int) -> float:
        return self.q[table].get(entry, self.initial)

    def entries(self, state: int) -> list[int]:
        low, high = int(self.tables.low[state]), int(self.tables.high[state])
        return [int(entry) for entry in self.tables.entry[low:high]]

    def best(self, values: Sequence[float]) -> int:
        ties = [i for i, value in enumerate(values) if value == max(values)]
        if self.learner.ties == "random" and len(ties) > 1:
            return ties[int(self.random() * len(ties))]
        return ties[-1] if self.learner.ties == "last" else ties[0]

    def choose(self, state: int, eps: float) -> int:
        entries = self.entries(state)
        drawn = self.random()
        if drawn < eps:
            return min(int(drawn / eps * len(entries)), len(entries) - 1)
        return self.best([self.value(entry) for entry in entries])

    def greedy_policy(self) -> list[int]:
        policy = []
        for row in range(len(self.tables.row_offsets) - 1):
            span = slice(*self.tables.row_offsets[row : row + 2])
            entries = [int(entry) for entry in self.tables.row_entry[span]]
            if self.learner.ties == "last":
                entries.reverse()
            policy.append(max(entries, key=self.value) - row * self.actions)
        return policy

    # ---- episodes ----------------------------------------------------------------------------

    def start(self) -> int:
        if len(self.tables.start) == 1:
            return int(self.tables.start[0])
        drawn = self.random()
        for state, total in zip(self.tables.start, self.tables.start_total, strict=True):
            if drawn < total:
                return int(state)
        return int(self.tables.start[-1])

    def outcome(self, pair: int) -> tuple[int, float]:
        first, last = (int(x) for x in self.tables.offsets[pair : pair + 2])
        scaled = self.random() * (last - first)
        column = int(scaled)
        side = 0 if scaled - column < self.tables.cut[first + column] else 1
        place = 2 * (first + column) + side
        return int(self.tables.next[place]), float(self.tables.gain[place])

    def episode(self, eps: float, alpha: float, max_steps: int, total: float) -> float:
        state, planned = self.start(), None
        for _ in range(max_steps):
            if self.tables.terminal[state]:
                return total
            self.steps += 1
            choice = self.choose(state, eps) if planned is None else planned
            entry = self.entries(state)[choice]
            state, gain = self.outcome(int(self.tables.low[state]) + choice)
            total += gain
            table = int(self.double and self.random() < 0.5)
            over = self.tables.terminal[state]
            planned, ahead = None, 0.0
            if self.learner.bootstrap_end or not over:
                ahead, planned = self.ahead(state, eps, table)
            self.seen[entry] += 1
            size = alpha if self.power == 0 else alpha * float(self.seen[entry]) ** -self.power
            old = self.one(table, entry)
            self.q[table][entry] = old + size * (gain + self.discount * ahead - old)
        if not self.tables.terminal[state]:
            self.cut += 1
        return total

    def ahead(self, state: int, eps: float, table: int) -> tuple[float, int | None]:
        entries = self.entries(state)
        values = [self.value(entry) for entry in entries]
        if self.learner.method == "q-learning":
            return max(values), None
        if self.learner.method == "sarsa":
            planned = self.choose(state, eps)
            return values[planned], planned
        if self.learner.method == "expected-sarsa":
            mean = 0.0
            for value in values:
                mean += value / len(values)
            return (1 - eps) * max(values) + eps * mean, None
        chosen = self.best([self.one(table, entry) for entry in entries])
        return self.one(1 - table, entries[chosen]), None

    def table(self, rows: int) -> np.ndarray:
        share = 2 if self.double else 1
        flat = [self.value(entry) / share for entry in range(rows * self.actions)]
        return np.array(flat).reshape(rows, self.actions)
