"""The commands of a model itself: describe, estimate and convert it; write and check a scenario."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.resources import files
from pathlib import Path
from typing import Any

import numpy as np

import exact_mdp
from exact_mdp.analysis.cli.given import Given, list_advice
from exact_mdp.analysis.cli.words import pairs_of
from exact_mdp.analysis.gate.data.interval import (
    cut_off,
    list_entered_states,
    never_taken,
    observations_of,
)
from exact_mdp.analysis.pages import ADVICE
from exact_mdp.mdp.care import lint as linter
from exact_mdp.mdp.errors import FEW_NAMED, ModelError, join_few
from exact_mdp.mdp.graph import find_reachable_states
from exact_mdp.mdp.io import transitions
from exact_mdp.mdp.io.files import SMALL, STANDARD_INPUT, read_text, write_atomically
from exact_mdp.mdp.io.load import read_model
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.report import MOST_LISTED, Report, Shown, Table, format_ratio

ONE_ACTION = "only one action was ever taken: there is nothing to choose"
UNUSED = (
    "not used: {}; if one of these marks the rows after which an episode was cut off, name it "
    "by --column truncated=NAME; if it marks those after which it was over, by --column "
    "terminated=NAME"
)
UNKNOWN = (
    "nobody knows what follows where episodes were cut off and no record leaves: robust and "
    "off-policy intervals allow every total there; the estimate takes it for 0"
)
ENDS = (
    "a state that no record leaves is taken for an end, worth 0: if episodes were cut off "
    "there, no verdict holds: record what follows"
)


def new_command(target: str) -> Report:
    """Write a commented scenario to change.

    Example: exact-mdp new mine.toml

    Parameters
    ----------
    target : FILE, .toml
    """
    if Path(target).exists():
        raise ModelError("the file is there already", where=target, fix="choose another name")
    template = (files("exact_mdp.mdp.care") / "template.toml").read_text(encoding="utf-8")
    write_atomically(target, template)
    return Report(title="new scenario", facts={"written": target}, notes=[ADVICE])


def lint_command(file: str) -> Report:
    """List all problems of a scenario file.

    An error keeps the scenario from being read; a warning is about numbers that can be read but are
    probably mistaken.

    Example: exact-mdp lint mine.toml

    Keys
    ----
    file: the scenario's file; problems: every problem with line, what, fix, severity.
    """
    if file != STANDARD_INPUT and Path(file).suffix.lower() != ".toml":
        raise ModelError("not a scenario file", where=file, fix="name a .toml file")
    problems = linter.lint_scenario(read_text(file, most=SMALL), Path(file).stem)
    rows = [each | {"what": f"{each['severity']}: {each['what']}"} for each in problems]
    columns = {"line": "line", "what": "what", "fix": "fix"}
    table = Table(title="problems", rows=rows, columns=columns, first=max(1, len(rows)))
    errors = sum(each["severity"] == "error" for each in problems)
    return Report(
        title=f"problems of {file}",
        facts={
            "file": file,
            "problems": Shown(problems, f"{errors} errors, {len(problems) - errors} warnings"),
        },
        tables={"listed": table},
        notes=[ADVICE],
        passed=not problems,
    )


def info_command(given: Given) -> Report:
    """Describe a model: sizes, discount, whether every policy ends.

    Example: exact-mdp info gymnasium:FrozenLake-v1

    Keys
    ----
    title: the scenario's title; source: where the scenario's numbers come from; columns: the
    columns of the state space, with the number of values of each; reachable: states that can be
    reached from the start; terminal: states in which the process has ended; with_choice: states
    with more than one action; actions: number of actions; action_names: names of the actions;
    discount_exact: the discount, "p/q"; start: where episodes begin, as [state, probability];
    terminates: whether every policy reaches the end; never_ends: a policy and a state from which it
    never ends, if there is one; acyclic: whether no state can be reached from itself; time_limit:
    the environment's own limit of steps, or null; labels: the labels, with the number of states of
    each; reward_components: the components of the reward; events: the events of transitions;
    statuses: the statuses of a scenario; tasks: the number of subtasks of each task; max_trial:
    trials before a subtask is skipped; readings: choices where the text is open; parameters: named
    numbers and their values.
    """
    mdp, scenario = given.mdp, given.loaded.scenario
    ends = mdp.ends.every_policy_ends
    start = [(mdp.space.label(state), weight) for state, weight in mdp.start]
    begins = (f"{label} ({format_ratio(weight)})" for label, weight in start)
    facts: dict[str, Any] = {
        "title": scenario.title if scenario else None,
        "source": scenario.source if scenario else None,
        "states": mdp.n_states,
        "columns": {column.name: column.size for column in mdp.space.columns},
        "reachable": int(find_reachable_states(mdp).sum()),
        "terminal": int(mdp.terminal.sum()),
        "with_choice": int((~mdp.forced).sum()),
        "actions": mdp.n_actions,
        "action_names": mdp.actions,
        "pairs": mdp.n_pairs,
        "transitions": mdp.n_transitions,
        "discount_exact": Shown(mdp.discount_exact),
        "start": Shown(start, join_few(begins, len(start), "; ")),
        "terminates": Shown(ends, "every policy ends" if ends else "no"),
        "never_ends": _never_ends(mdp),
        "acyclic": mdp.ends.is_acyclic,
        "time_limit": mdp.time_limit,
        "sense": Shown(mdp.sense, "min: rewards are costs" if mdp.sense.costs else None),
        "labels": {name: int(states.sum()) for name, states in mdp.labels.items()},
        "reward_components": mdp.component_names,
        "events": mdp.events,
    }
    if scenario:
        facts |= {
            "statuses": scenario.statuses,
            "tasks": scenario.tasks,
            "max_trial": scenario.max_trial,
            "readings": scenario.readings,
            "parameters": Shown(scenario.values(), [*scenario.values()]),
        }
    facts["model_hash"] = exact_mdp.fingerprint(mdp)
    return given.complete_report(Report(title=f"model {given.loaded.name}", facts=facts))


def _never_ends(mdp: MDP) -> Shown | None:
    """Return a policy that never ends, by the first of the states that it never leaves, if any."""
    pairs, policy = mdp.ends.find_endless_pairs(), {}
    if not len(pairs):
        return None
    for pair in pairs[:FEW_NAMED].tolist():
        policy[mdp.space.label(int(mdp.pair_state[pair]))] = mdp.actions[mdp.pair_action[pair]]
    listed = (f"{state}: {action}" for state, action in policy.items())
    content = {"states": len(pairs), "policy": policy}
    return Shown(content, f"a policy that stays forever: {join_few(listed, len(pairs), '; ')}")


def data_command(
    file: str,
    *,
    out: str,
    discount: str = "1",
    columns: Sequence[str] = (),
    unseen: str = "unavailable",
    rare: int = 5,
) -> Report:
    """Estimate a model from recorded transitions.

    The columns are episode, state, action, reward and next_state, in the order of time, one episode
    after the other; without a next state the episode is over. A column truncated (true or false)
    marks the rows after which an episode was cut off, as by a time limit; a column terminated, or
    done, marks the rows after which it was over. --column truncated=NAME says what the file calls a
    column. The numbers of observations are kept in the model.

    Example: exact-mdp data records.csv --discount 0.95 --out model.npz

    Parameters
    ----------
    file : FILE
    out : MODEL, .npz
        Where the model is written: .npz.
    discount : G, optional
        The model's discount.
    columns : NAME=COLUMN, optional
        What the file calls episode, state, action, reward, next_state, truncated, terminated or
        done.
    unseen : "unavailable", "pessimistic" or "V"
        An action that nobody took in a state is left out there, or it has the worst value that a
        policy can have, or the value V.
    rare : N, 0 to 1000000000
        List the pairs observed fewer than N times.

    Keys
    ----
    episodes: number of episodes; transitions: number of recorded transitions; actions: number of
    actions; ends: states that were only entered, taken for ends; n_never_taken: number of actions
    that nobody took in a state; never_taken: the first 1,000 such actions; rare: pairs that were
    seldom seen; cut_off: number of truncated episodes; cut_off_states: states where episodes were
    truncated and that no record leaves.
    """
    names = pairs_of(columns, "--column", "NAME=COLUMN")
    record = transitions.count_transitions(file, names, progress=True)
    mdp = MDP(**record.build_parts(discount, unseen))
    exact_mdp.save(mdp, out)
    return _report_estimate(mdp, record, file, out, rare)


def _report_estimate(
    mdp: MDP, record: transitions.TransitionRecord, file: str, out: str, rare: int
) -> Report:
    """Return the counts, and the gaps in the records."""
    seen, ends, never = observations_of(mdp), list_entered_states(mdp), never_taken(mdp)
    label, few = mdp.space.label, np.flatnonzero((seen > 0) & (seen < rare))
    # Gaps: pairs that were seldom seen, actions that nobody took, states with an unknown value.
    rows = []
    for pair in few[np.argsort(seen[few], kind="stable")].tolist():
        rows.append(
            {
                "state": label(int(mdp.pair_state[pair])),
                "action": mdp.actions[mdp.pair_action[pair]],
                "observations": int(seen[pair]),
            }
        )
    named = [f"{label(s)}: {mdp.actions[a]}" for s, a in never[:MOST_LISTED].tolist()]
    unknown = [label(s) for s in np.flatnonzero(cut_off(mdp)).tolist()]
    facts = {
        "written": out,
        "episodes": record.starts.total(),
        "transitions": record.rows,
        "states": mdp.n_states,
        "actions": mdp.n_actions,
        "pairs": int((seen > 0).sum()),
        "discount": mdp.discount,
        "ends": Shown(ends, ends and f"{join_few(ends, len(ends), '; ')} (entered, never left)"),
        "n_never_taken": Shown(len(never)),
        "never_taken": Shown(named, named and join_few(named, len(never), "; ")),
        "rare": rows,
        "cut_off": Shown(record.n_cut_off, record.n_cut_off or None),
        "cut_off_states": Shown(unknown, unknown and join_few(unknown, len(unknown), "; ")),
        "model_hash": exact_mdp.fingerprint(mdp),
    }
    keys = {key: key for key in ("state", "action", "observations")}
    table = Table(title=f"pairs observed fewer than {rare} times", columns=keys)
    notes = []
    if mdp.n_actions == 1:
        notes.append(ONE_ACTION)
    if record.unused:
        notes.append(UNUSED.format(", ".join(record.unused)))
    if unknown:
        notes.append(UNKNOWN)
    if ends:
        notes.append(ENDS)
    notes.append(ADVICE)
    return Report(title=f"model from {file}", facts=facts, tables={"rare": table}, notes=notes)


def convert_command(
    source: str,
    target: str,
    *,
    sets: Sequence[str] = (),
    envs: Sequence[str] = (),
    constants: str | None = None,
    discount: str | None = None,
    start: str | None = None,
) -> Report:
    """Write a model in another format.

    OUT is {formats:WRITTEN_MODELS}.

    Example: exact-mdp convert tea tea.umb

    Parameters
    ----------
    source : IN
    target : OUT, {formats:WRITTEN_MODELS}
    """
    loaded = read_model(
        source,
        sets=sets,
        env=pairs_of(envs, "--env"),
        discount=discount,
        start=start,
        constants=constants,
    )
    exact_mdp.save(loaded.mdp, target)
    sizes = {"states": loaded.mdp.n_states, "pairs": loaded.mdp.n_pairs}
    facts = {"written": target, "model": loaded.name, **sizes}
    facts["transitions"] = loaded.mdp.n_transitions
    return Report(title=f"{source} as {target}", facts=facts, notes=list_advice(loaded))
