"""Small published models: Howard's taxicab, the MDP toolbox, test domains of msdm, and of Storm."""

import tomllib
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from .case import Case, Number, Pair, actions, best, end, indexed, over_horizon, row, rows, table

F = Fraction
TOOLBOX = "sawcordwell/pymdptoolbox src/tests/"
MSDM = "markkho/msdm msdm/tests/domains/__init__.py, "
SPECS = tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8"))


def listed(name: str, spec: Mapping[str, Any]) -> Case:
    """A case of small.toml; numbers with a tolerance are floats."""
    number: Callable[[str], Number] = float if "tolerance" in spec else Fraction
    return Case(
        name=name.replace("_", "/"),
        source=spec["source"],
        pairs=rows(spec["rows"]),
        discount=F(spec["discount"]),
        values=indexed(map(number, spec["values"].split())),
        tolerance=spec.get("tolerance", 0.0),
        policy=actions(map(int, spec.get("policy", "").split())),
        optimal=best(*(map(int, digits) for digits in spec.get("optimal", "").split())),
        proper=spec.get("proper", True),
    )


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


# ---- msdm ----------------------------------------------------------------------------------------


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


# ---- Storm ---------------------------------------------------------------------------------------


def one_state(horizon: int, value: Fraction) -> Case:
    """Earn 1 or 100 in every step, for ever or (horizon > 0) for a number of steps."""
    pairs = rows("0 0 1: 0; 0 1 100: 0")
    return Case(
        name=f"one-state-{horizon or 'for-ever'}",
        source="moves-rwth/storm resources/examples/testfiles/mdp/one_state.nm; "
        "DiscountingMdpPrctlModelCheckerTest.cpp, OneStateDiscounting",
        pairs=over_horizon(pairs, horizon) if horizon else pairs,
        discount=F(9, 10),
        values={0: value},
        optimal=best(*[[1]] * max(1, horizon)),
    )


CASES = (
    *(listed(name, spec) for name, spec in SPECS.items()),
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
    positive_cycle(),
    counter(6, F(19, 20)),
    counter(6, F(1)),
    one_state(0, F(1000)),
    one_state(5, F(40951, 100)),
    one_state(10, F(6513215599, 10_000_000)),
)
