"""The command for sensitivity analyses; each kind is a function named in KINDS.

A kind takes the loaded model and the options as given, and returns the result for JSON, the facts
and the tables for people. It is imported when it is asked for.
"""

from __future__ import annotations

from importlib import import_module
from types import MappingProxyType
from typing import Any

import click

from exact_mdp.analysis.cli.options import PERCEPTION_HELP, POLICY_HELP, model_options, tell_limit
from exact_mdp.analysis.cli.render import show

KINDS = MappingProxyType(
    {
        "gradient": "exact_mdp.analysis.cli.sensitivity.gradient:gradient_report",
        "tornado": "exact_mdp.analysis.cli.sensitivity.tornado:tornado_report",
        "threshold": "exact_mdp.analysis.cli.sensitivity.threshold:threshold_report",
        "psa": "exact_mdp.analysis.cli.sensitivity.psa:psa_report",
        "sobol": "exact_mdp.analysis.cli.sensitivity.global_:sobol_report",
        "morris": "exact_mdp.analysis.cli.sensitivity.global_:morris_report",
        "robust": "exact_mdp.analysis.cli.sensitivity.robust:robust_report",
        "structural": "exact_mdp.analysis.cli.sensitivity.structural:structural_report",
    }
)

DRAWN = ("psa", "sobol", "morris")
WORKED = (*DRAWN, "structural")
ONLY = MappingProxyType(
    {
        "perception": ("--perception", tuple(kind for kind in KINDS if kind != "threshold")),
        "samples": ("--samples", DRAWN),
        "seed": ("--seed", DRAWN),
        "n_jobs": ("--n-jobs", WORKED),
        "scheduler": ("--scheduler", WORKED),
        "out": ("--out", WORKED),
        "effective_sample_size": ("--effective-sample-size", ("psa",)),
        "set_kind": ("--set-kind", ("robust",)),
        "radius": ("--radius", ("robust",)),
        "combined": ("--combined", ("structural",)),
    }
)
"""Options that only some kinds have: what they are called, and the kinds."""

UNSEEING = (
    "thresholds are those of the optimum, re-optimised knowing the status; a perception makes "
    "another policy of one held fixed"
)


@click.command(short_help="Which numbers of the model decide.", epilog=POLICY_HELP)
@click.argument("model")
@click.argument("kind", type=click.Choice(list(KINDS)))
@click.option(
    "--parameter",
    "parameters",
    multiple=True,
    metavar="NAME",
    help="Only this parameter. May be repeated; all of them unless given, for sobol and morris all "
    "but the discount.",
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
    help="The policy held fixed, whose regret is told; the optimum unless given. A gradient is "
    "then the policy's.",
)
@click.option(
    "--samples",
    metavar="N",
    help="psa: draws. sobol: points of the sequence, a power of 2 (1024). morris: trajectories "
    "(64).",
)
@click.option("--seed", metavar="S", help="Seed of what is drawn (0).")
@click.option("--n-jobs", metavar="N", help="Processes; all cores unless given. Changes no result.")
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Work on a Dask cluster: tcp://HOST:PORT, or local for one on this machine.",
)
@click.option(
    "--out",
    metavar="DIR",
    help="Keep finished work and the result there, and go on from what it holds.",
)
@click.option(
    "--effective-sample-size",
    metavar="X",
    help="psa: observations that each probability is worth (100), or a .toml file that states them "
    "by name.",
)
@click.option(
    "--set-kind",
    type=click.Choice(["interval", "absolute", "l1", "kl", "entropy", "box"]),
    help="robust: what may move (interval): each probability by a share or an absolute amount, "
    "each row within a distance (l1, kl, entropy), or the tables' numbers (box).",
)
@click.option("--radius", metavar="X", help="robust: how far it may move; at most 2 for l1.")
@click.option(
    "--combined",
    is_flag=True,
    default=None,
    help="structural: every combination of the readings, not one change at a time.",
)
@click.option(
    "--perception",
    metavar="FILE",
    help=f"{PERCEPTION_HELP} The policy held fixed does; the optimum it is compared with knows the "
    "status. Exact for the probabilities as rounded to floats. Not for threshold: what changes "
    "there is the optimum, re-optimised.",
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
    psa: what draws around the tables say of value, regret and optimal actions. sobol, morris:
    which parameters decide, alone and together. robust: the worst case within sets around the
    tables. structural: the same outputs under each reading of the text.
    """
    from exact_mdp.mdp.io.load import load

    _check(kind, options)
    loaded = load(model, sets=sets, discount=discount)
    module, _, function = KINDS[kind].partition(":")
    result, facts, grids = getattr(import_module(module), function)(loaded, options)
    seen = options["perception"]
    head = {"model": loaded.name, "kind": kind, "discount": loaded.mdp.discount, "perception": seen}
    told = {"perception": f"{seen}, which the policy held fixed acts on"} if seen else {}
    facts = {"model": loaded.name, "analysis": kind} | told | facts
    tell_limit(loaded.mdp, option=False)
    show(head | result, as_json=as_json, facts=facts, grids=grids)


def _check(kind: str, options: dict[str, Any]) -> None:
    """Refuse options that the kind would ignore, and fill in the defaults of those that it has."""
    from exact_mdp.mdp.errors import ModelError

    for name, (option, kinds) in ONLY.items():
        if kind not in kinds and options[name] is not None:
            raise ModelError(
                UNSEEING if name == "perception" else f"{option} says nothing to {kind}",
                where=f"sensitivity {kind}",
                fix=f"leave it out; it belongs to {', '.join(kinds)}",
            )
    if options["seed"] is None:
        options["seed"] = "0"
    if options["out"] is not None and not options["out"].strip():
        raise ModelError("--out is empty", where="--out", fix="name a folder")
