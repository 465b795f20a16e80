"""What `exact-mdp solve` does: find an optimum, and write policy, arrays and proof."""

from __future__ import annotations

import io
from collections.abc import Mapping, Sequence
from math import isinf
from typing import TYPE_CHECKING, Any, TypeGuard

import click
import numpy as np

from exact_mdp.analysis.cli.options import (
    Given,
    check_outputs,
    given,
    limits_from,
    number_of,
)
from exact_mdp.analysis.cli.render import Report, Table, ratio
from exact_mdp.analysis.optimum import Contradiction, Optimum, optimum
from exact_mdp.analysis.record import run_record, write_record
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.graph import endless, ways_out
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.load import Loaded
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.space import StateSpace
from exact_mdp.solvers.average.solve import AverageSolution
from exact_mdp.solvers.exact.certificate import Certificate
from exact_mdp.solvers.exact.certify import certify
from exact_mdp.solvers.solution import Bounded, Certified
from exact_mdp.solvers.solver import solve as solve_model

if TYPE_CHECKING:
    from exact_mdp.solvers.objectives.checker import Limit
    from exact_mdp.solvers.objectives.constrained import ConstrainedSolution

LISTED_STATES = 1000  # longer policies are left to --policy-out and --out
SHOWN_DIGITS = 1000  # longer exact values are left to --json


def solve(
    *,
    method: str,
    tol: str | None,
    certify: bool,
    policy_out: str | None,
    out: str | None,
    certificate: str | None,
    subject_to: tuple[str, ...],
    **shared: Any,
) -> Report:
    """Find an optimum, and write what was asked for."""
    check_outputs((policy_out, (".csv", ".json")), (out, (".npz",)), (certificate, (".json",)))
    if subject_to:
        refused = {"--method": method != "auto", "--tol": tol}
        refused |= {"--out": out, "--criterion average": shared.get("criterion") == "average"}
        return _under_limits(subject_to, refused, policy_out, certificate, **shared)
    asked = given(**shared)
    mdp, average = asked.mdp, asked.average
    if average and certificate and not certify:
        raise ModelError(
            "there are no bounded certificates of an average reward",
            where="--certificate",
            fix="add --certify",
        )
    if certificate and not certify and not average and endless(mdp):
        raise ModelError(
            "bounds are proved where every policy ends, and here one need not",
            where="--certificate",
            fix="add --certify, which proves the exact values",
        )
    found = optimum(
        mdp,
        method,
        None if tol is None else number_of(tol, "--tol"),
        certify=certify,
        criterion="average" if average else "total",
    )
    written = _write(asked.loaded, found, policy_out=policy_out, out=out, certificate=certificate)
    proof, solution = found.certificate, found.solution
    result: dict[str, Any] = {
        "method": found.method,
        "claim": found.claim,
        "start_value": found.start_value,
        "error_bound": found.error_bound,
        "exact_start_value": proof.start_value if proof else None,
        "unique": proof.unique if isinstance(proof, Certificate) and not average else None,
        "stationary": None,
        "regret_bound": solution.regret_bound if solution and not proof else 0.0,
        "iterations": solution.iterations if solution else None,
        "seconds": solution.seconds if solution else None,
        "status": str(solution.status) if solution else None,
        "solver": solution.solver if solution else None,
        "written": written,
        **policy_words(mdp, [mdp.actions[action] for action in found.policy]),
        **(_averages(mdp, found) if average else {}),
    }
    facts: dict[str, Any] = {"method": found.method}
    if solution:
        facts["method"] += f", {solution.iterations:,} iterations, {solution.seconds:.2g} s"
    value = "reward per step" if average else "start value"
    facts[value] = Bounded(value=found.start_value, error=found.error_bound)
    if isinf(found.start_value):
        facts["note"] = "an infinite total tells no policies apart: " + ways_out(mdp)
    if proof:
        exact = ratio(proof.start_value)
        long = f"a rational of {len(exact):,} digits; --json prints it"
        facts[value] = Certified(value=proof.start_value)
        facts[f"exact {value}"] = exact if len(exact) <= SHOWN_DIGITS else long
        facts["unique optimum"] = result["unique"]
    if "status" in mdp.space.names and isinstance(mdp, MDP) and not average:
        result["stationary"] = found.stationary()
    facts["stationary"] = {
        None: None,
        True: "yes, an optimal policy reads the status alone",
        False: "no, the best action of a status changes with the rest of the state",
    }[result["stationary"]]
    facts["written"] = written or None
    return asked.report(result, facts, [_table(result, asked.loaded)])


def _of_average(best: object) -> TypeGuard[Certificate | AverageSolution]:
    """Return whether a result is that of an average reward."""
    certified = isinstance(best, Certificate) and best.kind == "average"
    return certified or isinstance(best, AverageSolution)


def _averages(mdp: MDP, found: Optimum) -> dict[str, Any]:
    """Return gain and bias of each state, exactly where they are certified."""
    best = found.best
    if mdp.n_states > LISTED_STATES or not _of_average(best):
        return {"gain": None, "bias": None}
    labels = _labels(mdp.space)
    return {
        "gain": dict(zip(labels, best.value, strict=True)),
        "bias": dict(zip(labels, best.bias, strict=True)),
    }


def _limited(refused: Mapping[str, object], **shared: Any) -> Given:
    """Return the model of a command with limits; raises ModelError for options without a use."""
    for option, used in refused.items():
        if used:
            raise ModelError(
                f"{option} does not apply to limits",
                where="--subject-to",
                fix=f"leave {option} out",
            )
    return given(**shared)


def _sound(found: ConstrainedSolution) -> None:
    if faults := found.violations():
        raise Contradiction(f"the proof does not hold: {faults[0]}")


def _under_limits(
    texts: tuple[str, ...],
    refused: Mapping[str, object],
    policy_out: str | None,
    certificate: str | None,
    **shared: Any,
) -> Report:
    """Find the optimum under limits."""
    asked = _limited(refused, **shared)
    mdp = asked.mdp
    found = solve_model(mdp, subject_to=limits_from(texts))
    _sound(found)
    drawn = [{mdp.actions[a]: c for a, c in enumerate(row) if c} for row in found.rule]
    if policy_out:
        found.policy.write(policy_out)
    if certificate:
        found.save(certificate)
    result = {
        "method": "limits",
        "claim": found.claim,
        "feasible": found.feasible,
        "start_value": None if found.start_value is None else float(found.start_value),
        "error_bound": 0.0 if found.feasible else None,
        "exact_start_value": found.start_value,
        "limits": [str(limit) for limit in found.limits],
        "totals": found.totals,
        "prices": found.prices,
        "closest": found.closest,
        "randomises": [
            {"state": mdp.space.label(state), "actions": chances}
            for state, chances in found.randomises.items()
        ],
        "policy": whole_policy(mdp, drawn),
        "written": [path for path in (policy_out, certificate) if path],
    }
    facts = {
        "limits": "can be kept" if found.feasible else "no policy keeps them all (proven)",
        "in any model": _contradictory(found.limits),
        "start value": found.start or "none: no policy keeps the limits",
        "draws its action in": f"{len(found.randomises)} state(s): "
        + "; ".join(map(mdp.space.label, found.randomises))
        if found.randomises
        else "no state",
        "written": result["written"] or None,
    }
    rows = [
        {"limit": str(limit), "total": float(found.totals[limit.name]), "price": float(price),
         "closest": float(found.closest[limit.name])}
        for limit, price in zip(found.limits, found.price, strict=True)
    ]  # fmt: skip
    title = "limits" if found.feasible else "limits, and the closest ones that can be kept"
    shown = {"limit": "limit", "total": "total", "price": "price:.10g"}
    table = Table(
        title=title,
        rows=rows,
        columns=shown if found.feasible else {"limit": "limit", "closest": "closest:.10g"},
        note="price: what the optimum gains for one point by which the limit is moved"
        if found.feasible
        else "all are moved by the same step, the least that suffices",
    )
    return asked.report(result, facts, [table], status=0 if found.feasible else 1)


def _contradictory(limits: Sequence[Limit]) -> str | None:
    """Return in words which two limits no total keeps, whatever the model; None where none do."""
    for low in limits:
        for high in limits:
            if (low.name, low.sign, high.sign) == (high.name, 1, -1) and low.bound > high.bound:
                return f"{low} and {high} contradict each other"
    return None


def policy_words(mdp: MDP, names: Sequence[Any]) -> dict[str, dict[str, Any] | None]:
    """Return what is said of each state by status at subtask 0, trial 0, or by state if few."""
    if {"subtask", "trial", "status"} <= set(mdp.space.names):
        column = mdp.space.column("status")
        first = {column.label(value): mdp.space.index(status=value) for value in range(column.size)}
        by_status = {label: names[state] for label, state in first.items()}
        return {"policy": by_status, "policy_by_state": None}
    if mdp.n_states > LISTED_STATES:
        return {"policy": None, "policy_by_state": None}
    by_state = dict(zip(_labels(mdp.space), names, strict=True))
    return {"policy": None, "policy_by_state": by_state}


def whole_policy(mdp: MDP, names: Sequence[Any]) -> dict[str, Any]:
    """Return what is said of every state: by status where that alone decides, else by state.

    Both are policies that a file may hold.
    """
    if "status" in mdp.space.names:
        column = mdp.space.column("status")
        status = mdp.space.values("status")
        asked = np.flatnonzero(mdp.asked & (status >= 0)).tolist()
        found = {
            column.label(value): names[mdp.space.index(status=value)]
            for value in range(column.size)
        }
        found |= {column.label(int(status[state])): names[state] for state in asked}
        if all(found[column.label(int(status[state]))] == names[state] for state in asked):
            return found
    return dict(zip(_labels(mdp.space), names, strict=True))


def _labels(space: StateSpace) -> list[str]:
    """Return a name for each state."""
    if len(space.columns) == 1:
        column = space.columns[0]
        return [*(column.label(value) for value in range(column.size)), *space.extra]
    return space.labels(range(space.size))


def _table(result: dict[str, Any], loaded: Loaded) -> Table:
    policy, reads, title = result["policy_by_state"] or {}, "state", "optimal policy"
    if result["policy"] is not None:
        policy, reads = result["policy"], "status"
        digits = f" (digits: {', '.join(loaded.scenario.statuses)})" if loaded.scenario else ""
        title = f"optimal action at subtask 0, trial 0, by status{digits}"
    rows = [{"reads": label, "action": action} for label, action in policy.items()]
    shown = rows if len(rows) <= LISTED_STATES else []
    return Table(
        title=title, rows=shown, columns={reads: "reads", "action": "action"}, first=LISTED_STATES
    )


def _write(
    loaded: Loaded,
    found: Optimum,
    *,
    policy_out: str | None,
    out: str | None,
    certificate: str | None,
) -> list[str]:
    """Write what was asked for, each with the record of its making, and return the paths."""
    written = [path for path in (policy_out, out, certificate) if path]
    if not written:
        return []
    mdp = loaded.mdp
    if certificate:
        proof = found.certificate or certify(mdp, bounded=True, solution=found.solution)
        proof.save(certificate)
    if policy_out:
        Policy.from_choices(mdp, found.policy).write(policy_out)
    if out:
        _save_arrays(mdp, found, out)
    solver = found.solution.solver if found.solution else found.method
    words = click.get_current_context().find_root().obj
    record = run_record(mdp, model=loaded.name, solver=solver, command=words)
    for path in written:
        write_record(path, record)
    return written


def _save_arrays(mdp: MDP, found: Optimum, path: str) -> None:
    """Write arrays; `q` is (S, A), NaN where an action is not available, and reads as a policy.

    Of an average reward there is the bias instead of action values.
    """
    arrays: dict[str, Any] = {
        "value": found.value,
        "state_error": found.state_error,
        "policy": found.policy,
        "start_value": np.float64(found.start_value),
        "error_bound": np.float64(found.error_bound),
        "claim": np.array(str(found.claim)),
    }
    if _of_average(found.best):
        arrays["bias"] = found.best.bias.astype(np.float64)
    else:
        q = np.full((mdp.n_states, mdp.n_actions), np.nan)
        q[mdp.pair_state, mdp.pair_action] = mdp.backup(found.value)
        optimal = np.zeros(q.shape, dtype=bool)
        optimal[mdp.pair_state, mdp.pair_action] = found.optimal
        arrays |= {"q": q, "optimal": optimal}
    content = io.BytesIO()
    np.savez(content, **arrays)
    write_atomically(path, content.getvalue())
