"""Section 4.1, average returns and which assistance is best, by exact values and certificates.

The value of a reported policy depends on two things that the text leaves open: the order of
"directive or non-directive, respectively" is named wherever such a number stands, and in the four
statuses of which nothing is said the policy is supportive (`silent_points`).
"""

from __future__ import annotations

from collections import defaultdict
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise, product
from math import erfc, exp, pi, sqrt
from typing import TYPE_CHECKING

import numpy as np

from exact_mdp import Certified, Estimated, check, return_distribution
from exact_mdp.paper_repro import drawing
from exact_mdp.paper_repro.claim import (
    CHANCE,
    NEARLY_ALL,
    Finding,
    compare_approximately,
    compare_average,
    format_chance,
    format_per_cent,
    judge_by_chance,
    judge_statement,
    judge_undecided,
    register_claim,
)
from exact_mdp.paper_repro.compiled import compute_costs, list_optimal_actions
from exact_mdp.paper_repro.drawing import BLUE, register_figure
from exact_mdp.paper_repro.paper import (
    ACTIONS,
    ANGRY,
    AVERAGES,
    EXPERIMENTS,
    FINAL,
    ORDERS,
    REPORTED,
    SETTINGS,
    STATUSES,
    describe_status,
    format_loss,
)
from exact_mdp.paper_repro.silent_points import Reading

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# ---- average returns -----------------------------------------------------------------------------


@register_claim("return.random", "Section 4.1", "Figure 9", rule="about", open=True)
def random_return(reading: Reading) -> Finding:
    """The random strategy reaches an average return of around 70."""
    exact = reading.evaluate_policy("random")
    return compare_approximately(REPORTED["random"], exact.start, details={"sd": exact.sd})


@register_claim("return.superior", "Section 4.1", open=True)
def policies_beat_random(reading: Reading) -> Finding:
    """The learned policies are superior to the random strategy."""
    random = reading.evaluate_policy("random").mean
    means = []
    for start in AVERAGES:
        for order in ORDERS:
            means.append(reading.evaluate_policy(start, order).mean)
    lowest = min(means)
    why = (
        f"the worst of the three policies, in both orders, earns {lowest:.1f}, and random actions "
        f"{random:.1f}"
    )
    return judge_statement(lowest > random + 1e-6, why)


def both_orders(reading: Reading, start: str) -> str:
    """Return the value of a reported policy in both orders, with its distance from the paper's."""
    listed = []
    for order in ORDERS:
        deviation = reading.compute_deviation(start, order)
        if deviation < 0:
            side = "below"
        else:
            side = "above"
        listed.append(
            f"{order} {reading.evaluate_policy(start, order).mean:.2f} "
            f"({abs(deviation):.1f} s.e. {side} the paper's average)"
        )
    return ", ".join(listed)


@register_claim(
    "return.reported.{word}",
    "Section 4.1",
    rule="average",
    open=True,
    each={start: str(number) for start, number in AVERAGES.items()},
)
def reported_return(reading: Reading, start: str) -> Finding:
    """The policy with {word} assistance in status 0000 averages {means} over 1,000 experiments."""
    exact = reading.evaluate_policy(start)
    why = f"exact mean with 1000 and 0100 {both_orders(reading, start)}; judged {reading.order}"
    mean = compare_average(
        AVERAGES[start], exact.mean, exact.sd, EXPERIMENTS, error=exact.start.error, why=why
    )
    orders = {order: reading.evaluate_policy(start, order).mean for order in ORDERS}
    return replace(mean, details={"sd": exact.sd, "orders": orders})


@register_claim("return.together", "Section 4.1", rule="average", open=True)
def averages_together(reading: Reading) -> Finding:
    """The three averages, taken together, are those of the three policies."""
    # χ² of the squared standard errors, on three degrees of freedom.
    chances = {}
    for order in ORDERS:
        squared = 0.0
        for start, paper in AVERAGES.items():
            exact = reading.evaluate_policy(start, order)
            squared += (exact.mean - paper) ** 2 / (exact.sd**2 / EXPERIMENTS)
        tail = sqrt(2 * squared / pi) * exp(-squared / 2)
        chances[order] = erfc(sqrt(squared / 2)) + tail
    listed = ", ".join(f"{order} {format_chance(chance)}" for order, chance in chances.items())
    return judge_by_chance(
        chances[reading.order],
        f"p is the chance that three averages are as far off, with 1000 and 0100 {listed}; judged "
        f"{reading.order}, and compatible if p is {CHANCE} or more",
        details={"probability": chances},
    )


@register_claim("return.ranking", "Section 4.1", open=True)
def first_status_ranking(reading: Reading) -> Finding:
    """In status 0000 non-directive assistance is better than directive, and that better than
    supportive.
    """
    means = {}
    for order in ORDERS:
        means[order] = [reading.evaluate_policy(start, order).mean for start in AVERAGES]
    rankings = []
    for order, each in means.items():
        rankings.append(f"{order} {' > '.join(f'{mean:.2f}' for mean in each)}")
    listed = "; ".join(rankings)
    falls = all(a > b + 1e-6 for a, b in pairwise(means[reading.order]))
    why = f"exact means of {', '.join(AVERAGES)}, with 1000 and 0100 {listed}"
    return judge_statement(falls, why)


@register_claim("return.ranking.by-experiments", "Section 4.1")
def ranking_by_experiments(reading: Reading) -> Finding:
    """1,000 experiments with each policy are enough to tell this ranking."""
    means = [reading.evaluate_policy(start).mean for start in AVERAGES]
    chance = probability_of_ranking(means, [reading.standard_error(start) for start in AVERAGES])
    return judge_statement(
        chance >= NEARLY_ALL,
        f"{EXPERIMENTS:,} experiments with each policy rank them in this order with a probability "
        f"of {format_per_cent(chance)}, by the normal distribution with the exact means and "
        "variances, 1000 and 0100 as written; 95 % is enough",
        number=Estimated(value=chance, standard_error=1e-5),
        number_is="probability of this order",
    )


def probability_of_ranking(means: list[float], errors: list[float]) -> float:
    """Return P(A > B > C) for independent normal averages."""
    nodes = np.linspace(-10.0, 10.0, 4001)  # the trapezoidal rule is exact to rounding here
    middle = means[1] + errors[1] * nodes
    below_first = (means[0] - middle) / errors[0]
    above_last = (middle - means[2]) / errors[2]
    above = np.array([erfc(-x / sqrt(2)) / 2 for x in below_first])
    below = np.array([erfc(-x / sqrt(2)) / 2 for x in above_last])
    density = np.exp(-0.5 * nodes**2) / sqrt(2 * pi)
    return float((density * above * below).sum() * (nodes[1] - nodes[0]))


@register_claim("return.experiments", "Section 4.1", "Section 3.2.5", kind="input", rule="open")
def number_of_experiments(reading: Reading) -> Finding:
    """The final policies were compared by 1,000 experiments each; Section 3.2.5 says 10,000."""
    least = reading.evaluate_policy(FINAL).sd / sqrt(SETTINGS["experiments_of_a_candidate"])
    return judge_undecided(
        f"the standard error of the final policy's average is {reading.standard_error(FINAL):.2f} "
        f"with 1,000 experiments and {least:.2f} with 10,000. 1,000 are used here, which is kinder "
        "to the paper"
    )


@register_figure(
    "three_policies", title="Reported averages of three policies, and their exact means"
)
def three_policies(reading: Reading) -> Figure:
    """Exact means of the three policies, with 1 and 3 exact standard errors of 1,000 experiments,
    and the averages that the paper reports, with 1000 and 0100 as written and swapped; supportive
    in the four statuses of which the text says nothing. On the right, exact minus reported in
    standard errors: negative if the exact mean is the lower one.
    """
    fig, ax = drawing.create_axes(6.4, 4.0)
    rows = [*product(AVERAGES, ORDERS)]
    for row, (start, order) in enumerate(rows):
        exact, error = reading.evaluate_policy(start, order), reading.standard_error(start, order)
        for reach, width in ((3, 1.2), (1, 4.0)):
            ends = [exact.mean - reach * error, exact.mean + reach * error]
            ax.plot(ends, [row, row], color="0.45", lw=width, solid_capstyle="butt")
        ax.plot(exact.mean, row, "o", color="black", ms=5)
        ax.plot(AVERAGES[start], row - 0.28, "D", color="black", mfc="white", ms=6)
        apart = f"{reading.compute_deviation(start, order):+.1f} s.e.".replace("-", "−")
        ax.annotate(apart, (1.01, row), xycoords=("axes fraction", "data"), va="center")
    ax.annotate("exact minus\nreported", (1.01, 1.0), xycoords="axes fraction", va="bottom")
    optimum = reading.evaluate_policy("optimal").mean
    ax.axvline(optimum, color="black", ls=":", lw=1)
    ax.plot([], [], "o", color="black", ms=5, label="exact, ±1 and ±3 standard errors (s.e.)")
    ax.plot([], [], "D", color="black", mfc="white", ms=6, label="reported")
    ax.plot([], [], ":", color="black", label=f"optimum {optimum:.1f}")
    ax.legend(loc="upper center", bbox_to_anchor=(0.5, -0.15), ncols=3)
    ax.set_yticks(range(len(rows)), [f"{start} in 0000,\n{order}" for start, order in rows])
    ax.set(ylim=(len(rows) - 0.5, -0.6), xlabel="average return (points)")
    return fig


@register_figure("return_distributions", title="Distribution of the return")
def return_distributions(reading: Reading) -> Figure:
    """Exact distribution of an episode's return, in stretches of 10 points, under the optimal
    policy, the reported final policy (1000 and 0100 as written, supportive where the text says
    nothing) and random actions. The dashed line is the mean.
    """
    fig, panels = drawing.create_axes(6.2, 5.4, nrows=3, sharex=True, sharey=True)
    shown = {
        "optimal": "optimal policy",
        FINAL: "reported final policy",
        "random": "random actions",
    }
    for ax, (name, label) in zip(panels, shown.items(), strict=True):
        distribution = return_distribution(reading.mdp, reading.build_policy(name))
        values = np.asarray(distribution.multiples, dtype=float) * float(distribution.unit)
        bins = np.floor(values / 10) * 10
        at = np.unique(bins)
        shares = [distribution.probabilities[bins == b].sum() for b in at]
        ax.bar(at + 5, shares, width=9.4, color=BLUE)
        mean = reading.evaluate_policy(name).mean
        ax.axvline(mean, color="black", ls="--", lw=1)
        ax.set_title(
            f"{label}: mean {mean:.1f}, standard deviation {reading.evaluate_policy(name).sd:.1f}"
        )
        ax.set_ylabel("probability")
    panels[-1].set(xlabel="return of an episode (points)")
    return fig


# ---- which assistance is best --------------------------------------------------------------------

BEST = {  # statuses and the action that the text gives
    "anger": (ANGRY, "supportive"),
    "1100": (("1100",), "directive"),
    "1000": (("1000",), "directive"),
    "0100": (("0100",), "non-directive"),
    "0000": (("0000",), "non-directive"),
}


@register_claim(
    "policy.{word}",
    "Section 4.1",
    "Figure 10",
    open=True,
    each={
        "anger": "An angry person is best met with supportive assistance",
        "1100": "Forgetful and confused: directive assistance is best",
        "1000": "Forgetful only: directive assistance is best",
        "0100": "Confused only: non-directive assistance is best",
        "0000": "No status present: non-directive assistance is best",
    },
)
def best_action(reading: Reading, place: str) -> Finding:
    """{means}."""
    statuses, action = BEST[place]
    best = []
    for status in statuses:
        best.extend(list_optimal_actions(reading, status))
    right = sum(action in each for each in best)
    others = sorted(set().union(*(each for each in best if action not in each)))
    where = "anger"
    if len(statuses) == 1:
        where = "this status"
    why = f"{action} is optimal in {right or 'none'} of the {len(best)} states with {where}"
    for other in others:
        why += f", {other} in {sum(other in each for each in best)}"
    return judge_statement(
        right == len(best),
        why,
        number=Certified(value=Fraction(right, len(best))),
        number_is="share of the states where it is optimal",
    )


@register_claim("policy.respectively", "Section 4.1", "Figure 10", open=True, follows="policy.0100")
def respectively_holds(reading: Reading) -> Finding:
    """Of forgetful only and confused only, one is best met with directive and the other with
    non-directive assistance.
    """
    best = {status: list_optimal_actions(reading, status) for status in ("1000", "0100")}
    holds = False
    for pair in ORDERS.values():
        optimal = True
        for status, action in pair.items():
            optimal = optimal and all(action in each for each in best[status])
        holds = holds or optimal
    listed = ", ".join(f"{s}: {'/'.join(sorted(set().union(*each)))}" for s, each in best.items())
    return judge_statement(holds, f"optimal actions are {listed}")


@register_claim("policy.personalised", "Section 4.1", open=True, follows="policy.0100")
def assistance_is_personal(reading: Reading) -> Finding:
    """Forgetful only and confused only get different assistance, because people respond
    differently: decisions are personal.
    """
    best = [set.intersection(*list_optimal_actions(reading, status)) for status in ("1000", "0100")]
    names = ["/".join(sorted(each)) or "none" for each in best]
    return judge_statement(
        all(best) and not set.intersection(*best),
        f"the best assistance is {names[0]} if forgetful only and {names[1]} if confused only. The "
        "model has the probabilities of one person, so it compares statuses and not people",
    )


@register_claim("policy.final-is-optimal", "Section 4.1", open=True, follows="policy.0100")
def final_is_optimal(reading: Reading) -> Finding:
    """The final policy, with non-directive assistance in 0000, is optimal."""
    audits = {order: check(reading.mdp, reading.build_policy(FINAL, order)) for order in ORDERS}
    losses = []
    for order, audit in audits.items():
        loss = float(audit.regret.at_start.value)
        losses.append(f"{loss:.2f} points ({audit.relative_regret:.1%}) with 1000 and 0100 {order}")
    sentence = " and ".join(losses)
    audit, by_status = audits[reading.order], defaultdict[str, float](float)
    for each in audit.disagreements:
        by_status[reading.mdp.space.as_dict(each.state)["status"]] += each.cost
    costs = dict(sorted(by_status.items(), key=lambda item: (-item[1], item[0])))
    why = (
        f"supportive in the statuses that the text does not mention, the policy is below the "
        f"optimum by {sentence}"
    )
    if costs:
        listed = ", ".join(f"{cost:.2f} in {status}" for status, cost in costs.items())
        why += f"; {reading.order} it loses {listed}"
    number, number_is = Certified(value=Fraction(audit.regret.at_start.value)), "regret in points"
    details = {"cost_by_status": costs}
    return judge_statement(audit.passed, why, number=number, number_is=number_is, details=details)


@register_figure(
    "cost_of_choices", title="Points lost on average by each assistance in each status"
)
def cost_of_choices(reading: Reading) -> Figure:
    """Points that an episode loses on average if the robot gives one kind of assistance whenever a
    status is present, and the best assistance in all other statuses; darker cells lose more. A dot
    marks the action of the paper's final policy, with 1000 and 0100 as written, and supportive
    where the text says nothing.
    """
    from matplotlib.patches import Rectangle

    lost, policy = compute_costs(reading), reading.find_reported_policy(FINAL)
    fig, ax = drawing.create_axes(6.6, 5.8)
    shade = 1 - 0.75 * np.sqrt(lost / lost.max())
    for row, column in np.ndindex(lost.shape):
        light, loss = float(shade[row, column]), float(lost[row, column])
        ink = "white"
        if light > 0.5:
            ink = "black"
        cell = Rectangle((column, row), 1, 1, facecolor=str(light), edgecolor="0.85", lw=0.5)
        ax.add_patch(cell)
        look = {"ha": "center", "va": "center", "fontsize": 8, "color": ink}
        text, weight = format_loss(loss), "normal"
        if loss == 0:
            text, weight = "best", "bold"
        ax.text(column + 0.5, row + 0.5, text, fontweight=weight, **look)
        if policy[STATUSES[row]] == ACTIONS[column]:
            ax.plot(column + 0.12, row + 0.5, "o", color=ink, ms=4)
    ax.set(xlim=(0, len(ACTIONS)), ylim=(len(STATUSES), 0))
    ax.set_xticks(np.arange(4) + 0.5, ["none", "supportive", "non-\ndirective", "directive"])
    ax.set_yticks(
        np.arange(16) + 0.5, [f"{describe_status(status)}  {status}" for status in STATUSES]
    )
    ax.xaxis.tick_top()
    ax.tick_params(length=0)
    ax.spines[:].set_visible(False)
    ax.set_xlabel("● action of the paper's final policy, as written", loc="left")
    return fig
