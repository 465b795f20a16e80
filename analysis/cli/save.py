"""What `exact-mdp solve` writes: policy, arrays and proof, each with the record of its making."""

from __future__ import annotations

import io

import click
import numpy as np

from exact_mdp import solvers
from exact_mdp.analysis.optimum import Optimum
from exact_mdp.analysis.record import run_record, write_record
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.load import Loaded
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy


def save(
    loaded: Loaded,
    found: Optimum,
    policy_out: str | None,
    out: str | None,
    certificate: str | None,
) -> list[str]:
    """Write what was asked for and return the paths of the results."""
    written = [path for path in (policy_out, out, certificate) if path]
    if not written:
        return []
    mdp = loaded.mdp
    if certificate:
        proof = found.certificate or solvers.certify(mdp, bounded=True, solution=found.solution)
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
    """Write arrays; `q` is (S, A), NaN where an action is not available, and reads as a policy."""
    q = np.full((mdp.n_states, mdp.n_actions), np.nan)
    q[mdp.pair_state, mdp.pair_action] = mdp.backup(found.value)
    optimal = np.zeros(q.shape, dtype=bool)
    optimal[mdp.pair_state, mdp.pair_action] = found.optimal
    content = io.BytesIO()
    np.savez(
        content,
        value=found.value,
        state_error=found.state_error,
        policy=found.policy,
        q=q,
        optimal=optimal,
        start_value=np.float64(found.start_value),
        error_bound=np.float64(found.error_bound),
        claim=np.array(str(found.claim)),
    )
    write_atomically(path, content.getvalue())
