"""The examples of the MDP toolbox: managing a forest, and two states with two actions."""

from fractions import Fraction

from .case import Case, actions, from_matrices, table

F = Fraction
TESTS = "sawcordwell/pymdptoolbox src/tests/"


def forest(
    discount: Fraction,
    values: str,
    test: str,
    wrong: tuple[int, ...],
    wrong_values: str = "",
    note: str = "",
) -> Case:
    """Wait (0) or cut (1); a fire takes one forest in ten back to the youngest state.

    The oldest forest earns 4 when it is left alone; cutting earns 0 in the youngest state, 2 in
    the oldest and 1 in between.
    """
    known = table(values)
    n = len(known)
    fire = F(1, 10)
    wait = [
        [fire if t == 0 else 1 - fire if t == min(s + 1, n - 1) else F(0) for t in range(n)]
        for s in range(n)
    ]
    cut = [[F(t == 0) for t in range(n)]] * n
    rewards = [[4 if s == n - 1 else 0, 0 if s == 0 else 2 if s == n - 1 else 1] for s in range(n)]
    return Case(
        name=f"forest-{n}-{discount}",
        source=TESTS + test,
        n_states=n,
        pairs=from_matrices([wait, cut], rewards),
        discount=discount,
        values=known,
        tolerance=1e-12,
        policy=actions([0] * n),
        wrong_policy=actions(wrong),
        wrong_values=table(wrong_values),
        note=note,
    )


def small(discount: Fraction, values: str, test: str) -> Case:
    stay = [[F(1, 2), F(1, 2)], [F(4, 5), F(1, 5)]]
    move = [[F(0), F(1)], [F(1, 10), F(9, 10)]]
    return Case(
        name=f"toolbox-small-{discount}",
        source=TESTS + test,
        n_states=2,
        pairs=from_matrices([stay, move], [[5, 10], [-1, 2]]),
        discount=discount,
        values=table(values),
        tolerance=1e-12,
        policy={0: 1, 1: 0},
    )


CASES = (
    forest(
        F(9, 10),
        "26.244 29.484 33.484",
        "test_PolicyIteration.py, test_PolicyIteration_matrix_forest and evalPolicyMatrix_forest",
        wrong=(0, 1, 0),
        wrong_values="4.47513812154696 5.02762430939227 23.17243384704857",
        note="the wrong policy is the one that policy iteration starts from",
    ),
    forest(
        F(24, 25),
        "74.6496 78.1056 82.1056",
        "test_PolicyIteration.py, test_PolicyIterative_forest; test_QLearning.py, "
        "test_QLearning_forest",
        wrong=(0, 1, 1),
        note="the wrong policy is asserted by the test of Q-learning, which puts its own value in "
        "state 0 at 11.199; the policy is really worth 10800/932 = 11.588 there",
    ),
    forest(
        F(24, 25),
        "26.8301859311444 28.0723241686974 29.5099841658652 31.1739424959205 33.0998201927438 "
        "35.3288453048078 37.9087354808078 40.8947194808078 44.3507194808078 48.3507194808078",
        "test_PolicyIteration.py, test_PolicyIterative_forest_sparse; test_QLearning.py, "
        "test_QLearning_forest_sparse",
        wrong=(0, 1, 1, 1, 1, 1, 0, 0, 0, 0),
        note="the wrong policy is asserted by the test of Q-learning",
    ),
    small(
        F(9, 10),
        "42.4418604651163 36.0465116279070",
        "test_PolicyIteration.py, test_PolicyIteration_small",
    ),
    small(
        F(24, 25), "100.67873303167413 94.45701357466055", "test_PolicyIteration.py, its last test"
    ),
)
