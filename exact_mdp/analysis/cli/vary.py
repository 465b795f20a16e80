"""The commands that vary parameters: each passes its options on to a public function."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from tqdm import tqdm

import exact_mdp
from exact_mdp.analysis.cli.given import Given
from exact_mdp.analysis.cli.words import list_command_words, pairs_of, refuse_options
from exact_mdp.analysis.vary.curves.thresholds import report_of
from exact_mdp.analysis.vary.curves.walk import find_best_average, find_optimal_pairs
from exact_mdp.analysis.vary.distributions import drawn_family
from exact_mdp.analysis.vary.ranges import (
    RELATIVE,
    Ranges,
    is_probability,
    list_usual_parameters,
    ranges_of,
    read_ranges,
)
from exact_mdp.analysis.vary.robust import SETS
from exact_mdp.analysis.vary.study import solver_of
from exact_mdp.mdp.errors import ModelError, require_known_name
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.policies.policy import PolicyLike
from exact_mdp.mdp.report import Report, Shown, list_claim_facts
from exact_mdp.mdp.table import exact, float_of
from exact_mdp.solvers.arguments import is_average

ROUNDED = "of the perception, and the probabilities of actions that it makes, as rounded to floats"
"""Qualifies a certified number under a perception: a file may state 1/3, which is not a float."""
ROWS = {  # the rows in each kind of set
    "interval": "each transition probability ± {} of itself, rows on their own",
    "l1": "rows within an L1 distance of {}, on their own",
    "kl": "rows that keep the tables likely, KL(p‖q) ≤ {}, on their own",
}
BOX = "box"


# ---- one parameter at a time ---------------------------------------------------------------------


def tornado_command(given: Given, *, against: str | None = None) -> Report:
    """Compute values at both ends of each parameter's range.

    One parameter moves at a time, the others stay at today's values.

    Example: exact-mdp tornado yuan2025 --relative 1/10
    Example: exact-mdp tornado tea --range base.anxiety=0.05:0.2 --policy random

    Parameters
    ----------
    against : POLICY, optional
        Show the value of the policy held fixed less the value of this one.

    Keys
    ----
    difference: value of the policy held fixed less the value of the other one;
    bars: each parameter with both ends of its range, both values, both regrets; policy_value: the
    value of the policy held fixed; regret: its loss against the optimum.
    """
    spans, without = _select_ranges(given)
    other = None if against is None else given.policy_from(against)
    result = exact_mdp.tornado(
        given.family, names=list(spans), ranges=spans, against=other, **given.held
    )
    # its effect on the policy
    by = None
    if given.perception and other is None:
        by = "fixed_swing"
    return _report_with_policy(given, "tornado", result.report(by), without_range=without)


def gradient_command(given: Given) -> Report:
    """Compute the derivative of the value for each parameter.

    The value is the optimum, or the value of the --policy held fixed. If the optimal policy changes
    at today's value, both one-sided derivatives are given.

    Example: exact-mdp gradient tea --parameter base.anxiety

    Keys
    ----
    derivatives: {parameter: derivative of the value}; exact_derivatives: the derivatives, "p/q";
    elasticities: per cent of the value for one per cent of the parameter; left: the derivative from
    the left; right: the derivative from the right, which differs where two policies are optimal.
    """
    held = {"policy": given.fixed, "criterion": given.criterion}
    result = exact_mdp.gradient(given.family, names=given.parameters or None, **held)
    more = {}
    if given.perception:
        more = {"claim_of": ROUNDED}
    return _report_with_policy(given, "gradient", result.report(), **more)


def threshold_command(given: Given) -> Report:
    """Find where an optimal action changes along a parameter.

    One parameter moves at a time. At every value the policy knows the state and is optimal.

    Example: exact-mdp threshold yuan2025 --parameter base.anger --relative whole

    Keys
    ----
    switches: each value at which an optimal action changes, and where; stable: for each parameter,
    the range around today's value without a change.
    """
    names = None
    if is_average(given.criterion):
        names = _choose_parameters(given)  # an average does not depend on the discount
    spans, without = _select_ranges(given, names)
    steps = tqdm(spans, desc="thresholds", disable=None, leave=False)
    results = {}
    for name in steps:
        results[name] = exact_mdp.thresholds(given.family, name, spans, criterion=given.criterion)
    start, report = _prove_start_value(given), report_of(results)
    return given.complete_report(report, kind="threshold", **start, without_range=without)


def curve_command(
    given: Given,
    *,
    parameters: Sequence[str] = (),
    max_regret: str | None = None,
    max_relative_regret: str | None = None,
) -> Report:
    """Compute the optimum as an exact function of a parameter.

    With --max-regret, also find the values at which the policy held fixed keeps within that limit.
    The parameter moves over all its possible values, unless it is given a range.

    Example: exact-mdp curve yuan2025 --parameter reward.trial --range reward.trial=-3:-1

    Parameters
    ----------
    parameters : NAME, once
        The parameter that moves.
    max_regret : X, optional
        Find where the policy loses at most X: 0.1 or 1/10.
    max_relative_regret : X, optional
        Find where its regret over the absolute optimal value is at most X.

    Keys
    ----
    parameter: the parameter that varies; pieces: {from, to, numerator, denominator, policy}, where
    the value is a ratio of polynomials with coefficients "p/q", from the constant up; within: the
    intervals in which the policy keeps the limit.
    """
    (name,) = _require_parameter_count(parameters, 1, "curve")
    if given.ranges or given.relative:
        spans = _select_ranges(given, [name])[0]
    else:
        spans = None
    limited = max_regret or max_relative_regret
    held = {"policy": given.fixed if limited else given.taken, "criterion": given.criterion}
    result = exact_mdp.curve(given.family, name, spans, **held)
    if limited:
        within = result.within(max_regret, max_relative_regret)
    else:
        within = None
    start = _prove_start_value(given)
    return given.complete_report(result.report(within), kind="curve", **start)


def one_way_command(given: Given, *, parameters: Sequence[str] = (), points: int = 21) -> Report:
    """Compute values along the range of one parameter.

    At each value there are two results: for the optimal policy, and for the policy held fixed.

    Example: exact-mdp one-way tea --parameter base.anxiety --points 11

    Parameters
    ----------
    parameters : NAME, once
        The parameter that moves.
    points : N, 2 to 10000
        Values along each range, ends included.

    Keys
    ----
    parameter: the parameter that varies; points: points with their values.
    """
    (name,) = _require_parameter_count(parameters, 1, "one-way")
    spans, _ = _select_ranges(given, [name])
    result = exact_mdp.one_way(given.family, name, spans, points=points, **given.held)
    return _report_with_policy(given, "one-way", result.report(), **_claim_start_value(given))


def two_way_command(given: Given, *, parameters: Sequence[str] = (), points: int = 11) -> Report:
    """Compute values and best policies over two parameters.

    Give --parameter twice: the first lies across, the second along.

    Example: exact-mdp two-way tea --parameter base.anxiety --parameter discount

    Parameters
    ----------
    parameters : NAME
        A parameter that moves.

    Keys
    ----
    parameters: the parameters that vary; points: points with their values; policies: the policies
    that are optimal somewhere.
    """
    x, y = _require_parameter_count(parameters, 2, "two-way")
    spans, _ = _select_ranges(given, [x, y])
    result = exact_mdp.two_way(given.family, x, y, ranges=spans, points=points, **given.held)
    return _report_with_policy(given, "two-way", result.report(), **_claim_start_value(given))


# ---- all parameters at once ----------------------------------------------------------------------


def psa_command(
    given: Given,
    *,
    samples: int | None = None,
    uncertain: str | None = None,
    effective_sample_size: str | None = None,
    seed: int = 0,
    n_jobs: int | None = None,
    out: str | None = None,
) -> Report:
    """Draw the parameters from distributions, to see what a policy risks.

    The policy held fixed is judged by the probability that it loses at most a given amount, and by
    the value of better numbers (EVPI, EVPPI).

    Example: exact-mdp psa yuan2025 --samples 1000 --effective-sample-size 50

    Parameters
    ----------
    samples : N, 1 to 100000000
        Draws: 10000 unless given, 500 for slow models.
    uncertain : FILE, optional
        A .toml file with distributions by name.
    effective_sample_size : X, optional
        Number of observations behind each probability without a stated distribution, 100 unless
        given.
    seed : S
        Seed of the draws.
    n_jobs : N, 1 to 1024
        Number of processes, all cores unless given. Results do not change.
    out : DIR, optional
        Folder for finished work and the result; work that is there already is not repeated.

    Keys
    ----
    Of PSA.
    draws: number of draws; drawn: distribution of each parameter that is drawn; fixed: why each
    other parameter is not drawn; assumed: the drawn parameters without a stated distribution;
    effective_sample_size: observations behind each probability;
    value: optimal value over the draws; regret: regret of the policy held fixed, over the draws;
    acceptability: probability that the fixed policy loses at most each tolerance; candidates: the
    policies that were optimal in some draw; p_optimal: how often each action is optimal, status by
    status; evpi: expected value of perfect information; evpi_bounds: lower and upper estimates,
    without the bias of the sample; evpi_of_candidates: EVPI if only the candidates can be chosen;
    evppi: expected value of knowing each parameter alone; evppi_details: how
    each `evppi` was estimated.
    """
    plain = given.loaded.scenario is None
    if plain:
        model = drawn_family(given.mdp)
    else:
        model = given.family
    size, names = None, given.parameters or None
    if effective_sample_size is not None:
        size = float_of(effective_sample_size, "--effective-sample-size")
    chosen = exact_mdp.uncertainty(model, uncertain, default=size, names=names)
    n = samples or (10_000 if solver_of(model, (), given.criterion).compiled else 500)
    how = _read_work_options(n_jobs, out) | given.held
    result = exact_mdp.psa(model, n, rng=seed, uncertain=chosen, **how)
    report = result.report(given.policy or "optimal", evppi=True)
    report = _report_with_policy(given, "psa", report, effective_sample_size=chosen.default)
    return given.save_report(report, out, "psa.json", ("psa", seed))


def sobol_command(
    given: Given,
    *,
    samples: int = 1024,
    seed: int = 0,
    n_jobs: int | None = None,
    out: str | None = None,
) -> Report:
    """Compute which parameters decide the value (Sobol indices).

    First-order and total indices of Sobol, with intervals, for the optimum and a policy's regret.
    All parameters but the discount vary unless some are named.

    Example: exact-mdp sobol tea --samples 256

    Parameters
    ----------
    samples : N, 2 to 16777216
        Points of the sequence, a power of 2.

    Keys
    ----
    samples: points of the sequence; draws: number of models solved; ranges: the range of each
    parameter; confidence: the confidence of the intervals; mean: mean of the optimal value over the
    draws; sd: standard deviation of the optimal value over the draws; first_order: share of the
    variance that a parameter explains alone; first_order_interval: interval of `first_order`;
    total: share of the variance including all interactions with others; total_interval: interval of
    `total`; regret: these indices for the regret of a policy held fixed.
    """
    spans, without = _select_ranges(given, _choose_parameters(given))
    if not spans:
        raise ModelError(
            "every chosen parameter is 0, and a share of 0 gives no range",
            where=f"sobol of {given.loaded.name}",
            fix="give a range: --range NAME=LOW:HIGH",
        )
    how = _read_work_options(n_jobs, out) | given.held | {"n": samples, "rng": seed}
    result = exact_mdp.sobol(given.family, names=list(spans), ranges=spans, **how)
    report = _report_with_policy(
        given, "sobol", result.report(), **_claim_start_value(given), without_range=without
    )
    return given.save_report(report, out, "sobol.json", ("sobol", seed))


# ---- the worst case ------------------------------------------------------------------------------


def robust_command(
    given: Given, *, set_kind: str = "interval", radius: str | None = None
) -> Report:
    """Compute the worst case within sets around the tables.

    Also find the policy that is best in the worst case, and its price if the tables are right.
    Parameters and ranges are only for a box.

    Example: exact-mdp robust tea --set-kind l1 --radius 0.1

    Parameters
    ----------
    set_kind : "interval", "l1", "kl" or "box"
        What may move: each probability by a share, each row within a distance (l1, kl), or the
        tables' numbers (box).
    radius : X, optional
        How far a row may move (interval, l1, kl).

    Keys
    ----
    set_kind: what may move; radius: how far a row may move; nature: who chooses the probabilities,
    and when; worst_case: optimal value in the worst case, with its policy, or for `box`, the value
    of the fixed policy at the worst point found, `point`; best_case: the optimal value in the best
    case; worst_case_gain: gain of the robust policy in the worst case; robust_policy_value: value
    of the robust policy if the tables are right; price_of_robustness: loss of the robust policy if
    the tables are right (like the gain, null if both values are infinite); policy_changes: states
    in which the robust policy acts differently.
    """
    boxed = {"--parameter": given.parameters, "--range": given.ranges, "--relative": given.relative}
    if set_kind == BOX:
        refuse_options(
            {"--radius": radius}, "a box", "give --relative X or --range NAME=LOW:HIGH instead"
        )
        return _report_worst_point(given, any(boxed.values()))
    meaning = ROWS[require_known_name(set_kind, [*ROWS, BOX], "set", "--set-kind")]
    refuse_options(boxed, "rows on their own", "add --set-kind box, or give --radius instead")
    size = exact(SETS[set_kind][1] if radius is None else radius, "radius")
    result = exact_mdp.robust(given.mdp, set_kind, radius=size, **given.held)
    kind = Shown(set_kind, meaning.format(f"{float(size):.4g}"))
    return _report_with_policy(given, "robust", result.report(), set_kind=kind, radius=float(size))


def _report_worst_point(given: Given, stated: bool) -> Report:
    """Return the worst point that is found for the policy over one shared box of parameters."""
    family = given.family
    chances = [each.name for each in family.parameters if is_probability(each)]
    box, _ = _select_ranges(given, _choose_parameters(given) if stated else chances)
    if not box:
        raise ModelError(
            "no parameter moves: only probabilities other than 0 do so without being named",
            where="--set-kind box",
            fix="name what moves (--parameter NAME, --range NAME=LOW:HIGH), or choose another kind "
            "of set",
        )
    criterion = given.criterion
    report = exact_mdp.worst_point(family, given.fixed, box, criterion=criterion).report()
    today = exact_mdp.evaluate(given.mdp, given.fixed, criterion=criterion)
    start = list_claim_facts("start_value", today.start)
    ends = {name: [float(span.low), float(span.high)] for name, span in box.items()}
    if stated:
        radius = None
    else:
        radius = float(RELATIVE)
    more = {"set_kind": BOX, "radius": radius, "box": Shown(ends)}
    return _report_with_policy(given, "robust", report, **start, **more)


# ---- the page ------------------------------------------------------------------------------------


def explore_command(
    given: Given,
    policy: PolicyLike | None = None,
    *,
    parameters: Sequence[str],
    html: str,
    points: int = 11,
) -> Report:
    """Write a page on which a parameter moves, and the optimum with it.

    The pieces between the switching points are worked out beforehand, in rational arithmetic, so
    that the page needs no server and shows exact values; it says which of them are certified.

    Example: exact-mdp explore yuan2025 --parameter base.anger --html page.html

    Parameters
    ----------
    parameters : NAME
        The parameter that moves. A second one moves in steps.
    html : FILE, .html
        Write the page: .html.
    points : N, 2 to 101
        Values of the second parameter.

    Keys
    ----
    parameters: parameters that move; pieces: number of pieces on the page.
    """
    spans, _ = _select_ranges(given, parameters)
    held: dict[str, Any] = {"policy": policy, "criterion": given.criterion}
    page = exact_mdp.explore(given.family, *parameters, ranges=spans, n=points, **held)
    page = replace(page, model=given.loaded.name, policy=given.policy)
    write_atomically(html, page.page(rerun=shlex.join(["exact-mdp", *list_command_words()])))
    return given.complete_report(page.report(), written=html)


# ---- what the options say ------------------------------------------------------------------------


def _report_with_policy(given: Given, kind: str, report: Report, **more: Any) -> Report:
    """Return a report with the policy held fixed."""
    return given.complete_report(report, kind=kind, policy=given.policy or "optimal", **more)


def _require_parameter_count(parameters: Sequence[str], count: int, kind: str) -> Sequence[str]:
    if len(parameters) != count:
        raise ModelError(
            f"{len(parameters)} parameters, and {kind} varies {count}",
            where="--parameter",
            fix=f"give --parameter NAME {'once' if count == 1 else 'twice'}; `exact-mdp gradient "
            "MODEL` lists the names",
        )
    return parameters


def _prove_start_value(given: Given) -> dict[str, Any]:
    find_best = find_best_average if is_average(given.criterion) else find_optimal_pairs
    return list_claim_facts("start_value", find_best(given.family.at({}))[1])


def _claim_start_value(given: Given) -> dict[str, Any]:
    best = exact_mdp.solve(given.mdp, criterion=given.criterion)
    return list_claim_facts("start_value", best.start)


def _select_ranges(given: Given, names: Sequence[str] | None = None) -> tuple[Ranges, list[str]]:
    """Return the ranges of the parameters that the options name, or of `names`, and who has none.

    A parameter that is 0 today has none, since 20 % of 0 is 0.
    """
    model, stated = given.family, Ranges()
    files = [each for each in given.ranges if each.lower().endswith(".toml") and "=" not in each]
    texts = [each for each in given.ranges if each not in files]
    pairs = pairs_of(texts, "--range", "NAME=LOW:HIGH")
    typed: dict[str, object] = {name: ends.split(":") for name, ends in pairs.items()}
    sources: list[Any] = [*files, typed]
    for source in sources:
        more = read_ranges(model, source)
        for name in sorted(more.keys() & stated.keys()):
            raise ModelError(f"the range of {name} is given twice", where="--range", fix="give one")
        stated.update(more)
    if names is None:
        names = given.parameters or None
    every = ranges_of(model, names, stated, given.relative)
    spans = Ranges({name: span for name, span in every.items() if span.low < span.high})
    return spans, sorted(every.keys() - spans.keys())


def _choose_parameters(given: Given) -> Sequence[str] | None:
    """Return the parameters to vary together if none is named."""
    if given.parameters or given.ranges:
        return None
    return list_usual_parameters(given.family)


def _read_work_options(n_jobs: int | None, out: str | None) -> dict[str, Any]:
    if out is not None and not out.strip():
        raise ModelError("--out is empty", where="--out", fix="name a folder")
    return {"n_jobs": n_jobs, "folder": out, "progress": True}
