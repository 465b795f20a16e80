"""Commands about a model itself: what it is, and writing it in another format."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import click

from exact_mdp.analysis.cli.options import model_options
from exact_mdp.analysis.cli.render import Grid, number, ratio, show

if TYPE_CHECKING:
    from exact_mdp.mdp.chain import Termination
    from exact_mdp.mdp.model import MDP

SHOWN = 4  # states of a policy that never ends, and start states, that are printed


@click.command(short_help="Sizes, discount, whether every policy ends.")
@click.argument("model")
@model_options
def info(model: str, sets: tuple[str, ...], discount: str | None, as_json: bool) -> None:
    """Describe MODEL: sizes, discount, whether every policy ends, whether it is acyclic."""
    from exact_mdp.mdp.chain import is_acyclic, reachable, termination
    from exact_mdp.mdp.fingerprint import fingerprint
    from exact_mdp.mdp.io.load import load

    loaded = load(model, sets=sets, discount=discount)
    mdp, scenario = loaded.mdp, loaded.scenario
    ending = termination(mdp)
    result: dict[str, Any] = {
        "model": loaded.name,
        "title": scenario.title if scenario else None,
        "source": scenario.source if scenario else None,
        "states": mdp.n_states,
        "reachable": int(reachable(mdp).sum()),
        "terminal": int(mdp.terminal.sum()),
        "with_choice": int((~mdp.forced).sum()),
        "columns": {column.name: column.size for column in mdp.space.columns},
        "actions": mdp.n_actions,
        "action_names": mdp.actions,
        "pairs": mdp.n_pairs,
        "transitions": mdp.n_transitions,
        "discount": mdp.discount,
        "discount_exact": mdp.discount_exact,
        "start": [[mdp.space.label(state), weight] for state, weight in mdp.start],
        "terminates": ending.proven,
        "never_ends": _counterexample(mdp, ending),
        "acyclic": is_acyclic(mdp),
        "time_limit": mdp.time_limit,
        "reward_components": mdp.component_names,
        "events": mdp.events,
        "model_hash": fingerprint(mdp),
    }
    if scenario:
        result["statuses"] = scenario.statuses
        result["tasks"] = scenario.tasks
        result["max_trial"] = scenario.max_trial
        result["readings"] = scenario.readings
        result["parameters"] = scenario.values()
    show(result, as_json=as_json, facts=_facts(result), grids=_grids(result))


def _counterexample(mdp: MDP, ending: Termination) -> dict[str, Any] | None:
    """Return a policy that never ends, by the first of the states that it never leaves."""
    if ending.policy is None:
        return None
    policy = {
        mdp.space.label(state): mdp.actions[ending.policy[state]]
        for state in ending.trapped[:SHOWN].tolist()
    }
    return {"states": len(ending.trapped), "policy": policy}


def _facts(result: dict[str, Any]) -> dict[str, str]:
    facts = {"model": result["model"]}
    facts |= {key: result[key] for key in ("title", "source") if result[key]}
    columns = " x ".join(f"{name} {size:,}" for name, size in result["columns"].items())
    facts["states"] = (
        f"{result['states']:,} ({columns}); {result['reachable']:,} reachable, "
        f"{result['with_choice']:,} with a choice, {result['terminal']:,} terminal"
    )
    facts["actions"] = f"{result['actions']}: {', '.join(result['action_names'])}"
    facts["pairs"] = f"{result['pairs']:,}"
    facts["transitions"] = f"{result['transitions']:,}"
    facts["discount"] = number(result["discount"])
    first = [f"{label} ({ratio(weight)})" for label, weight in result["start"][:SHOWN]]
    more = len(result["start"]) - len(first)
    facts["start"] = "; ".join(first) + (f"; {more} more" if more else "")
    facts["every policy ends"] = "yes"
    if result["never_ends"]:
        shown = [f"{state}: {action}" for state, action in result["never_ends"]["policy"].items()]
        more = result["never_ends"]["states"] - len(shown)
        also = f"; {more} more" if more else ""
        facts["every policy ends"] = f"no; one that stays for ever: {'; '.join(shown)}{also}"
    facts["acyclic"] = "yes" if result["acyclic"] else "no"
    if result["time_limit"] is not None:
        facts["time limit"] = f"{result['time_limit']:,} steps, left out without --horizon"
    facts["reward components"] = ", ".join(result["reward_components"])
    if "tasks" in result:
        facts["statuses"] = ", ".join(result["statuses"])
        facts["tasks"] = ", ".join(str(count) for count in result["tasks"]) + " subtasks"
        facts["max_trial"] = str(result["max_trial"])
    facts["model hash"] = result["model_hash"]
    return facts


def _grids(result: dict[str, Any]) -> list[Grid]:
    if "readings" not in result:
        return []
    rows = [(name, option) for name, option in result["readings"].items()]
    return [Grid(title="readings", headings=("reading", "option"), rows=rows)]


@click.command(short_help="Write a model in another format.")
@click.argument("source", metavar="IN")
@click.argument("target", metavar="OUT")
@model_options
def convert(
    source: str, target: str, sets: tuple[str, ...], discount: str | None, as_json: bool
) -> None:
    """Read the model IN and write it to OUT, in the format that OUT's ending names."""
    from exact_mdp.mdp.io.load import load, save_model

    loaded = load(source, sets=sets, discount=discount)
    save_model(loaded.mdp, target)
    result = {
        "written": target,
        "model": loaded.name,
        "states": loaded.mdp.n_states,
        "pairs": loaded.mdp.n_pairs,
        "transitions": loaded.mdp.n_transitions,
    }
    facts = {"written": target, "model": repr(loaded.mdp)}
    show(result, as_json=as_json, facts=facts, grids=())
