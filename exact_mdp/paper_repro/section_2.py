"""Section 2, the agent PLWD: terms, assistance, Table 3, the skip rule; Figures 1 to 4.

Every number is read back out of the compiled model: the probability that a status is present next
is a sum over the exact outcomes of a row. So the paper is compared with the model that the solvers
use, not with the scenario file.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from functools import partial
from itertools import pairwise, product
from math import prod
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp import Certified, evaluate
from exact_mdp.paper_repro import drawing
from exact_mdp.paper_repro.claim import (
    Finding,
    compare_entries,
    judge_statement,
    judge_undecided,
    register_claim,
)
from exact_mdp.paper_repro.compiled import (
    compute_effect,
    compute_status_distribution,
    compute_status_probability,
)
from exact_mdp.paper_repro.drawing import (
    PERSON,
    ROBOT,
    Box,
    draw_arrow,
    draw_diagram,
    register_figure,
)
from exact_mdp.paper_repro.paper import ACTIONS, BITS, PAPER, SETTINGS, table_3
from exact_mdp.paper_repro.silent_points import Reading

if TYPE_CHECKING:
    from matplotlib.figure import Figure

COGNITIVE = {"forgetfulness": "confusion", "confusion": "forgetfulness"}


def format_points(effects: Mapping[str, Fraction]) -> str:
    """Return percentage points in words."""
    return ", ".join(f"{name} {float(100 * value):+g}" for name, value in effects.items())


# ---- the simulator, Tables 1 and 2 ---------------------------------------------------------------


@register_claim("simulator.open-source", "Section 1", rule="open")
def open_source(reading: Reading) -> Finding:
    """The simulator is open source."""
    return judge_undecided(
        "the text gives no address for it. Earlier code of the same laboratory is public "
        "(github.com/ZhaoRobotLab/PLWDCareSim); whether it is the simulator of the paper is not "
        "stated. Nothing here is taken from it"
    )


@register_claim("table1.example", "Table 1", kind="input", open=True)
def table_1_example(reading: Reading) -> Finding:
    """The example has a first task of three items, each identified and then picked up: six
    subtasks; and a second task, choosing the cash.
    """
    tasks = ", ".join(map(str, reading.scenario.tasks))
    why = f"subtasks of each task here: {tasks}; the text does not say how many the experiments ran"
    return judge_statement(reading.scenario.tasks[0] == 6, why)


@register_claim("table1.timesteps", "Table 1", kind="input", open=True)
def table_1_timesteps(reading: Reading) -> Finding:
    """The timesteps of a scenario are the sum of the trials over all its subtasks."""
    mdp = reading.mdp
    trying = (mdp.space.values("trial") < reading.scenario.trials) & ~mdp.terminal
    runs = [reading.evaluate_policy(name) for name in ("optimal", "random")]
    apart = max(abs(run.steps - float(run.visits[trying].sum())) for run in runs)
    return judge_statement(
        apart < 1e-9,
        "expected timesteps equal expected trials under the optimal and the random policy"
        if apart < 1e-9
        else f"a skip takes a timestep of its own: up to {apart:.2f} more timesteps than trials",
    )


@register_claim("table2", "Table 2", "Section 3.2.2", kind="input", rule="statement")
def table_2(reading: Reading) -> Finding:
    """The robot chooses among no assistance (a0), verbal supportive (a1), verbal non-directive (a2)
    and verbal directive assistance (a3).
    """
    names = reading.mdp.actions[: len(ACTIONS)]
    return judge_statement(tuple(names) == ACTIONS, f"a0 to a3 of the model: {', '.join(names)}")


# ---- Table 3 and what the text says of it --------------------------------------------------------


@register_claim("table3", "Table 3", kind="input", rule="entries")
def table_3_entries(reading: Reading) -> Finding:
    """Without assistance the statuses move by the twenty numbers of the table: base probabilities,
    persistence on the diagonal, influences beside it.
    """
    mdp, model = reading.mdp, {}
    forwards = reading.scenario.readings["influence_orientation"] == "row-to-column"
    for name in table_3():
        kind, row, *rest = name.split(".")
        if kind == "influence":
            if forwards:
                source, target = (row, rest[0])
            else:
                source, target = (rest[0], row)
            model[name] = compute_effect(mdp, source, target)
        else:
            model[name] = compute_status_probability(
                mdp, BITS[row] if kind == "persistence" else 0, 0, row
            )
    return compare_entries(table_3(), model)


@register_claim("prose.no-recovery-alone", "Section 2.1", kind="input")
def no_recovery_alone(reading: Reading) -> Finding:
    """Without assistance a status hardly ever goes away by itself: it stays with a probability of
    almost 1.
    """
    chances = []
    for status, bit in BITS.items():
        chances.append(1 - compute_status_probability(reading.mdp, bit, 0, status))
    leaves = max(chances)
    why = f"a status alone goes away with probability {float(leaves):.0%} at most"
    number, number_is = Certified(value=leaves), "the largest of these probabilities"
    return judge_statement(leaves <= Fraction(1, 100), why, number=number, number_is=number_is)


@register_claim("states.independent", "Section 2.1", kind="input", rule="open")
def statuses_are_independent(reading: Reading) -> Finding:
    """The four statuses of the next timestep are drawn one by one."""
    mdp, products = reading.mdp, 0
    for vector in range(16):
        for action in range(len(ACTIONS)):
            ones = {}
            for name, bit in BITS.items():
                ones[bit] = compute_status_probability(mdp, vector, action, name)
            independent = {}
            for after in range(16):
                factors = [p if after & bit else 1 - p for bit, p in ones.items()]
                independent[after] = prod(factors)
            joint = compute_status_distribution(mdp, vector, action)
            products += all(p == independent[after] for after, p in joint.items())
    return judge_undecided(
        "the text gives the probability of each status alone and does not say that the four are "
        f"independent given statuses and assistance; here they are, in {products} of 64 rows"
    )


@register_claim("prose.anger", "Section 2.1.1", kind="input", open=True)
def anger_weighs_most(reading: Reading) -> Finding:
    """Confusion, anger and disengagement raise forgetfulness, anger the most; and anger contributes
    more to the other statuses than they to each other."""
    effects = {}
    for s in BITS:
        effects[s] = {t: compute_effect(reading.mdp, s, t) for t in BITS if t != s}
    on = {s: effects[s]["forgetfulness"] for s in BITS if s != "forgetfulness"}
    total = {s: sum(each.values(), Fraction(0)) for s, each in effects.items()}
    holds = True
    for each in (on, total):
        others = [points for s, points in each.items() if s != "anger"]
        holds = holds and each["anger"] > max(others)
    why = (
        f"percentage points on forgetfulness: {format_points(on)}; "
        f"on the other three: {format_points(total)}"
    )
    return judge_statement(holds and min(on.values()) > 0, why)


@register_claim("prose.distress", "Section 2.1.1", kind="input", open=True)
def distress_spreads(reading: Reading) -> Finding:
    """Forgetfulness and confusion lead to anger; these three lead to disengagement."""
    edges = [("forgetfulness", "anger"), ("confusion", "anger")]
    edges += [(name, "disengagement") for name in ("forgetfulness", "confusion", "anger")]
    effects = {f"{a} on {b}": compute_effect(reading.mdp, a, b) for a, b in edges}
    return judge_statement(
        min(effects.values()) > 0, f"percentage points: {format_points(effects)}"
    )


# ---- assistance and skipping ---------------------------------------------------------------------


@register_claim("assistance", "Section 2.1.2", kind="input", rule="entries")
def assistance_keeps_statuses(reading: Reading) -> Finding:
    """Supportive assistance keeps anger and disengagement with 5 %; non-directive forgetfulness
    with 40 % and confusion with 60 %; directive both with 5 %. None of these begins under it; all
    other statuses move as without assistance.
    """
    mdp, paper, model = reading.mdp, {}, {}
    for number, action in enumerate(ACTIONS[1:], start=1):
        named = PAPER["assistance"][action]
        for status in BITS:
            for vector in range(16):
                name = f"{action}.{status}.{vector:04b}"
                model[name] = compute_status_probability(mdp, vector, number, status)
                stays = Fraction(0)
                if vector & BITS[status]:
                    stays = Fraction(named.get(status, 0), 100)
                alone = compute_status_probability(mdp, vector, 0, status)
                if status in named:
                    paper[name] = Fraction(stays)
                else:
                    paper[name] = alone
    return compare_entries(
        paper, model, ": 3 assistances, 4 statuses, from each of the 16 status vectors"
    )


def _stays_on_skip(reading: Reading, vector: int, status: str) -> Fraction:
    return compute_status_probability(
        reading.skip_model, vector, 0, status, trial=reading.scenario.trials
    )


@register_claim("skip", "Section 2.1.3", kind="input", rule="entries", open=True)
def skip_keeps_statuses(reading: Reading) -> Finding:
    """When a subtask is skipped, forgetfulness and confusion persist with 50 % together and 20 %
    alone, anger and disengagement with 50 %.
    """
    paper, model = {}, {}
    for status, rates in PAPER["skip"].items():
        for kind, rate in rates.items():
            other = 0
            if kind == "with-other":
                other = BITS[COGNITIVE[status]]
            paper[f"{status}.{kind}"] = Fraction(rate, 100)
            model[f"{status}.{kind}"] = _stays_on_skip(reading, BITS[status] | other, status)
    return compare_entries(paper, model)


@register_claim("prose.stress-on-memory", "Section 2.1.3", kind="input", open=True)
def stress_on_memory(reading: Reading) -> Finding:
    """What a skip leaves of forgetfulness and confusion reflects emotional stress."""
    stress = BITS["anger"] | BITS["disengagement"]
    moved = False
    for vector, name in product(range(16), COGNITIVE):
        if vector & BITS[name]:
            calm = _stays_on_skip(reading, vector & ~stress, name)
            moved = moved or _stays_on_skip(reading, vector, name) != calm
    return judge_statement(
        moved,
        "anger or disengagement changes them"
        if moved
        else "they persist with the same probability with anger or disengagement as without; what "
        "raises it is the other of the two, a cognitive status",
    )


# ---- figures -------------------------------------------------------------------------------------


@register_figure("architecture", "Figure 1", title="The two agents and their modules")
def draw_architecture(reading: Reading) -> Figure:
    """The statuses are drawn from the care model and the action is that of a policy; the three
    modules with a dashed edge are asked of a language model, or of a script.
    """
    from matplotlib.patches import Rectangle

    fig, ax = drawing.create_axes(7.2, 4.3)
    for x, text in ((-1.5, "agent PLWD"), (2.7, "agent Robot Caregiver")):
        ax.add_patch(Rectangle((x, -0.7), 3.0, 4.4, fill=False, edgecolor="0.6", lw=0.8))
        ax.text(x + 0.1, 3.6, text, va="top", fontsize=9, fontweight="bold")
    box = partial(Box, width=2.2)
    boxes = {
        "care": box(0, 0.1, "care model:\nstatus s, drawn", PERSON),
        "behaviour": box(0, 2.7, "behaviour:\nwords and gestures", PERSON, model=True),
        "perception": box(4.2, 2.7, "perception:\nstatus as perceived", ROBOT, model=True),
        "choice": box(4.2, 1.4, "choice of action a\nby a policy", ROBOT),
        "execution": box(4.2, 0.1, "action execution:\nwhat the robot says", ROBOT, model=True),
    }
    draw_diagram(
        ax,
        boxes,
        [
            ("care", "behaviour", "s"),
            ("behaviour", "perception", "what is seen\nand heard"),
            ("perception", "choice", ""),
            ("choice", "execution", "a"),
            ("execution", "care", "assistance"),
        ],
    )
    ax.set(xlim=(-1.6, 5.8), ylim=(-0.75, 3.8))
    drawing.draw_legend(ax, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3, fontsize=7.5)
    return fig


@register_figure("flow", "Figure 2", title="One timestep of their interaction")
def draw_flow(reading: Reading) -> Figure:
    """From the statuses at the start to the end of the activity. One round is one timestep, a
    trial at a subtask.
    """
    fig, ax = drawing.create_axes(7.2, 5.2)
    trials, box = SETTINGS["max_trial"], partial(Box, width=2.1)
    boxes = {
        "start": box(0, 5, "start: status 0000,\nfirst subtask"),
        "behave": box(0, 4, "put the status into\nbehaviour", PERSON, model=True),
        "perceive": box(0, 3, "perceive a status", ROBOT, model=True),
        "choose": box(0, 2, "choose an action", ROBOT),
        "say": box(0, 1, "put it into words", ROBOT, model=True),
        "draw": box(0, 0, "draw the next status", PERSON),
        "clear": box(3.2, 0, "status 0000?"),
        "failed": box(3.2, 2, f"{trials} failed trials\nat this subtask?"),
        "completed": box(6.4, 0, "subtask completed", PERSON),
        "skipped": box(6.4, 2, "subtask skipped", ROBOT),
        "left": box(6.4, 4, "subtasks left?"),
        "end": box(6.4, 5, "end"),
    }
    steps = ("start", "behave", "perceive", "choose", "say", "draw", "clear")
    draw_diagram(
        ax,
        boxes,
        [
            *((a, b, "") for a, b in pairwise(steps)),
            ("clear", "completed", "yes"),
            ("clear", "failed", "no"),
            ("failed", "skipped", "yes"),
            ("skipped", "left", ""),
            ("left", "end", "no"),
        ],
    )
    # Back to the person: another trial, and the next subtask.
    draw_arrow(ax, (3.2, 2.35), (1.05, 3.85))
    ax.text(2.35, 3.2, "no: another trial", fontsize=7.5)
    draw_arrow(ax, (5.35, 4.0), (1.05, 4.1))
    ax.text(3.2, 4.15, "yes: next subtask", fontsize=7.5, ha="center")
    ax.plot([7.45, 7.75, 7.75], [0, 0, 4], color="0.35", lw=1)
    draw_arrow(ax, (7.75, 4.0), (7.45, 4.0))
    ax.set(xlim=(-1.2, 7.9), ylim=(-0.5, 5.5))
    drawing.draw_legend(ax, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3, fontsize=7.5)
    return fig


def trial_flow(reading: Reading, policy: str) -> np.ndarray:
    """Return (M + 1,) probabilities that each trial of the first subtask is made, and a skip."""
    mdp = reading.skip_model  # where a skip is a state of its own
    best = {f"{vector:04b}": ACTIONS[reading.optimum[vector]] for vector in range(16)}
    visits = evaluate(mdp, best if policy == "optimal" else policy).visits
    here = (mdp.space.values("subtask") == 0) & ~mdp.terminal
    trial = mdp.space.values("trial")
    return np.array([visits[here & (trial == t)].sum() for t in range(reading.scenario.trials + 1)])


@register_figure("trials", "Figure 3", title="Trials of a subtask")
def draw_trials(reading: Reading) -> Figure:
    """A trial that ends in status 0000 completes the subtask; the fifth failed one skips it. The
    numbers are exact, of the first subtask: in a box the probability that it is reached, at an
    arrow up that the trial completes the subtask; above under the optimal policy, below under
    random actions.
    """
    fig, ax = drawing.create_axes(7.4, 2.7)
    reached = [trial_flow(reading, name) for name in ("optimal", "random")]
    last, gap = reading.scenario.trials, 1.75
    end, wide, box = gap * last, gap * (last - 1), partial(Box, width=1.15, height=0.9)
    boxes = {}
    for t in range(last):
        chances = "\n".join(f"{p[t]:.1%}" for p in reached)
        boxes[f"t{t}"] = box(gap * t, 0, f"trial {t + 1}\n{chances}")
    order = [*boxes, "skipped", "next"]
    skipped = "\n".join(f"{p[last]:.2%}" for p in reached)
    boxes["skipped"] = box(end, 0, f"skipped\n{skipped}", ROBOT)
    done = "status 0000: subtask completed"
    boxes["done"] = Box(wide / 2, 1.8, done, PERSON, width=wide + 1.2, height=0.45)
    boxes["next"] = box(end, 1.8, "next subtask\nor the end", height=0.6)
    draw_diagram(ax, boxes, [(a, b, "") for a, b in [*pairwise(order), ("done", "next")]])
    for t in range(last):
        draw_arrow(ax, (gap * t, 0.45), (gap * t, 1.575))
        ends = "\n".join(f"{1 - p[t + 1] / p[t]:.1%}" for p in reached)
        ax.text(gap * t + 0.07, 1.0, ends, fontsize=8, va="center")
    key = (
        "in a box: probability that it is reached; at an arrow up: that the trial completes the "
        "subtask\nupper number: optimal policy; lower number: random actions"
    )
    ax.text(-0.6, -0.65, key, fontsize=8, va="top")
    ax.set(xlim=(-0.7, end + 0.7), ylim=(-1.15, 2.15))
    return fig


@register_figure(
    "mechanism", "Figure 4", title="What moves a status from t to t + 1 (points: percentage points)"
)
def draw_mechanism(reading: Reading) -> Figure:
    """The chance of each status at the next timestep: its base if it is absent and its persistence
    if it is present, the percentage points that other statuses add where it is absent (Table 3,
    read from row to column), and what replaces all this under an assistance that acts on it.
    """
    mdp = reading.mdp
    fig, panels = drawing.create_axes(7.4, 6.4, nrows=2, ncols=2)
    for ax, (status, bit) in zip(panels.flat, BITS.items(), strict=True):
        base, stays = (
            compute_status_probability(mdp, 0, 0, status),
            compute_status_probability(mdp, bit, 0, status),
        )
        own = f"{float(base):.0%} from absent\n{float(stays):.0%} if present"
        boxes = {"next": Box(4.6, 2, f"{status}\nat t + 1\n\n{own}", PERSON, width=2.2, height=1.8)}
        for row, source in enumerate(s for s in BITS if s != status):
            y = 3.4 - row
            boxes[source] = Box(0.4, y, f"{source} at t", PERSON, width=2.2, height=0.6)
            draw_arrow(ax, (1.5, y), (3.5, 2.6 - 0.4 * row))
            # The third arrow rises, and its words stand below it.
            if row < 2:
                side, aside = ("bottom", 0.1)
            else:
                side, aside = ("top", -0.1)
            added = f"+{float(100 * compute_effect(mdp, source, status)):g} points"
            ax.text(1.65, y + aside, added, fontsize=7.5, va=side)
        acts = []
        for number, action in enumerate(ACTIONS):
            if status in PAPER["assistance"].get(action, {}):
                present = float(compute_status_probability(mdp, bit, number, status))
                absent = float(compute_status_probability(mdp, 0, number, status))
                acts.append(f"{action}: {present:.0%} if present, {absent:.0%} from absent")
        boxes["assistance"] = Box(
            2.6, -0.1, "assistance\n" + "\n".join(acts), ROBOT, width=6.2, height=1.05
        )
        draw_arrow(ax, (4.6, 0.43), (4.6, 1.1))
        draw_diagram(ax, boxes, [])
        ax.set(xlim=(-0.85, 5.85), ylim=(-0.75, 3.85))
    return fig
