"""The COACH handwashing assistant, fully observed: 180 states, 6 actions, discount 0.9.

A state is a plan step, the behaviour just seen, and whether the user responds to prompts and is
aware of the task (both never change); its number counts them in this order, the last fastest.
The behaviour is drawn first, from weights that are made to add up to 1; the plan step follows
from it. The source has the tables; the four values were computed from them, rows normalised.
"""

from fractions import Fraction
from itertools import product

from .case import Case, Pair, row

F = Fraction
BEHAVIOURS = ("nothing", "wet", "taps", "soap", "dry")
# Plan step: the step that each behaviour leads to, the behaviours that are right there, reward.
STEPS = {
    "a": ("aabea", {"taps", "soap"}, F(0)),
    "b": ("bcbdb", {"wet", "soap"}, F(1, 5)),
    "c": ("cccdb", {"soap"}, F(1, 5)),
    "d": ("dgddb", {"wet"}, F(1, 5)),
    "e": ("eedeb", {"taps"}, F(1, 5)),
    "g": ("gghdj", {"taps", "dry"}, F(1, 5)),
    "h": ("hhgek", {"dry"}, F(1, 5)),
    "j": ("jgkdj", {"taps"}, F(1)),
    "k": ("kkjek", {"nothing"}, F(20)),
}
PROMPTS = (None, "wet", "taps", "taps", "soap", "dry")  # do nothing, and five prompts
UNAWARE = (F(1, 2), F(1, 10), F(1, 10), F(1, 10), F(1, 10))


def state(step: str, behaviour: str, responsive: int, aware: int) -> int:
    return 20 * "abcdeghjk".index(step) + 4 * BEHAVIOURS.index(behaviour) + 2 * responsive + aware


def _behaviours(step: str, prompted: str | None, responsive: int, aware: int) -> list[Fraction]:
    """The probabilities of the next behaviour."""
    right = STEPS[step][1]
    weights = [2 + F(b in right) for b in BEHAVIOURS] if aware else list(UNAWARE)
    if prompted and responsive:
        weights[BEHAVIOURS.index(prompted)] += 2
    return [weight / sum(weights) for weight in weights]


def _pairs() -> tuple[Pair, ...]:
    pairs: list[Pair] = []
    for step, behaviour, responsive, aware in product(STEPS, BEHAVIOURS, (0, 1), (0, 1)):
        next_steps, _, reward = STEPS[step]
        for action, prompted in enumerate(PROMPTS):
            chances = _behaviours(step, prompted, responsive, aware)
            cost = (F(4, 5) if aware else F(1, 5)) if prompted else F(0)
            there = (
                state(t, b, responsive, aware) for t, b in zip(next_steps, BEHAVIOURS, strict=True)
            )
            here = state(step, behaviour, responsive, aware)
            pairs.append((here, action, reward - cost, row(*zip(there, chances, strict=True))))
    return tuple(pairs)


CASES = (
    Case(
        name="handwashing",
        source="pjdrm/Symbolic-Perseus---Student-Modeling-AAMAS-15- "
        "problems/handwashing/cppo3.txt; Boger et al., IJCAI 2005, 1293-1299",
        pairs=_pairs(),
        discount=F(9, 10),
        values={
            state("a", "nothing", 0, 0): 3.13,
            state("a", "nothing", 0, 1): 10.32,
            state("a", "nothing", 1, 0): 81.23,
            state("a", "nothing", 1, 1): 14.48,
        },
        tolerance=0.005,
    ),
)
