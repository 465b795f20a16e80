"""What commands about a model itself do: describe it, and write it in another format."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.analysis.cli.options import advice, check_outputs, given, renamed, whole_of
from exact_mdp.analysis.cli.render import Report, Table, ratio
from exact_mdp.analysis.gate.data.interval import cut_off, entered, never_taken
from exact_mdp.analysis.pages.page import ADVICE
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.graph import Termination, is_acyclic, reachable, termination
from exact_mdp.mdp.io import transitions
from exact_mdp.mdp.io.load import read_model, save
from exact_mdp.mdp.model import MDP

NAMED = 1000  # pairs that nobody took, in JSON
RARE, MOST_RARE = "5", 20  # observations; rows of the table
SHOWN = 4  # states of a policy that never ends, and start states, that are printed


def info(**shared: Any) -> Report:
    """Describe a model."""
    loaded = given(**shared).loaded
    mdp, scenario = loaded.mdp, loaded.scenario
    ending = termination(mdp)
    columns = {column.name: column.size for column in mdp.space.columns}
    start = [(mdp.space.label(state), weight) for state, weight in mdp.start]
    result: dict[str, Any] = {
        "model": loaded.name,
        "title": scenario.title if scenario else None,
        "source": scenario.source if scenario else None,
        "states": mdp.n_states,
        "reachable": int(reachable(mdp).sum()),
        "terminal": int(mdp.terminal.sum()),
        "with_choice": int((~mdp.forced).sum()),
        "columns": columns,
        "actions": mdp.n_actions,
        "action_names": mdp.actions,
        "pairs": mdp.n_pairs,
        "transitions": mdp.n_transitions,
        "discount": mdp.discount,
        "discount_exact": mdp.discount_exact,
        "start": start,
        "terminates": ending.proven,
        "never_ends": _counterexample(mdp, ending),
        "acyclic": is_acyclic(mdp),
        "time_limit": mdp.time_limit,
        "sense": mdp.sense,
        "labels": {name: int(states.sum()) for name, states in mdp.labels.items()},
        "reward_components": mdp.component_names,
        "events": mdp.events,
        "model_hash": fingerprint(mdp),
    }
    sizes = " x ".join(f"{name} {size:,}" for name, size in columns.items())
    facts = {
        **{key: result[key] or None for key in ("model", "title", "source")},
        "states": f"{mdp.n_states:,} ({sizes}); {result['reachable']:,} reachable, "
        f"{result['with_choice']:,} with a choice, {result['terminal']:,} terminal",
        "actions": f"{mdp.n_actions}: {', '.join(mdp.actions)}",
        **{key: result[key] for key in ("pairs", "transitions", "discount")},
        "start": _some([f"{label} ({ratio(weight)})" for label, weight in start[:SHOWN]], start),
        "every policy ends": _endless(result["never_ends"]),
        "acyclic": result["acyclic"],
        "time limit": f"{mdp.time_limit:,} steps, left out without --horizon"
        if mdp.time_limit is not None
        else None,
        "labels": ", ".join(f"{name} ({count:,})" for name, count in result["labels"].items())
        or None,
        "rewards are": "costs to minimise" if mdp.sense == "min" else None,
        "reward components": mdp.component_names,
    }
    tables = []
    if scenario:
        result |= {
            "statuses": scenario.statuses,
            "tasks": scenario.tasks,
            "max_trial": scenario.max_trial,
            "readings": scenario.readings,
            "parameters": scenario.values(),
        }
        facts |= {
            "statuses": scenario.statuses,
            "tasks": f"{', '.join(str(count) for count in scenario.tasks)} subtasks",
            "max_trial": scenario.max_trial,
            "parameters": ", ".join(scenario.values()),
        }
        rows = [{"name": name, "option": option} for name, option in scenario.readings.items()]
        columns_shown = {"reading": "name", "option": "option"}
        tables = [Table(title="readings", rows=rows, columns=columns_shown)]
    facts["model hash"] = result["model_hash"]
    return Report(result=result, facts=facts, tables=tables, notes=advice(loaded))


def _counterexample(mdp: MDP, ending: Termination) -> dict[str, Any] | None:
    """Return a policy that never ends, by the first of the states that it never leaves."""
    if ending.policy is None:
        return None
    policy = {
        mdp.space.label(state): mdp.actions[ending.policy[state]]
        for state in ending.trapped[:SHOWN].tolist()
    }
    return {"states": len(ending.trapped), "policy": policy}


def _endless(found: dict[str, Any] | None) -> str:
    if found is None:
        return "yes"
    shown = [f"{state}: {action}" for state, action in found["policy"].items()]
    return f"no; one that stays for ever: {_some(shown, range(found['states']))}"


def _some(shown: list[str], of: Sequence[object]) -> str:
    """Return the texts shown, and how many more there are."""
    more = len(of) - len(shown)
    return "; ".join(shown) + (f"; {more} more" if more else "")


def data(
    *,
    file: str,
    out: str,
    discount: str | None,
    columns: tuple[str, ...],
    unseen: str | None,
    rare: str | None,
) -> Report:
    """Estimate a model from recorded transitions, and write it."""
    least = whole_of(rare or RARE, "--rare", 0, 2**62)
    if Path(out).suffix.lower() != ".npz":
        raise ModelError(f"{out!r} is not named .npz", where="--out", fix="name it MODEL.npz")
    record = transitions.counted(file, dict(map(renamed, columns)), progress=True)
    mdp = MDP(**record.parts(discount or 1, unseen or transitions.UNAVAILABLE))
    save(mdp, out)
    seen = mdp.observations
    assert seen is not None
    few = np.flatnonzero((seen > 0) & (seen < least))
    ends = entered(mdp)
    rows = [
        {
            "state": mdp.space.label(int(mdp.pair_state[pair])),
            "action": mdp.actions[mdp.pair_action[pair]],
            "observations": int(seen[pair]),
        }
        for pair in few[np.argsort(seen[few], kind="stable")].tolist()
    ]
    result = {
        "written": out,
        "episodes": record.n_episodes,
        "transitions": record.rows,
        "states": mdp.n_states,
        "actions": mdp.n_actions,
        "pairs": int((seen > 0).sum()),
        "discount": mdp.discount,
        "ends": list(ends),
        "never_taken": [],
        "n_never_taken": 0,
        "rare": rows,
        "model_hash": fingerprint(mdp),
    }
    facts = {
        key: result[key] for key in ("written", "episodes", "transitions", "states", "actions")
    }
    offered = mdp.n_actions * len(np.unique(mdp.pair_state[seen > 0]))
    facts["pairs"] = f"{result['pairs']:,} observed of {offered:,}, {len(rows):,} of them rare"
    never = never_taken(mdp)
    if len(never):
        named = [f"{mdp.space.label(s)}: {mdp.actions[a]}" for s, a in never[:NAMED].tolist()]
        result |= {"never_taken": named, "n_never_taken": len(never)}
        facts["never taken"] = _some(named[:SHOWN], never.tolist())
    if ends:
        facts["ends"] = f"{_some(list(ends[:SHOWN]), ends)} (entered, never left)"
    notes = ["only one action was ever taken: there is nothing to choose"] * (mdp.n_actions == 1)
    notes += [
        f"the column {name!r} is not used: where it marks the rows after which an episode was cut "
        f"off, add --column truncated={name}; where it marks the ends, leave next_state empty there"
        for name in record.ignored
    ]
    unknown = [mdp.space.label(s) for s in np.flatnonzero(cut_off(mdp)).tolist()]
    stopped = record.n_cut_off
    result |= {"cut_off": stopped, "cut_off_states": unknown}
    if stopped:
        facts["cut off"] = f"{stopped:,} episode{'s' * (stopped != 1)}"
    if unknown:
        facts["unknown"] = f"{_some(unknown[:SHOWN], unknown)} (episodes were cut off there)"
        notes.append(
            "nobody knows what follows where episodes were cut off and no record leaves: robust "
            "and off-policy intervals allow every total there; the estimate takes it for 0"
        )
    shown = {"state": "state", "action": "action", "observations": "observations"}
    title = f"pairs observed fewer than {least} times"
    if ends:
        notes.append(
            "a state that no record leaves is taken for an end, worth 0: where episodes were cut "
            "off there, no verdict holds: record what follows"
        )
    table = Table(title=title, rows=rows, columns=shown, first=MOST_RARE)
    return Report(result=result, facts=facts, tables=[table], notes=[*notes, ADVICE])


def convert(
    *,
    source: str,
    target: str,
    sets: tuple[str, ...],
    discount: str | None,
    constants: str | None,
) -> Report:
    """Write a model in another format."""
    check_outputs((target, (".npz", ".umb", ".json")))
    loaded = read_model(source, sets=sets, discount=discount, constants=constants)
    save(loaded.mdp, target)
    result = {
        "written": target,
        "model": loaded.name,
        "states": loaded.mdp.n_states,
        "pairs": loaded.mdp.n_pairs,
        "transitions": loaded.mdp.n_transitions,
    }
    return Report(
        result=result, facts={"written": target, "model": repr(loaded.mdp)}, notes=advice(loaded)
    )
