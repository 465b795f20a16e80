"""Small test domains of msdm: ties, cycles, counters, and actions that differ by state."""

from fractions import Fraction

from .case import Case, Pair, end

F = Fraction
SOURCE = "markkho/msdm msdm/tests/domains/__init__.py, "
ONE = F(1)


def tied_paths(discount: Fraction) -> Case:
    """Three ways to lose 2: at once; 1 and then 1; or 4 with probability 1/3 and else 1."""
    tie = discount == 1
    return Case(
        name=f"tied-paths-{discount}",
        source=SOURCE + "TiedPaths",
        n_states=7,  # the start, after a, after b once and twice, after c's two outcomes, the end
        pairs=(
            (0, 0, F(-2), {1: ONE}),
            (0, 1, F(-1), {2: ONE}),
            (0, 2, F(-2), {4: F(1, 3), 5: F(2, 3)}),
            (1, 0, F(0), {6: ONE}),
            (2, 0, F(-1), {3: ONE}),
            *((s, 0, F(0), {6: ONE}) for s in (3, 4, 5)),
            *end(6),
        ),
        discount=discount,
        values={0: -(1 + discount), 1: F(0), 2: F(-1), 3: F(0), 4: F(0), 5: F(0), 6: F(0)},
        optimal={0: frozenset({0, 1, 2}) if tie else frozenset({1})},
    )


def positive_cycle() -> Case:
    """Every round a, b, c costs 1 twice and earns 3."""
    gamma = F(19, 20)
    v = (3 - gamma - gamma**2) / (1 - gamma**3)
    return Case(
        name="positive-reward-cycle",
        source=SOURCE + "PositiveRewardCycle",
        n_states=3,
        pairs=(
            (0, 0, F(-1), {1: ONE}),
            (0, 1, F(-10), {2: ONE}),
            (1, 0, F(-10), {0: ONE}),
            (1, 1, F(-1), {2: ONE}),
            (2, 0, F(3), {0: ONE}),
            (2, 1, F(-3), {1: ONE}),
        ),
        discount=gamma,
        values={0: -1 - gamma + gamma**2 * v, 1: -1 + gamma * v, 2: v},
        optimal={0: frozenset({0}), 1: frozenset({1}), 2: frozenset({0})},
    )


def counter(goal: int, discount: Fraction) -> Case:
    """Count up (0) or down (1) at a cost of 1 until the goal."""
    pairs: list[Pair] = []
    for s in range(goal):
        pairs += [(s, 0, F(-1), {s + 1: ONE}), (s, 1, F(-1), {max(0, s - 1): ONE})]
    return Case(
        name=f"counter-{goal}-{discount}",
        source=SOURCE + "DeterministicCounter",
        n_states=goal + 1,
        pairs=(*pairs, *end(goal, 2)),
        discount=discount,
        values={s: -sum((discount**k for k in range(goal - s)), F(0)) for s in range(goal + 1)},
        optimal={s: frozenset({0}) for s in range(goal)},
        proper=discount < 1,
    )


def geometric(p: Fraction, discount: Fraction) -> Case:
    """Flip a coin (0) or wait (1), at a cost of 1, until it comes up."""
    return Case(
        name=f"geometric-{p}-{discount}",
        source=SOURCE + "GeometricCounter",
        n_states=2,
        pairs=((0, 0, F(-1), {0: 1 - p, 1: p}), (0, 1, F(-1), {0: ONE}), *end(1, 2)),
        discount=discount,
        values={0: -1 / (1 - (1 - p) * discount), 1: F(0)},
        optimal={0: frozenset({0})},
        proper=discount < 1,
    )


def varying_actions() -> Case:
    """Three states in a line; the first and the last have one action each."""
    return Case(
        name="varying-action-number",
        source=SOURCE + "VaryingActionNumber",
        n_states=3,
        pairs=(
            (0, 1, F(-1), {1: ONE}),
            (1, 0, F(-1), {0: ONE}),
            (1, 1, F(-1), {2: ONE}),
            (2, 0, F(0), {2: ONE}),
        ),
        discount=ONE,
        values={0: F(-2), 1: F(-1), 2: F(0)},
        optimal={0: frozenset({1}), 1: frozenset({1}), 2: frozenset({0})},
        proper=False,
    )


CASES = (
    tied_paths(ONE),
    tied_paths(F(19, 20)),
    tied_paths(ONE - F(1, 10**9)),
    positive_cycle(),
    counter(6, F(19, 20)),
    counter(6, ONE),
    geometric(F(1, 2), F(9, 10)),
    geometric(F(1, 13), F(99, 100)),
    geometric(F(1, 2), ONE),
    varying_actions(),
)
