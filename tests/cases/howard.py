"""Howard's taxicab: three towns, and in each a choice of how to wait for the next passenger."""

from fractions import Fraction

from .case import Case, Pair, indexed

F = Fraction

# town, alternative, sixteenths of the probability of a trip to A, B, C, reward of that trip.
# The alternatives are cruising, a cab stand, a radio call; town B has no radio call.
TRIPS = (
    (0, 0, (8, 4, 4), (10, 4, 8)),
    (0, 1, (1, 12, 3), (8, 2, 4)),
    (0, 2, (4, 2, 10), (4, 6, 4)),
    (1, 0, (8, 0, 8), (14, 0, 18)),
    (1, 1, (1, 14, 1), (8, 16, 8)),
    (2, 0, (4, 4, 8), (10, 2, 8)),
    (2, 1, (2, 12, 2), (6, 4, 2)),
    (2, 2, (12, 1, 3), (4, 0, 8)),
)


def _pairs() -> tuple[Pair, ...]:
    return tuple(
        (
            town,
            alternative,
            F(sum(w * r for w, r in zip(weights, rewards, strict=True)), 16),
            {t: F(w, 16) for t, w in enumerate(weights) if w},
        )
        for town, alternative, weights, rewards in TRIPS
    )


CASES = (
    Case(
        name="howard-taxicab",
        source="Howard, Dynamic Programming and Markov Processes (MIT Press 1960), chapters 5 "
        "and 7: the problem, and its values at discount 0.9",
        n_states=3,
        pairs=_pairs(),
        discount=F(9, 10),
        values=indexed([121.65, 135.31, 122.84]),
        tolerance=0.005,
        optimal={0: frozenset({1}), 1: frozenset({1}), 2: frozenset({1})},
    ),
)
