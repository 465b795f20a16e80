"""Slow, exact references for acting on a perceived status: no code of the toolkit is used.

A model is given as rows: rows[place, status, action] is a list of (probability, next, reward,
signal), where next is (place, status) or None at the end. What is seen of a step is the next
place and the signal; then the status is perceived with probability confusion[true][seen].
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Hashable, Mapping, Sequence
from fractions import Fraction
from itertools import product
from typing import Any

Rows = Mapping[tuple[Any, Any, str], Sequence[tuple[Fraction, Any, Fraction, Hashable]]]
Belief = dict[Any, Fraction]


class Hidden:
    """The optimum over all that one may remember, and over what one may do without memory."""

    def __init__(
        self,
        rows: Rows,
        confusion: Mapping[Any, Mapping[Any, Fraction]],
        start: tuple[Any, Belief],
        discount: Fraction,
    ) -> None:
        self.rows, self.confusion, self.start, self.discount = rows, confusion, start, discount
        self.seen = sorted({z for row in confusion.values() for z in row})

    def actions(self, place: Any) -> list[str]:
        return sorted({a for p, _, a in self.rows if p == place})

    def best(self) -> Fraction:
        """The greatest value of any controller, by the whole tree of beliefs."""
        return self._before(*self.start)

    def _before(self, place: Any, belief: Belief) -> Fraction:
        total = Fraction(0)
        for z in self.seen:
            after = {s: b * self.confusion[s].get(z, Fraction(0)) for s, b in belief.items()}
            after = {s: b for s, b in after.items() if b}
            if after:
                total += max(self._acting(place, after, a) for a in self.actions(place))
        return total

    def _acting(self, place: Any, belief: Belief, action: str) -> Fraction:
        worth = Fraction(0)
        onward: dict[tuple[Any, Hashable], dict[Any, Fraction]]
        onward = defaultdict(lambda: defaultdict(Fraction))
        for s, b in belief.items():
            for p, following, reward, signal in self.rows[place, s, action]:
                worth += b * p * reward
                if following is not None:
                    onward[following[0], signal][following[1]] += b * p
        for (there, _), moved in onward.items():
            worth += self.discount * self._before(there, dict(moved))
        return worth

    def value(self, policy: Mapping[tuple[Any, Any], str]) -> Fraction:
        """The value of a policy from (place, perceived status) to an action."""
        place, belief = self.start
        return sum((b * self._following(place, s, policy) for s, b in belief.items()), Fraction(0))

    def _following(self, place: Any, s: Any, policy: Mapping[tuple[Any, Any], str]) -> Fraction:
        total = Fraction(0)
        for z, chance in self.confusion[s].items():
            for p, following, reward, _ in self.rows[place, s, policy[place, z]] if chance else ():
                later = Fraction(0)
                if following is not None:
                    later = self._following(following[0], following[1], policy)
                total += chance * p * (reward + self.discount * later)
        return total

    def best_fixed(self, *, by_place: bool) -> Fraction:
        """The greatest value of a deterministic policy on what is perceived."""
        places = sorted({p for p, _, _ in self.rows})
        keys = list(product(places, self.seen)) if by_place else [(None, z) for z in self.seen]
        found = []
        for chosen in product(self.actions(places[0]), repeat=len(keys)):
            table = dict(zip(keys, chosen, strict=True))
            policy = {
                (p, z): table[(p, z) if by_place else (None, z)] for p in places for z in self.seen
            }
            found.append(self.value(policy))
        return max(found)
