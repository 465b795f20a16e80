"""Claims about which assistance is best in which status (Section 4.1), by exact optimality.

An action is best in a status where it is optimal in every state with that status, whatever the
subtask and the trial; a certificate lists all optimal actions, ties included.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import partial

import numpy as np

from exact_mdp.analysis.gate.check import check
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.claim import Claims, Finding, statement
from exact_mdp.paper_repro.reading import Reading
from exact_mdp.paper_repro.readings.reported_policy import cost_by_status
from exact_mdp.paper_repro.reported import ANGRY, FINAL, NUMBER
from exact_mdp.solvers.solution import Certified

CLAIMS = Claims()


def optimal_actions(reading: Reading, status: str) -> list[set[int]]:
    """Return the set of optimal actions of every state with a status and a choice."""
    mdp, pairs = reading.mdp, reading.certificate.optimal_pairs
    chosen = (mdp.space.values("status") == int(status, 2)) & ~mdp.forced & ~mdp.terminal
    return [
        {int(mdp.pair_action[pair]) for pair in mdp.pairs_of(state) if pairs[pair]}
        for state in np.flatnonzero(chosen).tolist()
    ]


def _best(reading: Reading, statuses: Sequence[str], action: int) -> Finding:
    found = [best for status in statuses for best in optimal_actions(reading, status)]
    right = sum(action in best for best in found)
    others = sorted({a for best in found if action not in best for a in best})
    instead = "".join(f"; elsewhere {reading.mdp.actions[a]} is" for a in others)
    share = Fraction(right, len(found))
    return statement(
        right == len(found),
        f"{reading.mdp.actions[action]} is optimal in {right} of {len(found)} states with "
        f"{'this status' if len(statuses) == 1 else 'anger'}{instead}",
        Certified(value=share),
        f"{float(share):.0%} of states",
    )


for _name, _statuses, _action, _says in (
    ("anger", ANGRY, "supportive", "An angry person is best met with supportive assistance."),
    ("1100", ["1100"], "directive", "Forgetful and confused: directive assistance is best."),
    ("1000", ["1000"], "directive", "Forgetful only: directive assistance is best."),
    ("0100", ["0100"], "non-directive", "Confused only: non-directive assistance is best."),
    ("0000", ["0000"], "non-directive", "No status present: non-directive assistance is best."),
):
    CLAIMS.add(f"policy.{_name}", "Section 4.1, Figure 10", says=_says, open=True)(
        partial(_best, statuses=_statuses, action=NUMBER[_action])
    )


@CLAIMS.add("policy.respectively", "Section 4.1, Figure 10", open=True)
def _respectively(reading: Reading) -> Finding:
    """Forgetful only or confused only: directive in one and non-directive in the other, whichever
    is meant."""
    best = {status: optimal_actions(reading, status) for status in ("1000", "0100")}
    holds = any(
        all(NUMBER[action] in found for status, action in order.items() for found in best[status])
        for order in reported.ORDERS.values()
    )
    told = ", ".join(
        f"{status}: " + "/".join(sorted({reading.mdp.actions[a] for a in set().union(*each)}))
        for status, each in best.items()
    )
    return statement(holds, f"optimal actions are {told}")


@CLAIMS.add("policy.personalised", "Section 4.1", open=True)
def _personalised(reading: Reading) -> Finding:
    """Forgetful only and confused only get different assistance, because people respond
    differently: decisions are personal."""
    best = [set.intersection(*optimal_actions(reading, status)) for status in ("1000", "0100")]
    names = ["/".join(sorted(reading.mdp.actions[a] for a in each)) or "none" for each in best]
    return statement(
        all(best) and not set.intersection(*best),
        f"optimal throughout: {names[0]} where forgetful only, {names[1]} where confused only. The "
        "model has the probabilities of one person: it compares statuses, not people",
    )


@CLAIMS.add("policy.final-is-optimal", "Section 4.1", open=True)
def _regret(reading: Reading) -> Finding:
    """The final policy, with non-directive assistance in 0000, is optimal."""
    audit = check(reading.mdp, reading.policies[f"reported.{FINAL}"])
    lost, by_status = audit.regret.at_start, cost_by_status(audit, reading.mdp.space)
    costs = ", ".join(f"{status} {cost:.2f}" for status, cost in by_status.items())
    found, best = reading.averages, reading.evaluations["optimal"]
    least = best.mean - found.range(FINAL)[1]
    reached = least <= 2 * (float(found.error) + best.error_bound)
    return statement(
        audit.passed or reached,
        f"with 1000 and 0100 as written it loses {float(lost.value):.2f} of the optimum "
        f"({audit.relative_regret:.1%}{costs and f'; by status: {costs}'}); under "
        f"this reading, {max(least, 0.0):.2f} at least in all {len(reported.COMPLETIONS)} ways to "
        "fill in the open statuses",
        lost,
        f"regret {float(lost.value):.3f}",
        cost_by_status=by_status,
        relative_regret=audit.relative_regret,
        least_regret=max(least, 0.0),
    )


@CLAIMS.add("policy.status-suffices", "Section 3.2.1", kind="input", open=True)
def _status_suffices(reading: Reading) -> Finding:
    """A policy may read the 16 statuses alone, without the trial or the subtask."""
    lacking = [s for s in reported.STATUSES if not set.intersection(*optimal_actions(reading, s))]
    why = "in every status one action is optimal in all subtasks and trials"
    if lacking:
        why = f"no action is optimal throughout in {', '.join(lacking)}"
    return statement(not lacking, why)
