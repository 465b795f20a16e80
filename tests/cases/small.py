"""Small published models: Howard's taxicab, the MDP toolbox, and test domains of msdm."""

import tomllib
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any

from .case import Case, Number, Pair, actions, best, indexed, row, rows, table

F = Fraction
TOOLBOX = "sawcordwell/pymdptoolbox src/tests/"
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
)
