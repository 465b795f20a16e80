"""The command for sensitivity analyses; each kind is a function named in KINDS.

A kind takes the loaded model and the options as given, and returns the result for JSON, the facts
and the tables for people. It is imported when it is asked for.
"""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import Any

import click

from analysis.cli_common import POLICY_HELP, model_options
from analysis.cli_output import show

KINDS = MappingProxyType(
    {
        "gradient": "analysis.sensitivity.report:gradient_report",
        "tornado": "analysis.sensitivity.report:tornado_report",
        "threshold": "analysis.sensitivity.report:threshold_report",
    }
)


@click.command(short_help="Which numbers of the model decide.", epilog=POLICY_HELP)
@click.argument("model")
@click.argument("kind", type=click.Choice(list(KINDS)))
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME",
    help="Only this parameter. May be repeated; all of them unless given.",
)
@click.option(
    "--range",
    "ranges",
    multiple=True,
    metavar="NAME=LOW:HIGH",
    help="Vary a parameter from LOW to HIGH. May be repeated.",
)
@click.option("--ranges", "range_file", metavar="FILE", help="Ranges: .toml, NAME = [low, high].")
@click.option("--relative", metavar="X", help="Other ranges: today's value ± this share (0.2).")
@click.option("--whole", is_flag=True, help="Other ranges: everything that a parameter may be.")
@click.option(
    "--policy",
    default="optimal",
    metavar="POLICY",
    help="The policy held fixed; the optimum unless given. A gradient is then the policy's.",
)
@model_options
def sensitivity(
    model: str,
    kind: str,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
    **options: Any,
) -> None:
    """Tell how MODEL's optimum depends on its parameters.

    gradient: derivatives and elasticities. tornado: values at both ends of each range, and the
    regret of a policy held fixed. threshold: every value at which an optimal action changes.
    """
    from mdp.load import load

    loaded = load(model, sets=sets, discount=discount)
    module, _, function = KINDS[kind].partition(":")
    result, facts, grids = getattr(import_module(module), function)(loaded, options)
    result = {"model": loaded.name, "kind": kind, "discount": loaded.mdp.discount} | result
    facts = {"model": loaded.name, "analysis": kind} | facts
    show(result, as_json=as_json, facts=facts, grids=grids)
