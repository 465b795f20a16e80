"""An optimum by a solver in floating point, by exact arithmetic, or by both against each other.

Where both are asked for, |V_float(s) - V(s)| must be at most the bound that the solver states, in
every state, and the proof of the exact values must pass its checker: otherwise one of the two
programs is wrong, and neither is believed.

The optimum depends on the status alone where, for every status, one action is optimal in all states
of that status that have a choice and that some policy reaches from the start:  ⋂ over such states s
of {a : a optimal in s}  is not empty. Ties count: where two actions are equally good in one state,
either serves.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.graph import is_acyclic, reachable, ways_out
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import Report, Shown, Table, ratio
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Integers
from exact_mdp.solvers.average.solve import AverageSolution
from exact_mdp.solvers.dynamic.iterate import Solver
from exact_mdp.solvers.exact.certify import certify as certified
from exact_mdp.solvers.solution import (
    Bounded,
    Certified,
    Claim,
    Solution,
    SolverError,
    warn_of_precision,
)
from exact_mdp.solvers.solver import SOLVERS, Criterion, is_average, solve

if TYPE_CHECKING:
    from exact_mdp.solvers.exact.certificate import Certificate
    from exact_mdp.solvers.objectives.limits import ConstrainedSolution

Mask = NDArray[np.bool_]


LISTED = 1000  # states whose actions are listed
SHOWN_DIGITS = 1000  # longer exact values are left to --json


class Contradiction(RuntimeError):
    """A solver and a proof that do not agree, or a proof that does not hold."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """Optimal values, a policy and every optimal pair, with what vouches for them.

    Attributes
    ----------
    mdp : MDP
    method : str
    solution : Solution or None
        None where the solver could not bound its error.
    certificate : Certificate or None
        What is given comes from it where there is one, else from the solution.
    """

    mdp: MDP
    method: str
    solution: Solution | None
    certificate: Certificate | None

    @property
    def best(self) -> Solution | Certificate:
        """What vouches for the values."""
        found = self.solution if self.certificate is None else self.certificate
        assert found is not None
        return found

    @cached_property
    def value(self) -> Floats:
        """(S,) state values."""
        best = self.best
        return best.value if isinstance(best, Solution) else best.value_float

    @cached_property
    def state_error(self) -> Floats:
        """(S,) bounds on the errors of the values; rounding alone where they are certified."""
        best = self.best
        if not isinstance(best, Solution):
            return np.nan_to_num(np.spacing(np.abs(self.value)))
        return best.state_error

    @property
    def policy(self) -> Integers:
        """(S,) action numbers."""
        return np.asarray(self.best.policy)

    @cached_property
    def optimal(self) -> Mask:
        """(L,) the optimal pairs; up to the error bound where there is no certificate."""
        best = self.best
        if not isinstance(best, Solution):
            return best.optimal_pairs
        lost = best.value[self.mdp.pair_state] - self.mdp.backup(best.value)
        return np.asarray((-lost if self.mdp.sense == "min" else lost) <= 2 * best.error_bound)

    @property
    def start_value(self) -> float:
        """The value of the start distribution."""
        return float(self.best.start_value)

    @property
    def error_bound(self) -> float:
        """A bound on the error of the start value, and of the value of every state."""
        best = self.best
        if not isinstance(best, Solution):
            rounding = float(np.nan_to_num(np.spacing(abs(self.start_value))))
            return max(float(self.state_error.max()), rounding)
        return max(best.error_bound, best.start.error)

    @property
    def claim(self) -> Claim:
        """Bounded, or certified where there is a certificate."""
        return Claim.BOUNDED if self.certificate is None else Claim.CERTIFIED

    @property
    def average(self) -> bool:
        """Whether it is that of an average reward."""
        best: Any = self.best
        return isinstance(best, AverageSolution) or getattr(best, "kind", "") == "average"

    @property
    def bias(self) -> Any:
        """(S,) the bias, of an average reward."""
        best: Any = self.best
        return best.bias

    def stationary(self) -> bool | None:
        """Return whether the optimum depends on the status alone; None where bounds leave it open.

        Bounds rule actions out: where the others have none in common, no status policy is optimal.
        What is left is known to be optimal only where it is alone.
        """
        if not _serves_each_status(self.mdp, self.optimal):
            return False
        if self.certificate is not None:
            return True
        left = np.add.reduceat(self.optimal.astype(np.int64), self.mdp.pair_offsets[:-1])
        alone = self.optimal & (left == 1)[self.mdp.pair_state]
        return True if _serves_each_status(self.mdp, alone) else None

    def report(self) -> Report:
        """Return the optimum: its value with its claim, and the policy."""
        proof, solution, mdp = self.certificate, self.solution, self.mdp
        average = self.average
        start = Certified(value=proof.start_value) if proof else None
        exact = ratio(proof.start_value) if proof else ""
        long = f"a rational of {len(exact):,} digits; --json prints it"
        status = "status" in mdp.space.names and not average
        stationary = self.stationary() if status else None
        words = by_status_or_state(mdp, [mdp.actions[action] for action in self.policy])
        facts = {
            "claim": Shown(self.claim),
            "start_value": Shown(
                self.start_value, start or Bounded(value=self.start_value, error=self.error_bound)
            ),
            "error_bound": Shown(self.error_bound),
            "exact_start_value": Shown(
                proof.start_value if proof else None,
                exact if len(exact) <= SHOWN_DIGITS else long,
            ),
            "unique": proof.unique if proof and not average else None,
            "stationary": Shown(
                stationary, stationary and "an optimal policy reads the status alone"
            ),
            "regret_bound": Shown(solution.regret_bound if solution and not proof else 0.0),
            "method": self.method,
            "iterations": solution.iterations if solution else None,
            "seconds": Shown(solution.seconds, f"{solution.seconds:.2g}") if solution else None,
            "status": Shown(str(solution.status) if solution else None),
            "solver": Shown(solution.solver if solution else None),
            **words,
        }
        if average:
            few = mdp.n_states <= LISTED
            labels = state_names(mdp.space)
            for name, values in (("gain", self.best.value), ("bias", self.bias)):
                facts[name] = Shown(dict(zip(labels, values, strict=True)) if few else None)
        notes = []
        if np.isinf(self.start_value):
            notes.append(
                "the total reward is infinite, so policies cannot be compared: " + ways_out(mdp)
            )
        key, reads = ("policy", "status") if words["policy"] else ("policy_by_state", "state")
        where = " at subtask 0, trial 0" if words["policy"] else ""
        columns = {reads: "", "action": "value"}
        table = Table(title=f"optimal action{where}, by {reads}", columns=columns, first=LISTED)
        return Report(title="optimum", facts=facts, tables={key: table}, notes=notes)


def limited_report(found: ConstrainedSolution, written: Sequence[str | None]) -> Report:
    """Return what an optimum under limits is, or that no policy keeps them."""
    mdp, limits = found.of.mdp, found.limits
    drawn = [{mdp.actions[a]: c for a, c in enumerate(row) if c} for row in found.rule]
    said = ["they can be kept" if found.feasible else "no policy keeps them all (proven)"]
    said += [
        f"{low} and {high} contradict each other, whatever the model"
        for low in limits
        for high in limits
        if (low.name, low.sign, high.sign) == (high.name, 1, -1) and low.bound > high.bound
    ]
    facts = {
        "method": "limits",
        "claim": Shown(found.claim),
        "feasible": Shown(found.feasible, "; ".join(said)),
        "start_value": Shown(
            None if found.start_value is None else float(found.start_value), found.start
        ),
        "error_bound": Shown(0.0 if found.feasible else None),
        "exact_start_value": found.start_value,
        "limits": [str(limit) for limit in limits],
        "totals": Shown(found.totals),
        "prices": Shown(found.prices),
        "closest": Shown(found.closest),
        "randomises": Shown(
            [
                {"state": mdp.space.label(state), "actions": chances}
                for state, chances in found.randomises.items()
            ],
            [*map(mdp.space.label, found.randomises)],
        ),
        "policy": Shown(of_every_state(mdp, drawn)),
        "written": [path for path in written if path],
    }
    rows = [
        {"limit": str(limit), "total": float(found.totals[limit.name]), "price": float(price),
         "closest": float(found.closest[limit.name])}
        for limit, price in zip(limits, found.price, strict=True)
    ]  # fmt: skip
    kept = {"limit": "limit", "total": "total", "price": "price:.10g"}
    table = Table(
        title="limits" if found.feasible else "limits, and the closest ones that can be kept",
        rows=rows,
        columns=kept if found.feasible else {"limit": "limit", "closest": "closest:.10g"},
        note="price: what the optimum gains for one point by which the limit is moved"
        if found.feasible
        else "all are moved by the same step, the least that suffices",
    )
    return Report(
        title="optimum under limits",
        facts=facts,
        tables={"moved": table},
        passed=found.feasible,
    )


def state_names(space: StateSpace) -> list[str]:
    """Return a name for each state."""
    if len(space.columns) == 1:
        column = space.columns[0]
        return [*(column.label(value) for value in range(column.size)), *space.extra]
    return space.labels(range(space.size))


def by_status_or_state(mdp: MDP, said: Sequence[Any]) -> dict[str, Any]:
    """Return what is said of each state by status at subtask 0, trial 0, or by state if few."""
    if {"subtask", "trial", "status"} <= set(mdp.space.names):
        column = mdp.space.column("status")
        first = {column.label(value): mdp.space.index(status=value) for value in range(column.size)}
        return {"policy": {label: said[s] for label, s in first.items()}, "policy_by_state": None}
    if mdp.n_states > LISTED:
        return {"policy": None, "policy_by_state": None}
    return {"policy": None, "policy_by_state": dict(zip(state_names(mdp.space), said, strict=True))}


def of_every_state(mdp: MDP, said: Sequence[Any]) -> dict[str, Any]:
    """Return what is said of every state: by status where that alone decides, else by state.

    Both are policies that a file may hold.
    """
    if "status" in mdp.space.names:
        column = mdp.space.column("status")
        status = mdp.space.values("status")
        asked = np.flatnonzero(mdp.asked & (status >= 0)).tolist()
        found = {
            column.label(value): said[mdp.space.index(status=value)] for value in range(column.size)
        }
        found |= {column.label(int(status[state])): said[state] for state in asked}
        if all(found[column.label(int(status[state]))] == said[state] for state in asked):
            return found
    return dict(zip(state_names(mdp.space), said, strict=True))


def _serves_each_status(mdp: MDP, optimal: Mask) -> bool:
    """Return whether some action is optimal, by pairs (L,), in all states of each status."""
    values, size = mdp.space.values("status"), mdp.space.column("status").size
    asked = reachable(mdp) & ~mdp.forced & (values >= 0)
    states = np.bincount(values[asked], minlength=size)
    counted = optimal & asked[mdp.pair_state]
    keys = values[mdp.pair_state[counted]] * mdp.n_actions + mdp.pair_action[counted]
    serves = np.bincount(keys, minlength=size * mdp.n_actions).reshape(size, -1) == states[:, None]
    return bool(serves.any(axis=1).all())


def optimum(
    model: MDP,
    method: str = "auto",
    tol: float | None = None,
    *,
    certify: bool = False,
    criterion: Criterion = "total",
) -> Optimum:
    """Solve a model in floating point and, where asked for, exactly.

    Raises ModelError for a model that the method refuses, an unknown method, and a tolerance that
    is not positive; SolverError where the solver gives up, unless the exact answer was asked for;
    Contradiction. A tolerance that is not met is warned of.

    Examples
    --------
    >>> mdp = MDP.from_arrays([[["1/3", "2/3"], [0, 1]]], [[1], [0]])
    >>> found = optimum(mdp, "policy-iteration")
    >>> round(found.start_value, 9), found.claim.value, found.optimal.tolist()
    (1.5, 'bounded', [True, True])
    """
    solver = _solver(model, method, tol, average=is_average(criterion))
    solution = None
    try:
        solution = solve(model, solver, criterion=criterion)
        if tol is not None and solution.error_bound > tol:
            warn_of_precision(
                f"the error bound is {solution.error_bound:.2g}, above the tolerance {tol:g}"
            )
        if not certify:
            return Optimum(mdp=model, method=solution.method, solution=solution, certificate=None)
    except SolverError as error:
        if not certify:
            raise
        warn_of_precision(f"{error} (the exact values stand)")
    certificate = certified(model, criterion=criterion)
    if faults := certificate.violations():
        raise Contradiction(f"the certificate does not hold: {faults[0]}")
    found = Optimum(mdp=model, method=solver.name, solution=solution, certificate=certificate)
    if solution is not None:
        same = solution.value == found.value  # infinite ones
        apart = np.abs(np.where(same, 0.0, solution.value) - np.where(same, 0.0, found.value))
        if not (apart <= solution.state_error + found.state_error).all():
            raise Contradiction(
                f"exact values differ from those of {solution.solver} by up to {apart.max():.3g}, "
                f"which states an error of at most {solution.error_bound:.3g}"
            )
    return found


def _solver(mdp: MDP, method: str, tol: float | None, *, average: bool) -> Solver:
    """Return a named solver, with the tolerance where it has one to set."""
    if method == "auto" and average:
        method = "policy-iteration"
    elif method == "auto":
        method = "backward-induction" if is_acyclic(mdp) else "modified-policy-iteration"
    if method not in SOLVERS:
        known = [*SOLVERS, "auto"]
        raise ModelError(f"unknown method {method!r}", where="method", fix=suggest(method, known))
    if tol is not None and not 0 < tol < np.inf:
        raise ModelError(
            f"the tolerance is {tol}, and not above 0", where="tol", fix="choose a positive number"
        )
    kind = SOLVERS[method]
    return kind(**{"tol": tol} if tol is not None and hasattr(kind, "tol") else {})
