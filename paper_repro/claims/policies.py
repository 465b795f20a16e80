"""Claims about which assistance is best in which status (Section 4.1), by exact optimality.

An action is best in a status where it is optimal in every state with that status, whatever the
subtask and the trial; a certificate lists all optimal actions, ties included.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import partial
from itertools import product

import numpy as np

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.claim import Finding, PaperClaim, Verdict, statement
from exact_mdp.paper_repro.numbers import FINAL
from exact_mdp.paper_repro.view import View
from exact_mdp.solvers.solution import Certified

ANGRY = ["".join(bits) for bits in product("01", repeat=4) if bits[2] == "1"]


def claims() -> Iterator[PaperClaim]:
    """Yield the claims about policies."""
    where = ("Section 4.1", "Figure 10")
    stated = [
        ("policy.anger", "An angry person is best met with supportive assistance.", ANGRY, 1),
        ("policy.1100", "Forgetful and confused: directive assistance is best.", ["1100"], 3),
        ("policy.1000", "Forgetful only: directive assistance is best.", ["1000"], 3),
        ("policy.0100", "Confused only: non-directive assistance is best.", ["0100"], 2),
        ("policy.0000", "No status present: non-directive assistance is best.", ["0000"], 2),
    ]
    for name, says, statuses, action in stated:
        yield PaperClaim(
            id=name,
            places=where,
            says=says,
            rule="statement",
            find=partial(_best, statuses=statuses, action=action),
            open=True,
        )
    yield PaperClaim(
        id="policy.respectively",
        places=where,
        says="Forgetful only or confused only: directive in one and non-directive in the other, "
        "whichever is meant.",
        rule="statement",
        find=_respectively,
        open=True,
    )
    yield PaperClaim(
        id="policy.final-is-optimal",
        places=("Section 4.1",),
        says="The final policy, with non-directive assistance in 0000, is optimal.",
        rule="statement",
        find=_regret,
        open=True,
    )
    yield PaperClaim(
        id="policy.status-suffices",
        places=("Section 3.2.1",),
        says="A policy may read the 16 statuses alone, without the trial or the subtask.",
        rule="statement",
        find=_status_suffices,
        open=True,
    )


def optimal_actions(view: View, status: str) -> list[set[int]]:
    """Return the set of optimal actions of every state with a status and a choice."""
    mdp, pairs = view.mdp, view.certificate.optimal_pairs
    states = np.flatnonzero((mdp.space.values("status") == int(status, 2)) & ~mdp.forced)
    return [
        {int(mdp.pair_action[pair]) for pair in mdp.pairs_of(state) if pairs[pair]}
        for state in states.tolist()
        if not mdp.terminal[state]
    ]


def _best(view: View, *, statuses: Sequence[str], action: int) -> Finding:
    found = [best for status in statuses for best in optimal_actions(view, status)]
    right = sum(action in best for best in found)
    others = sorted({a for best in found if action not in best for a in best})
    instead = "".join(f"; elsewhere {view.mdp.actions[a]} is" for a in others)
    share = Fraction(right, len(found))
    return statement(
        right == len(found),
        f"{view.mdp.actions[action]} is optimal in {right} of {len(found)} states with "
        f"{'this status' if len(statuses) == 1 else 'anger'}{instead}",
        Certified(value=share),
        f"{float(share):.0%} of states",
    )


def _respectively(view: View) -> Finding:
    best = {status: optimal_actions(view, status) for status in ("1000", "0100")}
    names = {
        status: "/".join(sorted({view.mdp.actions[a] for found in each for a in found}))
        for status, each in best.items()
    }
    holds = any(
        all(a in found for found in best["1000"]) and all(b in found for found in best["0100"])
        for a, b in ((3, 2), (2, 3))
    )
    told = ", ".join(f"{status}: {name}" for status, name in names.items())
    return statement(holds, f"optimal actions are {told}")


def _regret(view: View) -> Finding:
    from exact_mdp.analysis import check

    audit = check(view.mdp, view.study.policies[f"reported.{FINAL}"])
    lost = audit.regret.at_start
    by_status: dict[str, float] = {}
    space = view.mdp.space
    for each in audit.disagreements:
        status = space.as_dict(each.state)["status"]
        by_status[status] = by_status.get(status, 0.0) + each.cost
    costs = ", ".join(
        f"{status} {cost:.2f}" for status, cost in sorted(by_status.items(), key=lambda x: -x[1])
    )
    study = view.study
    found, best = study.completions, study.evaluations["optimal"]
    value = found.mean[FINAL]
    fits, least = (best.mean - float(v) for v in (value[found.fitting], value.max()))
    reached = least <= 2 * (found.error + best.error_bound)
    text = (
        f"with 1000 and 0100 as written it loses {float(lost.value):.2f} of the optimum "
        f"({audit.relative_regret:.1%}" + (f"; by status: {costs})" if costs else ")")
    )
    filled = found.choices[found.fitting]
    return Finding(
        verdict=Verdict.REPRODUCED if audit.passed or reached else Verdict.NOT_REPRODUCED,
        why=f"{text}; filled in as fits the three averages best, {fits:.2f} "
        f"({reported.told(filled)}); over all {len(value)} ways to fill in what the text leaves "
        f"open, {max(least, 0.0):.2f} at least",
        number=lost,
        shown=f"regret {float(lost.value):.3f}",
        details={
            "cost_by_status": by_status,
            "relative_regret": audit.relative_regret,
            "regret_of_best_fit": fits,
            "least_regret": max(least, 0.0),
        },
    )


def _status_suffices(view: View) -> Finding:
    statuses = [format(number, "04b") for number in range(16)]
    shared = {status: set.intersection(*optimal_actions(view, status)) for status in statuses}
    lacking = [status for status, common in shared.items() if not common]
    if not lacking:
        why = "in every status one action is optimal in all subtasks and trials"
    else:
        why = f"no action is optimal throughout in {', '.join(lacking)}"
    return statement(not lacking, why)
