"""Small published models: Howard's taxicab, the MDP toolbox, test domains of msdm, and of Storm."""

from fractions import Fraction
from operator import mul

from .case import Case, Pair, actions, best, end, indexed, over_horizon, row, rows, table

F = Fraction
TOOLBOX = "sawcordwell/pymdptoolbox src/tests/"
MSDM = "markkho/msdm msdm/tests/domains/__init__.py, "
STORM_MODELS = "moves-rwth/storm resources/examples/testfiles/mdp/"
DISCOUNTING = (
    "moves-rwth/storm src/test/storm/modelchecker/prctl/mdp/"
    "DiscountingMdpPrctlModelCheckerTest.cpp, "
)


# ---- Howard --------------------------------------------------------------------------------------

# Town, alternative, sixteenths of the probability of a trip to A, B, C, reward of that trip.
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
TAXICAB = Case(
    name="howard-taxicab",
    source="Howard, Dynamic Programming and Markov Processes (MIT Press 1960), chapters 5 "
    "and 7: the problem, and its values at discount 0.9",
    pairs=tuple(
        (town, way, F(sum(map(mul, weights, rewards)), 16),
         row(*((t, F(w, 16)) for t, w in enumerate(weights))))
        for town, way, weights, rewards in TRIPS
    ),
    discount=F(9, 10),
    values=indexed([121.65, 135.31, 122.84]),
    tolerance=0.005,
    optimal=best([1], [1], [1]),
)  # fmt: skip


# ---- the MDP toolbox -----------------------------------------------------------------------------


def forest(
    discount: Fraction, values: str, test: str, wrong: tuple[int, ...], wrong_values: str = ""
) -> Case:
    """Wait (0) or cut (1); a fire takes one forest in ten back to the youngest state.

    The oldest forest earns 4 when it is left alone; cutting earns 0 in the youngest state, 2 in
    the oldest and 1 in between.
    """
    known = table(values)
    last, fire = len(known) - 1, F(1, 10)
    pairs: list[Pair] = []
    for s in known:
        older = row((0, fire), (min(s + 1, last), 1 - fire))
        pairs.append((s, 0, F(4 * (s == last)), older))
        pairs.append((s, 1, F((s > 0) + (s == last)), {0: F(1)}))
    return Case(
        name=f"forest-{len(known)}-{discount}",
        source=TOOLBOX + test,
        pairs=tuple(pairs),
        discount=discount,
        values=known,
        tolerance=1e-12,
        policy=actions([0] * len(known)),
        wrong_policy=actions(wrong),
        wrong_values=table(wrong_values),
    )


def small(discount: Fraction, values: str, test: str) -> Case:
    return Case(
        name=f"toolbox-small-{discount}",
        source=f"{TOOLBOX}test_PolicyIteration.py, {test}",
        pairs=rows("0 0 5: 0 1/2, 1 1/2; 0 1 10: 1; 1 0 -1: 0 4/5, 1 1/5; 1 1 2: 0 1/10, 1 9/10"),
        discount=discount,
        values=table(values),
        tolerance=1e-12,
        policy={0: 1, 1: 0},
    )


# ---- msdm ----------------------------------------------------------------------------------------


def tied_paths(discount: Fraction) -> Case:
    """Three ways to lose 2: at once; 1 and then 1; or 4 with probability 1/3 and else 1."""
    return Case(
        name=f"tied-paths-{discount}",
        source=MSDM + "TiedPaths",
        # the start, after a, after b once and twice, after c's two outcomes, the end
        pairs=rows(
            "0 0 -2: 1; 0 1 -1: 2; 0 2 -2: 4 1/3, 5 2/3; 1 0 0: 6; 2 0 -1: 3; 3 0 0: 6;"
            "4 0 0: 6; 5 0 0: 6; 6 0 0: 6"
        ),
        discount=discount,
        values=indexed([-(1 + discount), F(0), F(-1), F(0), F(0), F(0), F(0)]),
        optimal=best([0, 1, 2] if discount == 1 else [1]),
    )


def positive_cycle() -> Case:
    """Every round a, b, c costs 1 twice and earns 3."""
    gamma = F(19, 20)
    v = (3 - gamma - gamma**2) / (1 - gamma**3)
    return Case(
        name="positive-reward-cycle",
        source=MSDM + "PositiveRewardCycle",
        pairs=rows("0 0 -1: 1; 0 1 -10: 2; 1 0 -10: 0; 1 1 -1: 2; 2 0 3: 0; 2 1 -3: 1"),
        discount=gamma,
        values={0: -1 - gamma + gamma**2 * v, 1: -1 + gamma * v, 2: v},
        optimal=best([0], [1], [0]),
    )


def counter(goal: int, discount: Fraction) -> Case:
    """Count up (0) or down (1) at a cost of 1 until the goal."""
    pairs: list[Pair] = []
    for s in range(goal):
        pairs += [(s, 0, F(-1), {s + 1: F(1)}), (s, 1, F(-1), {max(0, s - 1): F(1)})]
    return Case(
        name=f"counter-{goal}-{discount}",
        source=MSDM + "DeterministicCounter",
        pairs=(*pairs, *end(goal, 2)),
        discount=discount,
        values={s: -sum((discount**k for k in range(goal - s)), F(0)) for s in range(goal + 1)},
        optimal=best(*[[0]] * goal),
        proper=discount < 1,
    )


def geometric(p: Fraction, discount: Fraction) -> Case:
    """Flip a coin (0) or wait (1), at a cost of 1, until it comes up."""
    return Case(
        name=f"geometric-{p}-{discount}",
        source=MSDM + "GeometricCounter",
        pairs=rows(f"0 0 -1: 0 {1 - p}, 1 {p}; 0 1 -1: 0; 1 0 0: 1; 1 1 0: 1"),
        discount=discount,
        values={0: -1 / (1 - (1 - p) * discount), 1: F(0)},
        optimal=best([0]),
        proper=discount < 1,
    )


def varying_actions() -> Case:
    """Three states in a line; the first and the last have one action each."""
    return Case(
        name="varying-action-number",
        source=MSDM + "VaryingActionNumber",
        pairs=rows("0 1 -1: 1; 1 0 -1: 0; 1 1 -1: 2; 2 0 0: 2"),
        discount=F(1),
        values=indexed([F(-2), F(-1), F(0)]),
        optimal=best([1], [1], [0]),
        proper=False,
    )


# ---- Storm ---------------------------------------------------------------------------------------


def small_discount(discount: Fraction, value: Fraction, *optimal: int) -> Case:
    """A reward of 4 once, or of 1 in every step until the end, which comes one time in five."""
    return Case(
        name=f"small-discount-{discount}",
        source=f"{STORM_MODELS}small_discount.nm; {DISCOUNTING}SmallDiscount",
        pairs=rows("0 0 0: 1; 0 1 0: 2; 1 0 4: 3; 2 0 1: 2 4/5, 3 1/5; 3 0 0: 3"),
        discount=discount,
        values={0: value},
        optimal=best(optimal),
    )


def one_state(horizon: int, value: Fraction) -> Case:
    """Earn 1 or 100 in every step, for ever or (horizon > 0) for a number of steps."""
    pairs = rows("0 0 1: 0; 0 1 100: 0")
    return Case(
        name=f"one-state-{horizon or 'for-ever'}",
        source=f"{STORM_MODELS}one_state.nm; {DISCOUNTING}OneStateDiscounting",
        pairs=over_horizon(pairs, horizon) if horizon else pairs,
        discount=F(9, 10),
        values={0: value},
        optimal=best(*[[1]] * max(1, horizon)),
    )


CASES = (
    TAXICAB,
    forest(  # the wrong policy is the one that policy iteration starts from
        F(9, 10),
        "26.244 29.484 33.484",
        "test_PolicyIteration.py, test_PolicyIteration_matrix_forest and evalPolicyMatrix_forest",
        wrong=(0, 1, 0),
        wrong_values="4.47513812154696 5.02762430939227 23.17243384704857",
    ),
    # The wrong policies are asserted by the tests of Q-learning. One puts its own value in state 0
    # at 11.199; the policy is really worth 10800/932 = 11.588 there.
    forest(
        F(24, 25),
        "74.6496 78.1056 82.1056",
        "test_PolicyIteration.py, test_PolicyIterative_forest; test_QLearning.py, "
        "test_QLearning_forest",
        wrong=(0, 1, 1),
    ),
    forest(
        F(24, 25),
        "26.8301859311444 28.0723241686974 29.5099841658652 31.1739424959205 33.0998201927438 "
        "35.3288453048078 37.9087354808078 40.8947194808078 44.3507194808078 48.3507194808078",
        "test_PolicyIteration.py, test_PolicyIterative_forest_sparse; test_QLearning.py, "
        "test_QLearning_forest_sparse",
        wrong=(0, 1, 1, 1, 1, 1, 0, 0, 0, 0),
    ),
    small(F(9, 10), "42.4418604651163 36.0465116279070", "test_PolicyIteration_small"),
    small(F(24, 25), "100.67873303167413 94.45701357466055", "its last test"),
    tied_paths(F(1)),
    tied_paths(F(19, 20)),
    tied_paths(1 - F(1, 10**9)),
    positive_cycle(),
    counter(6, F(19, 20)),
    counter(6, F(1)),
    geometric(F(1, 2), F(9, 10)),
    geometric(F(1, 13), F(99, 100)),
    geometric(F(1, 2), F(1)),
    varying_actions(),
    small_discount(F(1), F(5), 1),
    small_discount(F(9, 10), F(18, 5), 0),
    small_discount(F(15, 16), F(15, 4), 0, 1),
    one_state(0, F(1000)),
    one_state(5, F(40951, 100)),
    one_state(10, F(6513215599, 10_000_000)),
)
