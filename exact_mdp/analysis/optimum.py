"""An optimum by a solver in floating point, by exact arithmetic, or by both, which must agree.

With both, |V_float(s) - V(s)| must be at most the solver's error bound in every state, and the
proof must pass its checker: otherwise one of the two programs is wrong, and neither is trusted. The
optimum depends on the status alone if for every status one action is optimal in all states with
that status that have a choice and are reached by some policy.
"""

from __future__ import annotations

import io
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from exact_mdp.mdp.advice import other_question, ways_out
from exact_mdp.mdp.errors import require_known_name, warn_user
from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.choices import state_names
from exact_mdp.mdp.report import MOST_LISTED, Report, Shown, Table, format_ratio
from exact_mdp.mdp.table import Floats
from exact_mdp.mdp.validate import Flags
from exact_mdp.solvers.arguments import Criterion, is_average
from exact_mdp.solvers.claims import Bounded, Certified, PrecisionWarning, SolverError
from exact_mdp.solvers.dynamic.base import check_tolerance
from exact_mdp.solvers.exact.certificate import Certificate, Contradiction
from exact_mdp.solvers.exact.certify import certify_and_check
from exact_mdp.solvers.solution import Solution
from exact_mdp.solvers.solver import SOLVERS, solve


@dataclass(frozen=True, kw_only=True, eq=False)
class Optimum:
    """Optimal values, a policy and every optimal pair, with the solution or the certificate."""

    mdp: MDP
    average: bool  # whether the criterion is the average reward
    solution: Solution | None  # None if the solver could not bound its error
    certificate: Certificate | None
    value: Floats  # (S,), from the certificate if there is one
    state_error: Floats  # (S,) error bounds; rounding alone if the values are certified
    start: Certified | Bounded  # the value of the start distribution
    error_bound: float  # bounds the errors of the start value and of all values, as floats

    @property
    def best(self) -> Any:
        """The certificate, or the solution if there is none."""
        return self.certificate or self.solution

    @cached_property
    def optimal(self) -> Flags:
        """(L,) the optimal pairs; without a certificate, up to the error bound."""
        if self.certificate is not None:
            return self.certificate.optimal_pairs
        here, there = self.value[self.mdp.pair_state], self.mdp.backup(self.value)
        return np.asarray(self.mdp.sense.losses(here, there) <= 2 * self.best.error_bound)

    def is_stationary(self) -> bool | None:
        """Return whether the optimum depends on the status alone; None if bounds leave it open.

        Bounds rule actions out: if the remaining ones have none in common, no policy of the status
        is optimal. A remaining action is known to be optimal only if it is the only one.
        """
        if not _serves_each_status(self.mdp, self.optimal):
            return False
        left = np.add.reduceat(self.optimal.astype(np.int64), self.mdp.pair_offsets[:-1])
        alone = self.optimal & (left == 1)[self.mdp.pair_state]
        if self.certificate is not None or _serves_each_status(self.mdp, alone):
            return True
        return None

    def report(self) -> Report:
        """Return the optimum: its value with its claim, and the policy."""
        proof, solution, mdp = self.certificate, self.solution, self.mdp
        exact = ""
        if proof:
            exact = format_ratio(proof.start_value)
        long = f"a rational of {len(exact):,} digits; --json prints it"
        status = "status" in mdp.space.names and not self.average
        if status:
            stationary = self.is_stationary()
        else:
            stationary = None
        policy = [mdp.actions[action] for action in np.asarray(self.best.policy)]
        # The policy: by status at the first subtask and trial, or by state if there are not too
        # many.
        key, reads, where, chosen = "policy_by_state", "state", "", None
        if {"subtask", "trial", "status"} <= set(mdp.space.names):
            column = mdp.space.column("status")
            first = {column.label(n): mdp.space.index(status=n) for n in range(column.size)}
            key, reads, where = "policy", "status", " at subtask 0, trial 0"
            chosen = {label: policy[state] for label, state in first.items()}
        elif mdp.n_states <= MOST_LISTED:
            chosen = dict(zip(state_names(mdp.space), policy, strict=True))
        # Every action is as bad as the others where even the best value is infinitely bad.
        hopeless = self.value == (np.inf if mdp.sense.costs else -np.inf)
        if mdp.ends.must_choose.any() and hopeless[mdp.ends.must_choose].all():
            chosen = None
        facts = {
            "claim": Shown(self.start.claim),
            "start_value": Shown(float(self.start), self.start),
            "error_bound": Shown(self.error_bound),
            "exact_start_value": Shown(
                proof.start_value if proof else None,
                exact if len(exact) <= 1000 else long,
            ),
            "unique": proof.unique if proof and not self.average else None,
            "stationary": Shown(
                stationary, stationary and "an optimal policy reads the status alone"
            ),
            "regret_bound": Shown(solution.regret_bound if solution and not proof else 0.0),
            "method": solution.method if solution else "exact",
            "iterations": solution.iterations if solution else None,
            "seconds": Shown(solution.seconds, f"{solution.seconds:.2g}") if solution else None,
            "status": Shown(str(solution.status) if solution else None),
            "solver": Shown(solution.solver if solution else None),
            "policy": None,
            "policy_by_state": None,
            key: chosen,
        }
        # Gain and bias of each state, for an average reward.
        if self.average:
            labels = state_names(mdp.space)
            for name, values in (("gain", self.best.value), ("bias", self.best.bias)):
                listed = dict(zip(labels, values, strict=True))
                facts[name] = Shown(listed if mdp.n_states <= MOST_LISTED else None)
        notes = []
        if np.isinf(float(self.start)):
            notes.append(
                "the total reward is infinite, so policies cannot be compared: "
                + ways_out(mdp, other_question(mdp))
            )
        columns = {reads: "", "action": "value"}
        table = Table(
            title=f"optimal action{where}, by {reads}", columns=columns, first=MOST_LISTED
        )
        return Report(title="optimum", facts=facts, tables={key: table}, notes=notes)

    def save(self, path: str) -> None:
        """Write arrays; `q` (S, A) is NaN for actions that are not available, and is a Q-table.

        For an average reward there is the bias instead of action values.
        """
        arrays: dict[str, Any] = {
            "value": self.value,
            "state_error": self.state_error,
            "policy": np.asarray(self.best.policy),
            "start_value": np.float64(float(self.start)),
            "error_bound": np.float64(self.error_bound),
            "claim": np.array(str(self.start.claim)),
        }
        if self.average:
            arrays["bias"] = self.best.bias.astype(np.float64)
        else:
            arrays["q"] = self.mdp.by_action(self.mdp.backup(self.value))
            arrays["optimal"] = self.mdp.by_action(self.optimal)
        content = io.BytesIO()
        np.savez(content, **arrays)
        write_atomically(path, content.getvalue())


def actions_of(mdp: MDP, pairs: Flags) -> list[tuple[str, ...]]:
    """Return the names of the actions that a set of pairs (L,) has in each state."""
    names: list[list[str]] = [[] for _ in range(mdp.n_states)]
    for pair in np.flatnonzero(pairs).tolist():
        names[mdp.pair_state[pair]].append(mdp.actions[mdp.pair_action[pair]])
    return [tuple(each) for each in names]


def _serves_each_status(mdp: MDP, optimal: Flags) -> bool:
    """Return whether some action is optimal, by pairs (L,), in all states of each status."""
    values, size = mdp.space.values("status"), mdp.space.column("status").size
    choosing = find_reachable_states(mdp) & ~mdp.forced & (values >= 0)
    states = np.bincount(values[choosing], minlength=size)
    counted = optimal & choosing[mdp.pair_state]
    keys = values[mdp.pair_state[counted]] * mdp.n_actions + mdp.pair_action[counted]
    serves = np.bincount(keys, minlength=size * mdp.n_actions).reshape(size, -1) == states[:, None]
    return bool(serves.any(axis=1).all())


def compute_optimum(
    model: MDP,
    method: str = "auto",
    tol: float | None = None,
    *,
    certify: bool = False,
    criterion: Criterion = "total",
) -> Optimum:
    """Solve a model in floating point and, if asked for, exactly.

    Raises ModelError and SolverError as `solve` does (if the exact answer is asked for, a solver
    may give up), and Contradiction. A warning says if a tolerance is not met.
    """
    require_known_name(method, [*SOLVERS, "auto"], "method", "method")
    check_tolerance("tol", tol)
    # The optimum in floats; with a proof asked for, it may fail.
    solution = None
    try:
        solution = solve(model, method, tol=tol, criterion=criterion)
    except SolverError as error:
        if not certify:
            raise
        warn_user(f"{error} (the exact values stand)", PrecisionWarning)
    # The exact optimum, with a proof that its checker has accepted.
    if certify:
        exact = certify_and_check(model, criterion)
    else:
        exact = None
    start: Certified | Bounded
    if exact is not None:
        # Certified values are exact; as floats they are rounded once, by less than their spacing.
        value, start = exact.value_float, exact.start
        state_error = np.nan_to_num(np.spacing(np.abs(value)))
        rounding = np.nan_to_num(np.spacing(np.abs(float(start))))
        error_bound = float(max(state_error.max(), rounding))
        # Both answers must agree within the error that the solver states.
        if solution is not None:
            same = np.isclose(
                solution.value, value, rtol=0, atol=solution.state_error + state_error
            )
            if not same.all():
                apart = np.abs(solution.value - value)[~same].max()
                raise Contradiction(
                    f"exact values differ from those of {solution.solver} by up to {apart:.3g}, "
                    f"which states an error of at most {solution.error_bound:.3g}"
                )
    else:
        # Without a proof, the bounds of the solver hold.
        assert solution is not None
        value, state_error = solution.value, solution.state_error
        error_bound = max(solution.error_bound, solution.start.error)
        start = replace(solution.start, error=error_bound)
    return Optimum(
        mdp=model,
        average=is_average(criterion),
        solution=solution,
        certificate=exact,
        value=value,
        state_error=state_error,
        start=start,
        error_bound=error_bound,
    )
