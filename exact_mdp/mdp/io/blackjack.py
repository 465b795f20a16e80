"""Gymnasium's Blackjack, which has no table `P`: the model of its rules, in exact probabilities.

Cards are drawn with replacement: 1 to 9 with probability 1/13 each, 10 with 4/13. A state is an
observation, (player's sum, dealer's card, usable ace). If `sab` or `natural` is set, the reward of
21 depends on whether it is the first two cards, which is not observed: such a state is a `Natural`,
beside the state of the same tuple with more cards, and a policy of observations decides
in both. The dealer's hidden card does not depend on the player, so it is drawn last.

Source: Sutton and Barto, Reinforcement Learning (2018), example 5.1; `gymnasium.envs.toy_text`.
"""

from __future__ import annotations

from collections import defaultdict
from fractions import Fraction
from typing import Any

CARDS = {card: Fraction(1 + 3 * (card == 10), 13) for card in range(1, 11)}
ACTIONS = ("STICK", "HIT")
END = "end"
Hand = tuple[int, bool]  # its sum, and whether it counts an ace as 11


class Natural(tuple[int, int, int]):
    """A state whose hand of 21 are the first two cards; `seen` is the observation."""

    __slots__ = ()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Natural) and self.seen == other.seen

    def __ne__(self, other: object) -> bool:
        return not self == other

    def __hash__(self) -> int:
        return hash((ACTIONS, self.seen))

    def __str__(self) -> str:
        return f"natural {self.seen}"

    __repr__ = __str__

    @property
    def seen(self) -> tuple[int, ...]:
        """What an agent observes in this state."""
        return tuple(self)


def _add_card(hand: Hand, card: int) -> Hand:
    """Return a hand with one more card."""
    total, usable = hand
    hard = total - 10 * usable + card
    usable = (usable or card == 1) and hard + 10 <= 21
    return hard + 10 * usable, usable


def _play_dealer(shown: int) -> dict[tuple[int, bool], Fraction]:
    """Return the probabilities of the dealer's score, 0 if bust, and of a natural."""
    final: dict[tuple[int, bool], Fraction] = defaultdict(Fraction)
    todo = [(_add_card((0, False), shown), 1, Fraction(1))]
    while todo:
        hand, count, chance = todo.pop()
        for card, likely in CARDS.items():
            total, usable = _add_card(hand, card)
            if total < 17:
                todo.append(((total, usable), count + 1, chance * likely))
                continue
            score = total if total <= 21 else 0
            final[score, count == 1 and total == 21] += chance * likely
    return final


class Blackjack:
    """The rules of one environment."""

    def __init__(self, *, natural: bool, sab: bool) -> None:
        self.natural, self.sab = natural, sab
        self.dealer = {shown: _play_dealer(shown) for shown in CARDS}

    @property
    def start(self) -> dict[Any, Fraction]:
        """Return the distribution of the first state."""
        start: dict[Any, Fraction] = defaultdict(Fraction)
        for first, one in CARDS.items():
            for second, two in CARDS.items():
                total, usable = _add_card(_add_card((0, False), first), second)
                for shown, three in CARDS.items():
                    state: Any = (total, shown, int(usable))
                    if total == 21 and (self.natural or self.sab):
                        state = Natural(state)
                    start[state] += one * two * three
        return start

    def list_actions(self, state: Any) -> tuple[str, ...]:
        """Return the actions of a state."""
        if state == END:
            return ()
        return ACTIONS

    def list_outcomes(self, state: Any, action: str) -> list[tuple[Fraction, Any, Any]]:
        """Return (probability, next state, reward) of all outcomes."""
        total, shown, usable = state
        outcomes: list[tuple[Fraction, Any, Any]] = []
        if action == "HIT":
            for card, chance in CARDS.items():
                then, still = _add_card((total, bool(usable)), card)
                if then > 21:
                    outcomes.append((chance, END, -1))
                else:
                    outcomes.append((chance, (then, shown, int(still)), 0))
            return outcomes
        for (score, dealt), chance in self.dealer[shown].items():
            reward: Any = (total > score) - (total < score)
            if isinstance(state, Natural) and self.sab and not dealt:
                reward = 1
            elif isinstance(state, Natural) and not self.sab and reward == 1:
                reward = Fraction(3, 2)
            outcomes.append((chance, END, reward))
        return outcomes
