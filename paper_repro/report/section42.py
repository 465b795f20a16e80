"""Section 4.2 of the paper, its two agents: claims, figures and an example, for the report.

    from paper_repro.report.section42 import claims, figures, conversation_text

What the paper says there of language cannot be checked without its authors' model; what follows
from the decision model is computed (`paper_repro.agents.claims`). The figures show what perception
is worth: the scripted agent's measured confusion, what its errors cost, and what is left of the
optimum as perception worsens. The scripted agent misreads each status at a stated rate, so that its
confusion is known and the measurement can be held against it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp.analysis.perception.accuracy import (
    AccuracyCurves,
    Hedging,
    accuracy_curves,
    prices,
)
from exact_mdp.analysis.perception.cost import UncertainValue, value_under_counts
from exact_mdp.analysis.perception.errors import ErrorCosts, error_costs
from exact_mdp.analysis.perception.needed import AccuracyNeeded, accuracy_needed
from exact_mdp.mdp import MDP, Policy, Scenario
from exact_mdp.mdp.care.counts import Counted, counted
from exact_mdp.solvers import solve

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from exact_mdp.analysis.perception.cost import PriceOfPerception

SCENARIO = "yuan2025"
NOISE = 0.05  # of the scripted agent whose perception is measured
EACH = 20  # behaviours for each status vector
SEED = 42
DRAWS = 2000
LEVELS = (1.0, 0.98, 0.95, 0.9, 0.85, 0.8, 0.75, 0.7)
CHECKED, MODEL, PEOPLE = "checked here", "needs the authors' model", "needs people to judge"


@dataclass(frozen=True, kw_only=True)
class Row:
    """One claim of the section: what it says, where, what can be said of it here, and why."""

    claim: str
    place: str
    verdict: str
    evidence: str


@dataclass(frozen=True, kw_only=True, eq=False)
class Measured:
    """The scripted agent's perception: counts, and what they say of the optimal policy's value."""

    mdp: MDP
    policy: Policy
    counts: Counted
    value: UncertainValue
    costs: ErrorCosts


def claims() -> list[Row]:
    """Return the claims of Section 4.2 with their verdicts, those of the decision model computed.

    Examples
    --------
    >>> sorted({row.verdict for row in claims()})
    ['checked here', 'needs people to judge', "needs the authors' model"]
    """
    from exact_mdp.paper_repro.agents import claims as told

    verdicts = {told.EXACT: CHECKED, told.MODEL: MODEL, told.PEOPLE: PEOPLE}
    return [
        Row(claim=s.claim, place=s.place, verdict=verdicts[s.kind], evidence=s.found)
        for s in told.statements()
    ]


@cache
def measured() -> Measured:
    """Return the perception of the scripted agent as `measure` counts it, and what it costs."""
    from exact_mdp.paper_repro.agents.conversation import modules_of
    from exact_mdp.paper_repro.agents.measure import labelled
    from exact_mdp.paper_repro.agents.scripted import Scripted

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


def conversation_text(seed: int = 3, timesteps: int = 6) -> str:
    """Return the first timesteps of a scripted conversation, as the paper's record shows them."""
    from itertools import islice

    from exact_mdp.paper_repro.agents import views
    from exact_mdp.paper_repro.agents.conversation import conversation
    from exact_mdp.paper_repro.agents.scripted import Scripted

    talk = conversation(Scripted(noise=NOISE), seed=seed)
    header = talk.header()
    blocks = [views.block(header, step) for step in islice(talk.steps(), timesteps)]
    return views.heading(header) + "".join(blocks)


def figures() -> dict[str, Callable[[], Figure]]:
    """Return the section's figures by name, each a function that draws one."""
    return {
        "perception_confusion": _confusion,
        "perception_errors": _errors,
        "perception_accuracy": _accuracy,
        "perception_memory": _memory,
        "perception_hedging": _hedging,
    }


def _confusion() -> Figure:
    """What the scripted agent reads out of its own behaviours, by true status.

    It misreads each status at a known rate; the matrix is counted from labelled behaviours.
    """
    import matplotlib.pyplot as plt

    from exact_mdp.analysis.plots.perception import plot_confusion
    from exact_mdp.analysis.plots.style import titled

    figure, ax = plt.subplots(figsize=(5.6, 5.6))
    found = measured()
    plot_confusion(Counted(counts=found.counts.counts).mean, ax=ax)
    titled(ax, f"Scripted agent, noise {NOISE:g}: what is read out of {EACH} behaviours each")
    return figure


def _errors() -> Figure:
    """Which errors of the scripted agent's perception cost the optimal policy most.

    The loss against perfect perception, by status, where what is perceived is taken for true.
    """
    import matplotlib.pyplot as plt

    from exact_mdp.analysis.plots.perception import plot_error_costs
    from exact_mdp.analysis.plots.style import titled

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


def _accuracy() -> Figure:
    """The optimal policy's value when it takes what it perceives for true, by accuracy.

    One status read with the accuracy and the others perfectly, and all four alike; the point is
    the accuracy that keeps 95 % of the value.
    """
    import matplotlib.pyplot as plt

    from exact_mdp.analysis.plots.perception import plot_accuracy_curves
    from exact_mdp.analysis.plots.style import titled

    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    _, _, curves, needed = worsening()
    plot_accuracy_curves(curves, needed=needed, ax=ax)
    titled(ax, "The optimal policy acting on what it perceives")
    return figure


def _memory() -> Figure:
    """What is left of the optimum as perception worsens, with memory and without.

    The best controller that remembers (between bounds), the best policy that reads the perceived
    status alone, and the optimal policy that takes it for true.
    """
    import matplotlib.pyplot as plt

    from exact_mdp.analysis.plots.perception import plot_prices
    from exact_mdp.analysis.plots.style import titled

    figure, ax = plt.subplots(figsize=(6.4, 4.2))
    plot_prices(LEVELS, worsening()[0], ax=ax)
    titled(ax, "What remembering saves as perception worsens")
    return figure


def _hedging() -> Figure:
    """The best action for each perceived status as perception worsens, without memory."""
    import matplotlib.pyplot as plt

    from exact_mdp.analysis.plots.perception import plot_hedging
    from exact_mdp.analysis.plots.style import titled

    figure, ax = plt.subplots(figsize=(7.4, 5.0))
    plot_hedging(worsening()[1], ax=ax)
    titled(ax, "The best action for each status perceived, without memory")
    return figure


def summary() -> dict[str, float]:
    """Return the numbers that the report's text quotes, by name.

    Examples
    --------
    >>> found = summary()
    >>> round(found["perfect"], 3), 0.86 < found["accuracy_needed"] < 0.88
    (146.236, True)
    """
    found, (price, _, _, needed) = measured(), worsening()
    at = LEVELS.index(0.9)
    return {
        "perfect": found.costs.perfect.value,
        "measured": found.costs.value.value,
        "measured_low": found.value.interval[0],
        "measured_high": found.value.interval[1],
        "accuracy_needed": float(needed.enough),
        "taken_as_true_at_90": price[at].taken_as_true.value,
        "memoryless_at_90": price[at].memoryless.value.value,
        "filtering_low_at_90": price[at].filtering.lower,
        "filtering_high_at_90": price[at].filtering.upper,
        "unseeing_low": price[at].unseeing.lower,
        "unseeing_high": price[at].unseeing.upper,
        "labels": float(np.sum(found.counts.counts)),
    }
