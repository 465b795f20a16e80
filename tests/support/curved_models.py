"""Small models whose rows and rewards are known polynomials of one number t, in plain fractions."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction as F
from functools import cache
from itertools import product
from typing import Any

import numpy as np
from oracle import Row, Vector, fixed_point, mean

from exact_mdp import MDP, Family, Parameter

Law = dict[int, F]


@dataclass(frozen=True)
class CurvedRow:
    """Pair (state, action): (1 - t)² A + 2 t (1 - t) B + t² C of three laws; a reward b + c t."""

    state: int
    action: int
    laws: tuple[Law, Law, Law]
    reward: tuple[F, F]

    def law(self, t: F) -> Law:
        return self._sum(((1 - t) ** 2, 2 * t * (1 - t), t**2))

    def law_slope(self, t: F) -> Law:
        return self._sum((-2 * (1 - t), 2 - 4 * t, 2 * t))

    def _sum(self, weights: Sequence[F]) -> Law:
        states = sorted({state for law in self.laws for state in law})
        pairs = [*zip(weights, self.laws, strict=True)]
        return {s: sum((w * law.get(s, F(0)) for w, law in pairs), F(0)) for s in states}


@dataclass(frozen=True, eq=False)
class CurvedModel:
    """Rows in the order of states and actions, a discount g + h t, and where runs begin."""

    rows: tuple[CurvedRow, ...]
    states: int
    rate: tuple[F, F]
    start: dict[int, F]
    sense: str = "max"

    @property
    def sign(self) -> int:
        return 1 if self.sense == "max" else -1

    def discount(self, t: F) -> F:
        return self.rate[0] + self.rate[1] * t

    def at(self, t: F) -> list[Row]:
        return rows_at(self, t)

    def value(self, policy: tuple[int, ...], t: F) -> Vector:
        """V = r + γ P V."""
        return value_of(self, policy, t)

    def _rows(self, t: F) -> list[Row]:
        return [(r.state, r.action, r.reward[0] + r.reward[1] * t, r.law(t)) for r in self.rows]

    def family(self, today: object = "1/2", degree: int = 2) -> Family:
        """The model as a parametric one, of a degree that is stated; t is from 0 to 1."""

        def build(at: Any) -> MDP:
            t = at["t"]
            rows = [
                (s, a, [(p, to, r) for to, p in law.items() if p]) for s, a, r, law in self.at(t)
            ]
            start = {f"state {s}": p for s, p in self.start.items()}
            return MDP.from_outcomes(rows, self.discount(t), start=start, sense=self.sense)

        (t,) = parameters = (Parameter(name="t", value=today, low=0, high=1),)
        return Family(parameters=parameters, build=build, degrees={t.name: degree})

    def policies(self) -> Iterator[tuple[int, ...]]:
        """All choices of a pair in each state."""
        own = [[l for l, r in enumerate(self.rows) if r.state == s] for s in range(self.states)]
        return product(*own)

    def _value(self, policy: tuple[int, ...], t: F) -> Vector:
        rows, rate = self.at(t), self.discount(t)
        moves = [{to: rate * p for to, p in rows[pair][3].items()} for pair in policy]
        return fixed_point([rows[pair][2] for pair in policy], self._ended(policy, moves))

    def slope(self, policy: tuple[int, ...], t: F) -> Vector:
        """V' = r' + γ' P V + γ P' V + γ P V'."""
        rows, rate, value = self.at(t), self.discount(t), self.value(policy, t)
        moves = [{to: rate * p for to, p in rows[pair][3].items()} for pair in policy]
        right = [
            self.rows[pair].reward[1]
            + self.rate[1] * mean(rows[pair][3], value)
            + rate * mean(self.rows[pair].law_slope(t), value)
            for pair in policy
        ]
        return fixed_point(right, self._ended(policy, moves))

    def _ended(self, policy: Sequence[int], moves: list[Law]) -> list[Law]:
        """The moves but those of states that are stayed in for ever, and earn nothing."""
        kept = []
        for state, (pair, move) in enumerate(zip(policy, moves, strict=True)):
            row = self.rows[pair]
            stays = all(law == {state: 1} for law in row.laws) and not any(row.reward)
            kept.append({} if stays else move)
        return kept

    def begin(self, vector: Sequence[F]) -> F:
        return mean(self.start, vector)

    def best_values(self, t: F) -> Vector:
        """The best values of all states; of costs, their negatives."""
        every = ([self.sign * v for v in self.value(each, t)] for each in self.policies())
        return max(every, key=sum)

    def best(self, t: F) -> F:
        """The best value at the start, by all policies."""
        every = (self.sign * self.begin(self.value(policy, t)) for policy in self.policies())
        return self.sign * max(every)

    def optimal_policies(self, t: F) -> list[tuple[int, ...]]:
        """The policies that are worth most from the start."""
        best = self.best(t)
        return [each for each in self.policies() if self.begin(self.value(each, t)) == best]

    def tied(self, t: F, rng: np.random.Generator) -> "CurvedModel":
        """The model with another reward of some pair, so that at t it is as good as the best."""
        top = max(self.policies(), key=lambda each: self.sign * sum(self.value(each, t)))
        value, rows = self.value(top, t), [*self.rows]
        choices = [pair for pair in range(len(rows)) if pair not in top]
        if not choices:
            return self
        pair = choices[int(rng.integers(len(choices)))]
        ahead = self.discount(t) * mean(rows[pair].law(t), value)
        rise = rows[pair].reward[1]
        base = value[rows[pair].state] - ahead - rise * t
        rows[pair] = replace(rows[pair], reward=(base, rise))
        return replace(self, rows=tuple(rows))


@cache
def rows_at(model: CurvedModel, t: F) -> list[Row]:
    return model._rows(t)


@cache
def value_of(model: CurvedModel, policy: tuple[int, ...], t: F) -> Vector:
    return model._value(policy, t)


def curved_model(seed: int, kind: str = "cyclic", sense: str = "max") -> CurvedModel:
    """A random model of 3 to 4 states, of which the last is an end.

    "acyclic" models have a discount of 1 or less, "cyclic" ones one below 1 that moves, and
    "ending" ones discount 1 and a way to the end in every row.
    """
    rng = np.random.default_rng(seed)
    states, rows = int(rng.integers(3, 5)), list[CurvedRow]()

    def law(state: int) -> Law:
        after = range(state + 1 if kind == "acyclic" else 0, states)
        weight = {to: int(rng.integers(0, 4)) for to in after}
        if kind == "ending" or not any(weight.values()):
            weight[states - 1] += 1
        total = sum(weight.values())
        return {to: F(w, total) for to, w in weight.items() if w}

    for state in range(states - 1):
        for action in range(int(rng.integers(1, 3)) if state else 2):
            first, last = law(state), law(state)
            between = {to: (first.get(to, F(0)) + last.get(to, F(0))) / 2 for to in {*first, *last}}
            middle = between if rng.random() < 0.5 else law(state)
            base, rise = rng.integers(-6, 7, 2).tolist()
            rows.append(CurvedRow(state, action, (first, middle, last), (F(base), F(rise))))
    end = {states - 1: F(1)}
    rows.append(CurvedRow(states - 1, 0, (end, end, end), (F(0), F(0))))
    rates = {"acyclic": (F(1), F(0)), "ending": (F(1), F(0)), "cyclic": (F(1, 2), F(1, 3))}
    start = {0: F(1)} if rng.random() < 0.5 else {0: F(1, 3), 1: F(2, 3)}
    return CurvedModel(tuple(rows), states, rates[kind], start, sense)


KINDS = ("acyclic", "cyclic", "ending")
