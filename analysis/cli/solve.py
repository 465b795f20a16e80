"""The command that finds an optimum, and what it shows and saves of it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, cast

import click

from exact_mdp.analysis.cli.options import (
    check_outputs,
    float_of,
    horizon_option,
    model_options,
    stopped,
    tell_limit,
)
from exact_mdp.analysis.cli.render import Grid, at_most, number, ratio, show

if TYPE_CHECKING:
    from exact_mdp.analysis.optimum import Optimum
    from exact_mdp.mdp.io.load import Loaded
    from exact_mdp.mdp.model import MDP
    from exact_mdp.mdp.space import StateSpace

LISTED_STATES = 1000  # longer policies are left to --policy-out and --out
SHOWN_DIGITS = 1000  # longer exact values are left to --json


@click.command(short_help="Optimal value and policy, with a bound or a proof.")
@click.argument("model")
@model_options
@horizon_option
@click.option(
    "--method",
    default="auto",
    metavar="NAME",
    help="value-iteration, gauss-seidel, modified-policy-iteration, policy-iteration, "
    "backward-induction, linear-program or auto (the default).",
)
@click.option("--tol", metavar="X", help="Greatest absolute error of a value.")
@click.option("--certify", is_flag=True, help="Compute and prove the exact optimum.")
@click.option(
    "--operator",
    is_flag=True,
    help="Solve a scenario without its matrix, by backward induction: for large ones.",
)
@click.option("--policy-out", metavar="FILE", help="Write the policy: .csv or .json.")
@click.option("--out", metavar="FILE", help="Write values, policy and action values: .npz.")
@click.option(
    "--certificate",
    metavar="FILE",
    help="Write a proof for `verify`: .json; of the exact values with --certify, else of bounds.",
)
def solve(
    model: str,
    sets: tuple[str, ...],
    discount: str | None,
    as_json: bool,
    horizon: str | None,
    method: str,
    tol: str | None,
    certify: bool,
    operator: bool,
    policy_out: str | None,
    out: str | None,
    certificate: str | None,
) -> None:
    """Find an optimal policy of MODEL and its value, with an error bound that is sound.

    With --certify the optimum is also computed in rational arithmetic, and proved. Whether it is
    stationary is left out where the bounds without it leave that open. With --operator
    whether the optimum is stationary is left open, and no model hash is recorded. With --horizon
    the optimum is that of episodes that stop, whose policy depends on the time.
    """
    from exact_mdp.analysis.cli.save import save
    from exact_mdp.analysis.optimum import optimum
    from exact_mdp.mdp.io.load import load
    from exact_mdp.mdp.model import MDP

    endings = ((policy_out, (".csv", ".json")), (out, (".npz",)), (certificate, (".json",)))
    check_outputs(*endings)
    if operator:
        others = {"--certify": certify, "--certificate": certificate, "--horizon": horizon}
        method = _by_operator(method, others)
        loaded, steps = _as_operator(model, sets, discount), None
    else:
        loaded, steps = stopped(load(model, sets=sets, discount=discount), horizon)
    found = optimum(loaded.mdp, method, float_of(tol, "--tol"), certify=certify)
    written = save(loaded, found, policy_out, out, certificate)
    result = _result(loaded, found) | {"horizon": steps, "written": written}
    if isinstance(loaded.mdp, MDP):
        tell_limit(loaded.mdp)
    show(result, as_json=as_json, facts=_facts(result), grids=_grids(result, loaded))


def _by_operator(method: str, others: dict[str, object]) -> str:
    """Return the method for an operator; raises ModelError where options ask for a matrix."""
    from exact_mdp.mdp.errors import ModelError
    from exact_mdp.solvers import SOLVERS

    wanted = [name for name, value in others.items() if value]
    if method in SOLVERS and method != "backward-induction":
        wanted.append(f"--method {method}")
    if wanted:
        raise ModelError(
            f"{wanted[0]} needs the explicit model",
            where="--operator",
            fix=f"leave out {wanted[0]}, or --operator",
        )
    return "backward-induction" if method == "auto" else method


def _as_operator(model: str, sets: tuple[str, ...], discount: str | None) -> Loaded:
    from exact_mdp.mdp.io.load import Loaded, load_scenario

    scenario = load_scenario(model, sets=sets, discount=discount)
    # What follows reads of a model only what operators have too.
    mdp = cast("MDP", scenario.operator())
    return Loaded(name=scenario.name, mdp=mdp, scenario=scenario)


def _result(loaded: Loaded, found: Optimum) -> dict[str, Any]:
    from exact_mdp.mdp.model import MDP

    mdp, proof, solution = loaded.mdp, found.certificate, found.solution
    result: dict[str, Any] = {
        "model": loaded.name,
        "method": found.method,
        "discount": mdp.discount,
        "claim": found.claim,
        "start_value": found.start_value,
        "error_bound": found.error_bound,
        "exact_start_value": proof.start_value if proof else None,
        "unique": proof.unique if proof else None,
        "policy": None,
        "policy_by_state": None,
        "stationary": None,
        "regret_bound": solution.regret_bound if solution and not proof else 0.0,
        "iterations": solution.iterations if solution else None,
        "seconds": solution.seconds if solution else None,
        "status": str(solution.status) if solution else None,
        "solver": solution.solver if solution else None,
    }
    names = mdp.space.names
    if "status" in names and isinstance(mdp, MDP):
        from exact_mdp.analysis.optimum import stationary

        result["stationary"] = stationary(mdp, found)
    if {"subtask", "trial", "status"} <= set(names):
        column = mdp.space.column("status")
        first = [mdp.space.index(status=value) for value in range(column.size)]
        result["policy"] = {
            column.label(value): mdp.actions[found.policy[state]]
            for value, state in enumerate(first)
        }
    elif mdp.n_states <= LISTED_STATES:
        labels = _labels(mdp.space)
        chosen = [mdp.actions[action] for action in found.policy]
        result["policy_by_state"] = dict(zip(labels, chosen, strict=True))
    return result


def _labels(space: StateSpace) -> list[str]:
    """Return a name for each state, no two alike."""
    if len(space.columns) == 1:
        column = space.columns[0]
        labels = [*(column.label(value) for value in range(column.size)), *space.extra]
    else:
        labels = space.labels(range(space.size))
    if len(set(labels)) == len(labels):
        return labels
    return [f"{label} (state {state})" for state, label in enumerate(labels)]


def _facts(result: dict[str, Any]) -> dict[str, str]:
    shown = number(result["start_value"], result["error_bound"])
    facts = {
        "model": result["model"],
        "method": result["method"],
        "discount": number(result["discount"]),
        **({"horizon": f"{result['horizon']:,} steps"} if result["horizon"] else {}),
        "start value": f"{shown} ({result['claim']}, within {at_most(result['error_bound'])})",
    }
    if result["seconds"] is not None:
        facts["method"] += f", {result['iterations']:,} iterations, {result['seconds']:.2g} s"
    if result["exact_start_value"] is not None:
        exact = ratio(result["exact_start_value"])
        if len(exact) > SHOWN_DIGITS:
            exact = f"a rational of {len(exact):,} digits; --json prints it"
        facts["exact start value"] = exact
        facts["unique optimum"] = "yes" if result["unique"] else "no"
    if result["stationary"] is not None:
        facts["stationary"] = (
            "yes, an optimal policy reads the status alone"
            if result["stationary"]
            else "no, the best action of a status changes with the rest of the state"
        )
    facts |= {"written": ", ".join(result["written"])} if result["written"] else {}
    return facts


def _grids(result: dict[str, Any], loaded: Loaded) -> list[Grid]:
    if len(result["policy"] or ()) > LISTED_STATES:
        return []
    if result["policy"] is not None:
        digits = f" (digits: {', '.join(loaded.scenario.statuses)})" if loaded.scenario else ""
        title = f"optimal action at subtask 0, trial 0, by status{digits}"
        rows = list(result["policy"].items())
        return [Grid(title=title, headings=("status", "action"), rows=rows)]
    if result["policy_by_state"] is not None:
        rows = list(result["policy_by_state"].items())
        return [Grid(title="optimal policy", headings=("state", "action"), rows=rows)]
    return []
