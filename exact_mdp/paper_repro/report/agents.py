"""The part of the report about the two agents: what Section 4.2 claims, and what perception costs.

What the paper says there of language cannot be checked without its authors' model; what follows
from the decision model is computed (`paper_repro.agents.claims`). The figures show what perception
is worth: the scripted agent's measured confusion, what its errors cost, and what the optimal policy
is worth as perception worsens. The scripted agent misreads each status at a stated rate, so that
its confusion is known and the measurement can be compared with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from exact_mdp.analysis.perception.accuracy import accuracy_curves
from exact_mdp.analysis.perception.cost import UncertainValue, value_under_counts
from exact_mdp.analysis.perception.errors import ErrorCosts, error_costs
from exact_mdp.analysis.plots.perception import (
    plot_accuracy_curves,
    plot_confusion,
    plot_error_costs,
)
from exact_mdp.analysis.plots.style import titled
from exact_mdp.mdp.care.perception import Counted, counted
from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.paper_repro.agents.claims import statements
from exact_mdp.paper_repro.agents.conversation import conversation, modules_of
from exact_mdp.paper_repro.agents.measure import labelled
from exact_mdp.paper_repro.agents.prompts import Prompts
from exact_mdp.paper_repro.agents.protocol import plain
from exact_mdp.paper_repro.agents.recording import Recording
from exact_mdp.paper_repro.agents.scripted import Scripted
from exact_mdp.paper_repro.agents.session import hold
from exact_mdp.paper_repro.report.drawings import plot_boxes
from exact_mdp.paper_repro.report.figures import Pictures
from exact_mdp.paper_repro.report.report import Part, Text
from exact_mdp.paper_repro.report.tables import Table
from exact_mdp.solvers.solver import solve

SCENARIO = "yuan2025"
NOISE = 0.05  # of the scripted agent whose perception is measured
EACH = 20  # behaviours for each status vector
SEED = 42
SHOWN, TIMESTEPS = 3, 6  # seed of the conversation that is shown, and how much of it
DRAWS = 2000
PICTURES = Pictures()


def agents_part() -> Part:
    """Return what can be shown of the two agents."""
    intro = (
        "`python -m paper_repro.agents` plays the two agents, with a scripted language backend or "
        "with a model of yours; the figures below are of the scripted one, and of the decision "
        "model where perception errs."
    )
    told = [f"{each.claim} ({each.place}): {each.kind}." for each in statements()]
    return Part(
        title="The two agents",
        sentences=(intro,),
        more={"What the paper says of them": tuple(told)},
        figures=tuple(PICTURES),
        tables=(_example(),),
        texts=_texts(),
    )


@cache
def held() -> tuple[Recording, str]:
    """Return a scripted conversation, its first timesteps, and what its text file says."""
    talk = conversation(Scripted(), seed=SHOWN)
    with TemporaryDirectory() as folder:
        record = hold(talk, Path(folder) / "talk", limit=TIMESTEPS)
        return record, (Path(folder) / "talk" / "conversation.txt").read_text("utf-8")


def _example() -> Table:
    """Return the scripted agents' interaction, timestep by timestep."""
    rows = [
        (
            str(step["timestep"]),
            step["status"],
            f"{plain(step['behaviour']['nonverbal'])} “{plain(step['behaviour']['verbal'])}”",
            step["perceived"],
            step["action"],
            plain(step["assistance"]) or "(silent)",
        )
        for step in held()[0].steps
    ]
    return Table(
        title="An interaction of the scripted agents",
        headings=("timestep", "status", "the person", "perceived", "action", "the robot"),
        rows=tuple(rows),
        note="A status is four digits: forgetful, confused, angry, disengaged. The words are a "
        "script's; with a language model the same table is what `python -m paper_repro.agents run` "
        "records.",
        place="Figure 12",
    )


def _texts() -> tuple[Text, ...]:
    """Return the prompts and a recording, which answer to figures of the paper that are texts."""
    prompts = Prompts.load()
    brief, detailed = (prompts.assistance_lines(detailed=each) for each in (False, True))
    execution = prompts["execution"]
    own = "Prompt of this project: "
    return (
        Text(title=f"{own}behaviour", body=prompts["behaviour"].shown(), place="Figure 5"),
        Text(title=f"{own}perception", body=prompts["perception"].shown(), place="Figure 6"),
        Text(
            title=f"{own}execution, brief guidance, without status",
            body=execution.shown(without=["status"]).replace("$assistance", brief),
            place="Figure 7",
        ),
        Text(
            title=f"{own}execution, detailed guidance, with status",
            body=execution.shown().replace("$assistance", detailed),
            place="Figure 8",
        ),
        Text(title="What a run of the scripted agents saves", body=held()[1], place="Figure 11"),
    )


@PICTURES.add("agents_architecture")
def _architecture() -> Figure:
    figure, ax = plt.subplots(figsize=(7.2, 3.0))
    boxes = {
        "model": (0.0, 1.6, "person: care model\n(statuses, computed)", False),
        "behaviour": (3.6, 1.6, "person: behaviour\n(words)", True),
        "perception": (7.2, 1.6, "robot: perception\n(statuses from words)", True),
        "choice": (7.2, 0.0, "robot: choice of action\n(policy, computed)", False),
        "execution": (3.6, 0.0, "robot: execution\n(words for the action)", True),
        "next": (0.0, 0.0, "person: hears it;\nnext statuses are drawn", False),
    }
    arrows = [
        ("model", "behaviour", "true statuses"),
        ("behaviour", "perception", "what is seen, heard"),
        ("perception", "choice", "perceived statuses"),
        ("choice", "execution", "a0 to a3"),
        ("execution", "next", "assistance"),
        ("next", "model", "action"),
    ]
    plot_boxes(boxes, arrows, ax=ax)
    return figure


@PICTURES.add("agents_flow")
def _flow() -> Figure:
    figure, ax = plt.subplots(figsize=(7.2, 4.2))
    boxes = {
        "start": (0.0, 3.2, "a timestep begins\n(the first in 0000)", False),
        "behave": (3.6, 3.2, "the person behaves", True),
        "perceive": (7.2, 3.2, "the robot perceives\nfour statuses", True),
        "choose": (7.2, 1.6, "it chooses an action\nand says it", True),
        "draw": (3.6, 1.6, "the next statuses\nare drawn", False),
        "trial": (0.0, 1.6, "another trial,\nless than five failed", False),
        "done": (3.6, 0.0, "subtask completed\n(0000) or skipped", False),
        "next": (0.0, 0.0, "next subtask", False),
        "end": (7.2, 0.0, "end of the activity", False),
    }
    arrows = [
        ("start", "behave", ""),
        ("behave", "perceive", "behaviour"),
        ("perceive", "choose", ""),
        ("choose", "draw", "assistance"),
        ("draw", "trial", "a status is left"),
        ("draw", "done", "0000, or the fifth trial"),
        ("done", "next", "subtasks left"),
        ("done", "end", "none left"),
        ("next", "trial", ""),
        ("trial", "start", ""),
    ]
    plot_boxes(boxes, arrows, ax=ax)
    return figure


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """The scripted agent's perception: counts, and what they say of the optimal policy's value."""

    mdp: MDP
    policy: Policy
    counts: Counted
    value: UncertainValue
    costs: ErrorCosts


@cache
def measured() -> Measured:
    """Return the perception of the scripted agent as `measure` counts it, and what it costs."""
    scenario = Scenario.load(SCENARIO)
    mdp = scenario.compile()
    policy = Policy.from_choices(mdp, solve(mdp).policy)
    agent = Scripted(noise=NOISE)
    found = labelled(modules_of(scenario), agent, agent, each=EACH, seed=SEED)
    size = mdp.space.column("status").size
    pairs = [(each.status, each.perceived) for each in found]
    counts = counted(pairs, size=size, prior=1 / size)
    return Measured(
        mdp=mdp,
        policy=policy,
        counts=counts,
        value=value_under_counts(mdp, policy, counts, rng=SEED, n=DRAWS),
        costs=error_costs(mdp, policy, Counted(counts=counts.counts).mean),
    )


@PICTURES.add("agents_perception_confusion")
def _confusion() -> Figure:
    figure, ax = plt.subplots(figsize=(5.6, 5.6))
    plot_confusion(Counted(counts=measured().counts.counts).mean, ax=ax)
    titled(ax, f"Scripted agent, noise {NOISE:g}: what is read out of {EACH} behaviours each")
    return figure


@PICTURES.add("agents_perception_errors")
def _errors() -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 3.2))
    found = measured()
    plot_error_costs(found.costs, ax=ax)
    low, high = found.value.interval
    titled(
        ax,
        f"What these errors cost the optimal policy: {found.costs.value.value:.1f} instead of "
        f"{found.costs.perfect.value:.1f}\n(by the posterior of the counts {low:.1f} to {high:.1f},"
        f" {found.value.level:.0%} credible)",
    )
    return figure


@PICTURES.add("agents_perception_accuracy")
def _accuracy() -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    mdp = measured().mdp
    plot_accuracy_curves(accuracy_curves(mdp), ax=ax)
    titled(ax, "The optimal policy acting on what it perceives")
    return figure
