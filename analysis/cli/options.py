"""What the commands share: the options that name a model, and reading model and policy."""

from __future__ import annotations

import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

if TYPE_CHECKING:
    from exact_mdp.mdp.io.load import Loaded
    from exact_mdp.mdp.model import MDP
    from exact_mdp.mdp.policies.policy import Policy, PolicyLike

Function = TypeVar("Function", bound=Callable[..., Any])

POLICY_HELP = """POLICY is optimal, random, always:ACTION, or a file: .json {"0000": "none", ...};
.csv with the header status,action; .npy or .npz with a Q-table or with probabilities of actions
(--kind q, --kind policy; auto takes an array for probabilities where every row that counts is a
distribution, and refuses it where its greedy policy would be another one)."""


def model_options(function: Function) -> Function:
    """Add `--set`, `--discount` and `--json` to a command."""
    for option in (
        click.option("--json", "as_json", is_flag=True, help="Print one JSON object."),
        click.option(
            "--discount", metavar="G", help="Discount instead of the model's own: 0.95 or 19/20."
        ),
        click.option(
            "--set",
            "sets",
            multiple=True,
            metavar="KEY=VALUE",
            help="Change a scenario: base.anger=1/10, tasks=[3,1], readings.NAME=OPTION. "
            "May be repeated.",
        ),
    ):
        function = option(function)
    return function


PERCEPTION_HELP = (
    "The policy acts on a perceived status: a confusion matrix as .csv, or .toml with sensitivity "
    "and specificity, or labelled examples (.csv true,perceived; .jsonl)."
)

perception_option = click.option("--perception", metavar="FILE", help=PERCEPTION_HELP)


kind_option = click.option(
    "--kind",
    default="auto",
    metavar="q|policy|auto",
    help="What a .npy or .npz file holds: a Q-table, or probabilities of actions.",
)


horizon_option = click.option(
    "--horizon", metavar="N", help="Stop every episode after N steps, without a further reward."
)

MOST_STEPS = 10**9


def stopped(loaded: Loaded, horizon: str | None) -> tuple[Loaded, int | None]:
    """Return the model of episodes that stop after the steps that an option states, and these."""
    if horizon is None:
        return loaded, None
    steps = whole_of(horizon, "--horizon", 1, MOST_STEPS)
    return replace(loaded, mdp=loaded.mdp.within(steps)), steps


def tell_limit(mdp: MDP, *, option: bool = True) -> None:
    """Say on standard error that an answer leaves the environment's time limit out, if it does.

    Parameters
    ----------
    option : bool
        Whether the command takes `--horizon`.
    """
    if mdp.time_limit is not None:
        also = f": --horizon {mdp.time_limit}" if option else ""
        print(
            f"note: the environment stops after {mdp.time_limit:,} steps; this answer is for "
            f"episodes without a limit{also}",
            file=sys.stderr,
        )


def policy_of(mdp: MDP, form: str, perception: str | None = None, *, kind: str = "auto") -> Policy:
    """Return the policy that a command names, acting on what is perceived where that is given.

    The optimum is solved for; under a perception it is the optimum of whoever sees the truth.
    """
    from exact_mdp.mdp.policies.policy import Policy

    given: PolicyLike = form
    if form == "optimal":
        from exact_mdp.solvers import solve

        given = solve(mdp)
    found = Policy.of(mdp, given, kind=kind)
    if perception is None:
        return found
    from exact_mdp.mdp.care.perception import perceived, read

    return replace(perceived(mdp, found, read(perception, mdp)), source=found.source)


def read_as(found: Policy) -> dict[str, str]:
    """Return the first line of the output: what an array was taken for, where there was one."""
    return {"read as": found.source} if found.source else {}


def float_of(text: str | None, option: str) -> float | None:
    """Return the number that an option states, as a float; None where it is left out."""
    if text is None:
        return None
    from exact_mdp.mdp.errors import ModelError
    from exact_mdp.mdp.table import exact

    try:
        return float(exact(text))
    except ModelError as error:
        raise ModelError(error.what, where=option, fix=error.fix) from error
    except OverflowError as error:
        raise ModelError("too large for a float", where=option, fix="choose less") from error


def check_outputs(*files: tuple[str | None, tuple[str, ...]]) -> None:
    """Raise ModelError, before any work, where a file could not be written.

    Parameters
    ----------
    *files : (path or None, allowed endings)
    """
    from exact_mdp.mdp.errors import ModelError

    taken = []
    for name, endings in files:
        if name is None:
            continue
        path = Path(name)
        if path.suffix.lower() not in endings:
            raise ModelError(
                f"cannot write {path.suffix or 'a file without ending'} here",
                where=name,
                fix=f"name it {' or '.join(endings)}",
            )
        if not path.parent.is_dir():
            raise ModelError("there is no such folder", where=str(path.parent), fix="make it first")
        if path.resolve() in taken:
            raise ModelError("two results go to one file", where=name, fix="name another file")
        taken.append(path.resolve())


def whole_of(text: str, option: str, least: int = 0, most: int = 10**18) -> int:
    """Return the whole number that an option states."""
    from exact_mdp.mdp.errors import ModelError

    if text.isascii() and text.isdigit() and len(text) < 20 and least <= int(text) <= most:
        return int(text)
    raise ModelError(
        f"{text!r} is not a whole number from {least} to {most:,}",
        where=option,
        fix="choose one in that range",
    )
