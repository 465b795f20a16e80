"""The part of the report about anger and completed subtasks: what is traded for what, exactly.

The front of the two expected totals (`analysis.tradeoffs.front`) and the best policies that hold
anger to given limits (`solvers.objectives.constrained`); every number is proven.
"""

from __future__ import annotations

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from exact_mdp.analysis.tradeoffs.front import tradeoff
from exact_mdp.paper_repro.reading import Reading
from exact_mdp.paper_repro.report.figures import Pictures
from exact_mdp.paper_repro.report.output import number
from exact_mdp.paper_repro.report.report import Part
from exact_mdp.paper_repro.report.tables import Table
from exact_mdp.paper_repro.reported import FINAL, STARTS
from exact_mdp.solvers.objectives.constrained import ConstrainedSolution
from exact_mdp.solvers.solver import solve

ANGER, DONE = "anger", "subtask-complete"
LIMITS = ("-1", "-3/4", "-1/2", "-1/4", "0")
HALF = "-1/2"  # the limit that the sentence is about
PICTURES = Pictures()


def tradeoffs_part(reading: Reading) -> Part:
    """Return what less anger costs."""
    free = held_to(reading, "-1000")
    kept = {limit: held_to(reading, limit) for limit in LIMITS}
    best, half = return_of(free), kept[HALF]
    return Part(
        title="What is traded for what?",
        sentences=(
            f"The best policy has {number(-float(free.totals[ANGER]))} points of anger in an "
            f"episode; holding anger to half a point costs "
            f"{number(best - return_of(half))} of its return of {number(best)}, and an "
            f"expected {number(float(half.totals['skip'] - free.totals['skip']))} more subtasks "
            "are skipped.",
        ),
        figures=tuple(PICTURES),
        tables=(_limits(free, kept),),
    )


def held_to(reading: Reading, limit: str) -> ConstrainedSolution:
    """Return the best policy whose anger is within a limit; what else is counted is free."""
    wanted = {ANGER: f">= {limit}", DONE: ">= -1000", "skip": ">= 0", "steps": ">= 0"}
    found = solve(reading.mdp, subject_to=wanted)
    if faults := found.violations():
        raise RuntimeError(f"the proof of an optimum under limits does not hold: {faults[0]}")
    return found


def return_of(found: ConstrainedSolution) -> float:
    """Return the optimum under limits that can be kept."""
    if found.start_value is None:
        raise RuntimeError(f"no policy keeps the limits: {found}")
    return float(found.start_value)


@PICTURES.add("anger_front")
def _front(reading: Reading) -> Figure:
    front = tradeoff(reading.mdp, [ANGER, DONE])
    if faults := front.violations():
        raise RuntimeError(f"the proof of a front does not hold: {faults[0]}")
    figure, ax = plt.subplots(figsize=(7.5, 4.6))
    shown = {"optimal policy": reading.policies["optimal"]}
    for start in sorted(STARTS, key=lambda each: each != FINAL):
        shown[f"reported, {start} in 0000"] = reading.policies[f"reported.{start}"]
    front.plot(policies=shown, ax=ax)
    ax.set_xlabel("expected anger (points)")
    ax.set_ylabel("expected subtasks completed (points)")
    ax.set_title("Less anger costs completed subtasks")
    return figure


def _limits(free: ConstrainedSolution, kept: dict[str, ConstrainedSolution]) -> Table:
    rows = [("none", free)] + [(f"at least {limit}", held) for limit, held in kept.items()]
    names = (ANGER, DONE, "skip", "steps")
    return Table(
        title="The best policy under a limit on anger",
        headings=(
            "limit on anger",
            "return",
            "anger",
            "subtasks completed, in points",
            "subtasks skipped",
            "timesteps",
            "price of a point less of anger",
            "states with a drawn action",
        ),
        rows=tuple(
            (
                limit.replace("-", "−"),
                number(return_of(held)),
                *(number(float(held.totals[name])) for name in names),
                number(float(held.prices[ANGER])),
                str(len(held.randomises)),
            )
            for limit, held in rows
        ),
        note="Expected totals of an episode, certified. The price says how fast the return falls "
        "where the limit is moved. A limit that binds needs a policy that draws its action in one "
        "state.",
    )
