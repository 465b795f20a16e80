"""The commands of trade-offs: fronts, weights that make a policy optimal, risk, perception."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import exact_mdp
from exact_mdp.analysis.cli.given import Given
from exact_mdp.analysis.cli.words import pairs_of, refuse_options
from exact_mdp.mdp.care.perception import read_confusion_matrix, status_names
from exact_mdp.mdp.errors import ModelError, require_known_name
from exact_mdp.mdp.io.files import read_text, write_atomically
from exact_mdp.mdp.io.structured import csv_of, require_column_names
from exact_mdp.mdp.policies.policy import Policy
from exact_mdp.mdp.report import Report, Table
from exact_mdp.mdp.result import DataFrame, data_frame
from exact_mdp.mdp.table import float_of
from exact_mdp.solvers.arguments import is_average
from exact_mdp.solvers.values.policy_chain import policy_of


def tradeoff_command(
    given: Given,
    names: Sequence[str],
    *,
    policies: Sequence[str] = (),
    certificate: str | None = None,
) -> Report:
    """Compute the exact front of two or three expected totals.

    Each is a component of the reward, steps, an event, a label that is not left again, or a sum:
    name=2*a-b, or saved=-cost where less is better. The front maximises all of them; in a model of
    costs it minimises them.

    Example: exact-mdp tradeoff yuan2025 anger subtask-complete --set tasks=[1]

    Parameters
    ----------
    names : "A B [C]"
    policies : POLICY, optional
        A policy to compare with the front, by its distance from it.
    certificate : FILE, .json
        Write the proof for `verify`: .json.

    Keys
    ----
    Of Front.
    names: the totals, in the order in which they were named; vertices: {values, policy} of each
    vertex of the front; edges: {from, to, rate}, the rate being the price of one total in terms of
    the other; policies: each policy with its values and its distance.
    """
    beside = {form: given.policy_from(form) for form in policies}  # before the work
    if is_average(given.criterion):
        refused = {"--certificate": certificate}
        refuse_options(refused, "averages", "leave it out: the proof is about another model")
    front = exact_mdp.tradeoff(given.mdp, names, criterion=given.criterion)
    if certificate:
        front.save(certificate)
    report = front.report(beside)
    return given.complete_report(report, written=[certificate] if certificate else [])


def rationalize_command(given: Given, policy: Policy) -> Report:
    """Find the least change of weights that makes a policy optimal.

    The answer is the least relative change of the weights, exactly, with its proof; and for each
    component the interval in which changing its weight alone is enough. Multipliers apply to
    today's weights. A change of 1 can make all weights zero: no smaller change makes the policy
    optimal.

    Example: exact-mdp rationalize tea random --set tasks=[1]

    Keys
    ----
    Of Rationalization.
    change: the least relative change of the weights, "p/q".
    """
    found = exact_mdp.rationalize(given.mdp, policy, criterion=given.criterion)
    return given.complete_report(found.report())


def ce_command(
    given: Given,
    *,
    strategies: Sequence[str] = (),
    effect: str = "qaly",
    cost: str = "cost",
    draws: str | None = None,
    uncertain: str | None = None,
    samples: int | None = None,
    reference: str | None = None,
    seed: int = 0,
) -> Report:
    """Compare strategies by cost and effect: ICERs, acceptability, value of information.

    A strategy is a policy held fixed. If nothing is drawn, the result is the base case, with the
    values of today.

    Example: exact-mdp ce care.npz --strategy usual=always:none --strategy new=always:treat

    Parameters
    ----------
    strategies : NAME=POLICY
        A strategy.
    effect : NAME
        The component of the reward that is the effect.
    cost : NAME
        The component that is the cost.
    draws : FILE, optional
        A .csv with a column for each parameter and a row for each draw.
    uncertain : FILE, optional
        A .toml file with distributions by name, also of parameters that --draws does not have.
    samples : N, 1 to 100000000
        Draws: all rows of --draws unless given.
    reference : NAME, optional
        Compare with this strategy, not with the one before on the efficient frontier.
    seed : S
        Seed of the draws.

    Keys
    ----
    Of CostEffectiveness.
    draws: number of draws; effect: the component that is the effect; cost: the component that is
    the cost; drawn: distribution of each parameter that is drawn; fixed: why each other parameter
    is not drawn; assumed: the drawn parameters without a stated distribution; strategies: names of
    the strategies; icers: {strategy, cost, effect, incremental cost, incremental effect, ICER,
    status, by} of each; willingness_to_pay: prices of a unit of effect; acceptability: share of
    draws in which each strategy is the best, by price; evpi: expected value of perfect information,
    by price.
    """
    named = pairs_of(strategies, "--strategy", "NAME=POLICY")
    if not named:
        fix = "write --strategy usual=always:none --strategy new=FILE"
        raise ModelError("there is no strategy", where="--strategy", fix=fix)
    held = {name: given.policy_from(form) for name, form in named.items()}
    if reference is not None:
        require_known_name(reference, held, "strategy", "--reference")
    stated: Any = uncertain
    if draws is not None:
        table = _read_draws(draws)
        stated = table if uncertain is None else [table, uncertain]
    model = given.mdp if given.loaded.scenario is None else given.family
    how: dict[str, Any] = {"effect": effect, "cost": cost, "uncertain": stated, "rng": seed}
    return given.complete_report(
        exact_mdp.cost_effectiveness(model, held, samples, **how).report(reference)
    )


def _read_draws(path: str) -> DataFrame:
    """Return the table of a .csv file, whose numbers are exact texts."""
    rows = csv_of(read_text(path).splitlines(), path)
    _, names = next(rows, (0, []))
    require_column_names(names, path)
    return data_frame([row for _, row in rows], columns=names)


def risk_command(
    given: Given, *, cvar: str, policies: Sequence[str] = (), policy_out: str | None = None
) -> Report:
    """Find the best policy for the worst share of the episodes.

    MODEL has discount 1 and no cycles, or a horizon. The answer is the policy with the greatest
    mean of the worst episodes, which remembers the reward so far. In a model of costs it has the
    least mean.

    Example: exact-mdp risk yuan2025 --cvar 1/10 --set tasks=[1]

    Parameters
    ----------
    cvar : SHARE
        The mean return of this share of the episodes, the worst: 0.1 or 1/10.
    policies : POLICY, optional
        A policy to compare with the best one.
    policy_out : FILE, .csv or .json
        Write the policy: .csv or .json; by state and reward so far.

    Keys
    ----
    Of CVaROptimum.
    level: the share of the worst episodes; measure: `cvar`; value: the value of the best policy;
    mean: expected return of the best policy; threshold: the return below which an episode is among
    the worst; distribution: {return: probability}; policies: each policy given, with its values.
    """
    named = {form: given.policy_from(form) for form in policies}  # before the work
    report = exact_mdp.best_cvar(given.mdp, cvar).report()
    beside = list[dict[str, Any]]()
    for form, policy in named.items():
        distribution = exact_mdp.return_distribution(given.mdp, policy, exact=True)
        tail = distribution.tail_mean(cvar, highest=given.mdp.sense.costs)
        beside.append({"policy": form, "mean": distribution.tail_mean(1), "cvar": tail})
    table = Table(
        title="the policies beside it",
        columns={"policy": "policy", "mean": "mean:.10g", "of the worst": "cvar:.10g"},
    )
    facts, tables = {**report.facts, "policies": beside}, {"policies": table, **report.tables}
    report = replace(report, facts=facts, tables=tables)
    if policy_out:  # its actions by state and reward so far, exactly
        rules = []
        for rule in report.facts["policy"]:
            rules.append({k: str(value) for k, value in rule.items()})
        content = json.dumps(rules, indent=2, ensure_ascii=False) + "\n"
        if not policy_out.lower().endswith(".json"):
            table = data_frame(rules, columns=["state", "from", "to", "action"])
            content = table.to_csv(index=False, lineterminator="\n")
        write_atomically(policy_out, content)
    return given.complete_report(report, written=[policy_out] if policy_out else [])


# ---- perception ----------------------------------------------------------------------------------


def perception_command(
    given: Given,
    *,
    perception: str | None = None,
    accuracy: str | None = None,
    policy: str = "optimal",
) -> Report:
    """Compute the cost of errors of perception.

    The value if the policy knows the status, the value if it takes the perceived status for true,
    and the errors that cost most.

    Example: exact-mdp perception yuan2025 --accuracy 0.9

    Parameters
    ----------
    perception : FILE, optional
        A file: {formats:PERCEPTIONS}.
    accuracy : X, optional
        Instead of a file: the probability with which each status is perceived correctly.
    policy : POLICY
        The policy that takes the perceived status for true.

    Keys
    ----
    perfect: the value if the status is known; taken_as_true: the value if the perceived status is
    taken for true; errors: cost of each kind of error; confusions: cost of taking one status for
    another; counted: number of examples, if the file holds them.
    """
    mdp, counted = given.mdp, None
    if (perception is None) == (accuracy is None):
        what = "no perception, or two of them"
        raise ModelError(what, where="options", fix="give --perception or --accuracy")
    if perception is None:
        right = float_of(accuracy, "accuracy")
        if not 0 <= right <= 1:
            raise ModelError(f"accuracy is {right}", where="accuracy", fix="choose from 0 to 1")
        rates = [right] * len(status_names(mdp))
        matrix = exact_mdp.independent(rates, rates)
    else:
        matrix, counted = read_confusion_matrix(perception, mdp)
    optimum = exact_mdp.solve(mdp)
    chosen = policy_of(mdp, optimum if policy == "optimal" else policy)
    costs = exact_mdp.error_costs(mdp, chosen, matrix)
    return given.complete_report(
        costs.report(),
        policy=policy,
        perception=perception or f"accuracy {accuracy}",
        perfect=optimum.start,
        taken_as_true=costs.value,
        counted=counted,
    )
