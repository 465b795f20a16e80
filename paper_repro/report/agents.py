"""The part of the report about the two agents: what Section 4.2 claims, and what perception costs.

What the paper says there of language cannot be checked without its authors' model; what follows
from the decision model is computed (`paper_repro.agents.claims`). The figures show what perception
is worth: the scripted agent's measured confusion, what its errors cost, and what is left of the
optimum as perception worsens. The scripted agent misreads each status at a stated rate, so that its
confusion is known and the measurement can be compared with it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import matplotlib.pyplot as plt
from matplotlib.figure import Figure

from exact_mdp.analysis.perception.accuracy import (
    AccuracyCurves,
    Hedging,
    accuracy_curves,
    prices,
)
from exact_mdp.analysis.perception.cost import (
    PriceOfPerception,
    UncertainValue,
    value_under_counts,
)
from exact_mdp.analysis.perception.errors import ErrorCosts, error_costs
from exact_mdp.analysis.perception.needed import AccuracyNeeded, accuracy_needed
from exact_mdp.analysis.plots.perception import (
    plot_accuracy_curves,
    plot_confusion,
    plot_error_costs,
    plot_hedging,
    plot_prices,
)
from exact_mdp.analysis.plots.style import titled
from exact_mdp.mdp import MDP, Policy, Scenario
from exact_mdp.mdp.care.perception import Counted, counted
from exact_mdp.paper_repro.agents.claims import statements
from exact_mdp.paper_repro.agents.conversation import modules_of
from exact_mdp.paper_repro.agents.measure import labelled
from exact_mdp.paper_repro.agents.scripted import Scripted
from exact_mdp.paper_repro.report.figures import Pictures
from exact_mdp.paper_repro.report.report import Part
from exact_mdp.solvers import solve

SCENARIO = "yuan2025"
NOISE = 0.05  # of the scripted agent whose perception is measured
EACH = 20  # behaviours for each status vector
SEED = 42
DRAWS = 2000
LEVELS = (1.0, 0.98, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7)
PICTURES = Pictures()


def agents_part() -> Part:
    """Return what can be shown of the two agents."""
    intro = (
        "`python -m paper_repro.agents` plays the two agents, with a scripted language backend or "
        "with a model of yours; the figures below are of the scripted one, and of the decision "
        "model where perception errs."
    )
    told = [f"{each.claim} ({each.place}): {each.kind}." for each in statements()]
    return Part(title="The two agents", sentences=(intro, *told), figures=tuple(PICTURES))


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


@cache
def worsening() -> tuple[tuple[PriceOfPerception, ...], Hedging, AccuracyCurves, AccuracyNeeded]:
    """Return what is left as perception worsens, how reading hedges, curves, and what is needed."""
    mdp = measured().mdp
    # Limits by count, not by time: every run says the same.
    found = prices(mdp, LEVELS, tol=0.05, seconds=60, max_trials=20, node_limit=4000)
    return found, Hedging.of(mdp, LEVELS, found), accuracy_curves(mdp), accuracy_needed(mdp)


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
    _, _, curves, needed = worsening()
    plot_accuracy_curves(curves, needed=needed, ax=ax)
    titled(ax, "The optimal policy acting on what it perceives")
    return figure


@PICTURES.add("agents_perception_memory")
def _memory() -> Figure:
    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    plot_prices(LEVELS, worsening()[0], ax=ax)
    titled(ax, "What remembering saves as perception worsens")
    return figure


@PICTURES.add("agents_perception_hedging")
def _hedging() -> Figure:
    figure, ax = plt.subplots(figsize=(7.4, 5.0))
    plot_hedging(worsening()[1], ax=ax)
    titled(ax, "The best action for each status perceived, without memory")
    return figure
