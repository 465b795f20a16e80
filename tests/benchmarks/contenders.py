"""Solvers side by side: each is given the same arrays and returns values and what it waited for.

What is timed is what a user waits for: handing over the arrays, finding structure, solving, and
bounding where there are bounds; and, of that, all but the handing over. What only this comparison
needs is not timed: Python lists for mdpsolver, and Storm's matrix, which is filled entry by entry
from Python. So Storm's time is that of solving alone, to be compared with ours for the same.
"""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import csr_array
from workloads import FULL, Workload

TOLERANCE = 1e-6
SECONDS = 100  # of one solver on one model, its preparation included
FAR = 10  # a solver that took this many times as long as ours in the first round has no other round
ALONE = "solving alone"
MOST_FOR_FACTORS = 5_000  # states from which on quantecon's policy iteration takes minutes


@dataclass(frozen=True, kw_only=True)
class Answer:
    """Values (S,); seconds in all and for solving; `bound` is a proven error where there is one."""

    value: NDArray[np.float64]
    seconds: float
    solving: float
    bound: float | None
    note: str


Solved = tuple[Callable[[], Any], float | None, str]  # what reads the values, their bound, a note
Steps = tuple[Callable[[csr_array], Any], Callable[[Any], Solved]]
Contender = Callable[[Workload], Steps]
"""Prepares a workload, untimed, and returns what takes over its rows, and what solves that."""


def timed(
    work: Workload, build: Callable[[csr_array], Any], solve: Callable[..., Solved]
) -> Answer:
    rows = work.fresh()
    started = perf_counter()
    model = build(rows)
    built = perf_counter()
    read, bound, note = solve(model)
    ended = perf_counter()
    return Answer(
        value=np.asarray(read()),
        seconds=ended - started,
        solving=ended - built,
        bound=bound,
        note=note,
    )


def _ours(*, program: bool = False, threads: int | None = None) -> Contender:
    """Give our solver: the one that `solve` takes, or a linear program; on fewer cores if asked."""

    def prepare(work: Workload) -> Steps:
        from exact_mdp import LinearProgram, solve

        if threads is not None:
            os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:threads])
        # Without cycles one pass is as exact as floats allow, and has no tolerance to keep.
        tol = None if program or work.name.startswith("layered") else TOLERANCE

        def run(mdp: Any) -> Solved:
            solution = solve(mdp, LinearProgram() if program else "auto", tol=tol)
            note = "" if program else solution.method
            return lambda: solution.value, solution.error_bound, note

        return work.model, run

    return prepare


def _quantecon(method: str, **options: Any) -> Contender:
    def prepare(work: Workload) -> Steps:
        from quantecon.markov import DiscreteDP
        from scipy.sparse import csr_matrix

        if method == "policy_iteration" and work.states > MOST_FOR_FACTORS:
            raise ValueError("the factors of its matrices would fill the memory")
        # Its policy iteration may go round among ties for ever.
        limit = 200 if method == "policy_iteration" else 10**6

        def build(rows: csr_array) -> Any:
            where = {"s_indices": work.state, "a_indices": work.action}
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                return DiscreteDP(work.reward, csr_matrix(rows), work.discount, **where)

        def run(model: Any) -> Solved:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                solution = model.solve(method=method, epsilon=TOLERANCE, max_iter=limit, **options)
            return lambda: solution.v, None, ""

        return build, run

    return prepare


def _mdpsolver(work: Workload) -> Steps:
    import mdpsolver

    matrix, cuts = work.transition, np.append(work.first, len(work.reward))
    rows = [
        (
            matrix.data[matrix.indptr[l] : matrix.indptr[l + 1]].tolist(),
            matrix.indices[matrix.indptr[l] : matrix.indptr[l + 1]].tolist(),
        )
        for l in range(len(work.reward))
    ]
    spans = [range(a, b) for a, b in zip(cuts[:-1].tolist(), cuts[1:].tolist(), strict=True)]
    rewards = [[float(work.reward[l]) for l in span] for span in spans]
    chances = [[rows[l][0] for l in span] for span in spans]
    columns = [[rows[l][1] for l in span] for span in spans]

    def build(_: csr_array) -> Any:
        model = mdpsolver.model()
        model.mdp(
            discount=work.discount, rewards=rewards, tranMatProbs=chances, tranMatColumns=columns
        )
        return model

    def run(model: Any) -> Solved:
        model.solve(tolerance=TOLERANCE)
        return model.getValueVector, None, ""

    return build, run


def _storm(work: Workload) -> Steps:
    """Discounting becomes a step to an end of its own, with probability 1 - γ."""
    import stormpy

    matrix, cuts, states = work.transition, np.append(work.first, len(work.reward)), work.states
    builder = stormpy.datastructures.SparseMatrixBuilder(
        rows=0, columns=states + 1, entries=0, force_dimensions=False,
        has_custom_row_grouping=True, row_groups=0,
    )  # fmt: skip
    left = 1 - work.discount
    data, columns = (matrix.data * work.discount).tolist(), matrix.indices.tolist()
    ends = matrix.indptr.tolist()
    for state in range(states):
        builder.new_row_group(int(cuts[state]))
        for pair in range(int(cuts[state]), int(cuts[state + 1])):
            for place in range(ends[pair], ends[pair + 1]):
                builder.add_next_value(pair, columns[place], data[place])
            if left:
                builder.add_next_value(pair, states, left)
    builder.new_row_group(len(work.reward))
    builder.add_next_value(len(work.reward), states, 1.0)
    labels = stormpy.models.StateLabeling(states + 1)
    labels.add_label("init")
    labels.add_label_to_state("init", 0)
    labels.add_label("end")
    labels.add_label_to_state("end", states)
    if not left:  # the last state of the care model is its end
        labels.add_label_to_state("end", states - 1)
    rewards = stormpy.models.SparseRewardModel(
        optional_state_action_reward_vector=[*work.reward.tolist(), 0.0]
    )
    model = stormpy.models.SparseMdp(
        stormpy.models.SparseModelComponents(
            transition_matrix=builder.build(), state_labeling=labels, reward_models={"r": rewards}
        )
    )
    (formula,) = stormpy.parse_properties('R{"r"}max=? [F "end"]')
    environment = stormpy.Environment()
    solver = environment.solver().min_max()
    solver.method = stormpy.environments.MinMaxMethod.TOPOLOGICAL
    solver.precision = stormpy.Rational(TOLERANCE)

    def run(_: Any) -> Solved:
        checked = stormpy.model_checking(model, formula, environment=environment)
        return lambda: checked.get_value_vector()[:states], None, ALONE

    return lambda _: None, run


def _highs(method: str) -> Contender:
    def prepare(work: Workload) -> Steps:
        from scipy.optimize import linprog

        def run(rows: csr_array) -> Solved:
            pairs = len(work.reward)
            one = csr_array((np.ones(pairs), (np.arange(pairs), work.state)))
            program = linprog(
                np.full(work.states, 1 / work.states),
                A_ub=work.discount * rows - one,
                b_ub=-work.reward,
                bounds=(None, None),
                method=method,
            )
            return lambda: program.x, None, ""

        return lambda rows: rows, run

    return prepare


OURS = "exact-mdp"
GENERAL: dict[str, Contender] = {
    OURS: _ours(),
    OURS + ", one thread": _ours(threads=1),
    "quantecon MPI, k=6": _quantecon("mpi", k=6),
    "quantecon MPI, k=20": _quantecon("mpi", k=20),
    "quantecon MPI, k=100": _quantecon("mpi", k=100),
    "quantecon PI": _quantecon("policy_iteration"),
    "mdpsolver MPI": _mdpsolver,
}
CONTENDERS: dict[str, dict[str, Contender]] = dict.fromkeys(FULL, GENERAL) | {
    "layered γ=1": {OURS: _ours(), "Storm, topological": _storm},
    "linear program": {
        OURS + " LP": _ours(program=True),
        "HiGHS, interior point": _highs("highs-ipm"),
        "HiGHS, dual simplex": _highs("highs-ds"),
    },
}
