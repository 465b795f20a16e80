"""Explicit files of PRISM, and models from lists in the form of model checkers.

PRISM writes NAME.tra, and beside it NAME.lab, .srew, .trew and .sta if there are:

    .tra     "states choices transitions", then "state choice next-state probability [action]";
             of a DTMC "states transitions", then "state next-state probability"
    .lab     0="init" 1="deadlock" 2="goal", then "state: label label"
    .srew    "states nonzero", then "state reward"
    .trew    "states choices nonzero", then "state choice next-state reward"; of a DTMC two numbers,
             and "state next-state reward"
    .sta     (x,y), then "state:(0,3)"

A file that numbers several reward structures (NAME1.srew, NAME2.srew) has one for each. Numbers are
floats, as PRISM's are. Lists of other programs are choices, branches of choices and named rewards,
in fractions or floats; nothing is rounded. A state without choices is the end of the process: it
stays put.

Source: https://www.prismmodelchecker.org/manual/Appendices/ExplicitModelFiles
"""

from __future__ import annotations

import re
from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from fractions import Fraction
from itertools import accumulate, pairwise, starmap
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.components import REST
from exact_mdp.mdp.errors import ModelError, require_known_name, warn_user
from exact_mdp.mdp.forms.names import ByNumber, find_free_name
from exact_mdp.mdp.forms.numbers import as_given
from exact_mdp.mdp.io.files import LARGE, read_text
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import exact
from exact_mdp.mdp.validate import Flags

REWARD = "reward"
INITIAL, UNNAMED = "init", "unnamed"


def name_states(valuations: Iterable[Mapping[str, Any]]) -> tuple[str, ...]:
    """Return names of states such as "x=3, done=true" from the values of their variables.

    Variables with values other than whole numbers and truth values are left out. If the names are
    not different for all states, return (): the states have numbers.
    """
    listed = list(valuations)
    broken = set()
    for values in listed:
        broken |= {name for name, value in values.items() if not isinstance(value, int)}
    words = []
    for values in listed:
        parts = []
        for name, value in values.items():
            text = str(value)
            if isinstance(value, bool):
                text = text.lower()
            if name not in broken:
                parts.append(f"{name}={text}")
        words.append(", ".join(parts))
    if len(set(words)) < len(words) or not all(words):
        return ()
    return tuple(words)


def _number_actions(
    choices: Iterable[Iterable[int]], words: Sequence[str], declared: Iterable[str]
) -> tuple[list[int], tuple[str, ...]]:
    """Return the action number of each choice, and the names of the actions.

    A choice has its word as its name, or "unnamed" without a word. If several choices of a state
    have the same word, the second, third, … are named "word#2", "word#3", …, with a "'" if the file
    has that name already. Declared names come first. If no choice has a word, choices are numbered
    in each state.
    """
    # Without words, choices are numbered in each state.
    if not any(words):
        places: list[int] = []
        for own in choices:
            places += [place for place, _ in enumerate(own)]
        return places, ()
    # The second choice of a state with the same word gets a name that no choice of the file has.
    given = set(words)
    unnamed = find_free_name(UNNAMED, given)
    names: list[str] = []
    for own in choices:
        seen = Counter[str]()
        for choice in own:
            word = words[choice] or unnamed
            seen[word] += 1
            if seen[word] > 1:
                word = find_free_name(f"{word}#{seen[word]}", given)
            names.append(word)
    number = {name: place for place, name in enumerate(dict.fromkeys([*declared, *names]))}
    return [number[name] for name in names], tuple(number)


def build_explicit_model(
    where: str,
    *,
    name: str,
    first_choice: Sequence[int],
    first_branch: Sequence[int],
    targets: Sequence[int],
    chances: Sequence[Any],
    choice_words: Sequence[str],
    words: tuple[str, ...],
    initial: Sequence[int],
    rewards: Mapping[str, Mapping[str, Sequence[Any]]],
    labels: Mapping[str, Flags],
    discount: object,
    start: object,
    reward: str | None = None,
    action_names: Sequence[str] = (),
) -> MDP:
    """Return a model of another program; the caller adds what the format lacks, such as a discount.

    The choices of state s are first_choice[s] … first_choice[s+1]-1, and so are the branches of a
    choice. Rewards of "states", "choices" and "branches" are added up. `choice_words` are the names
    of the choices' actions, "" for none, and `action_names` the actions in the order of the file.
    See `mdp.io.umb.read_umb` for `reward` and `start`.
    """

    def warn_of_file(what: str) -> None:
        warn_user(f"{where}: {what}")

    if discount is None:
        warn_of_file(
            "a file of another program states no discount, and 1 is used; give the discount"
        )
    # One reward model counts; several are components of the reward.
    parts: dict[str, Any] = {}
    if reward is not None or len(rewards) == 1:
        chosen = require_known_name(
            reward or next(iter(rewards)), rewards, "reward model", "rewards"
        )
        parts["component_names"], rewards = (chosen,), {chosen: rewards[chosen]}
    elif rewards and REWARD not in rewards:
        listed = ", ".join(rewards)
        warn_of_file(
            f"the rewards {listed} are added up; name the one that counts: --reward NAME, "
            "mdp.earning(name)"
        )
    # Initial states are a label; the start is the only one, or the first.
    size = len(first_choice) - 1
    space, labels = StateSpace.plain(size, words), dict(labels)
    if start is None and not initial:
        raise ModelError("no initial state", fix="say where to start: --start, start=")
    if initial:
        labels.setdefault(INITIAL, np.isin(np.arange(size), initial))
    if len(initial) > 1 and start is None:
        first = f"the first of {len(initial)} initial states, {space.label(initial[0])}"
        warn_of_file(f"the start is {first}; --start, or start=, names another")
    # The rows of the model, and an action that stays for each state without choices.
    choices = list(starmap(range, pairwise(first_choice)))
    actions, names = _number_actions(choices, choice_words, action_names)
    rows = list[tuple[int, int, list[tuple[Any, int, Any]]]]()
    by_branch = any("branches" in own for own in rewards.values())
    for state, own in enumerate(choices):
        for choice in own:
            begin, end = first_branch[choice], first_branch[choice + 1]
            if by_branch:
                earned = [_collect_rewards(rewards, state, choice, k) for k in range(begin, end)]
            else:
                earned = [_collect_rewards(rewards, state, choice, begin)] * (end - begin)
            outcomes = zip(chances[begin:end], targets[begin:end], earned, strict=True)
            rows.append((state, actions[choice], list(outcomes)))
        if not own:
            rows.append((state, 0, [(1, state, 0)]))
    if discount is None:
        discount = 1
    if start is None:
        start = ByNumber([(initial[0], 1)])
    return MDP.from_outcomes(
        rows,
        discount,
        start=start,
        space=space,
        actions=names,
        labels=labels,
        name=name,
        **parts,
    )


def _collect_rewards(
    rewards: Mapping[str, Mapping[str, Any]], state: int, choice: int, branch: int
) -> Any:
    """Return the reward of a branch: a number, or {name: amount} for several reward models."""
    at, amounts = {"states": state, "choices": choice, "branches": branch}, dict[str, Any]()
    for name, values in rewards.items():
        some = [as_given(own[at[over]]) for over, own in values.items() if own[at[over]]]
        if len(some) == 1:
            amounts[name] = some[0]  # a float stays a float
        else:
            amounts[name] = sum(map(exact, some), Fraction(0))
    if len(amounts) < 2:
        return next(iter(amounts.values()), 0)
    # The reward model "reward" is the sum; the others are its components.
    if REWARD in amounts:
        total, rest = amounts.pop(REWARD), find_free_name(REST, amounts)
        left = exact(total) - sum(map(exact, amounts.values()), Fraction(0))
        if left:
            amounts[rest] = left
    return amounts


# ---- files of PRISM ------------------------------------------------------------------------------

Row = tuple[int, list[str]]
"""The number of a line, and its words."""


def read_tra(path: str | Path, *, discount: object = 1, start: object = None) -> MDP:
    """Return the model of a .tra file and the files beside it; ModelError if one is broken."""
    path = Path(path)
    (_, head), *rows = _split_lines(path)
    nondeterministic = len(head) == 3
    if len(head) not in (2, 3):
        raise _report_line(path, 1, "the first line has other than 2 or 3 numbers")
    # The branches of each choice, and the choices of each state.
    size, count = (_parse_whole(cell, path, 1) for cell in (head[0], head[-1]))
    if len(rows) != count:
        raise _report_line(
            path, 1, f"{count:,} transitions are announced, and {len(rows):,} follow"
        )
    branches: dict[tuple[int, int], list[tuple[int, float]]] = defaultdict(list)
    words: dict[tuple[int, int], str] = {}
    for line, cells in rows:
        if not nondeterministic:
            cells = [cells[0], "0", *cells[1:]]
        if len(cells) not in (4, 5):
            raise _report_line(path, line, f"{len(cells)} values")
        state, choice, to = (_parse_whole(cell, path, line, size) for cell in cells[:3])
        branches[state, choice].append((to, _parse_amount(cells[3], path, line)))
        words[state, choice] = "".join(cells[4:])
    pairs = sorted(branches)
    if nondeterministic and len(pairs) != _parse_whole(head[1], path, 1):
        what = f"{head[1]} choices are announced, and {len(pairs):,} follow"
        raise _report_line(path, 1, what)
    counts = np.bincount([state for state, _ in pairs], minlength=size)
    listed = [each for pair in pairs for each in branches[pair]]
    labels = _read_labels(path.with_suffix(".lab"), size)
    return build_explicit_model(
        str(path),
        name=path.stem,
        first_choice=[0, *np.cumsum(counts).tolist()],
        first_branch=[0, *accumulate(len(branches[pair]) for pair in pairs)],
        targets=[to for to, _ in listed],
        chances=[chance for _, chance in listed],
        choice_words=[words[pair] for pair in pairs],
        words=_read_states(path.with_suffix(".sta"), size),
        initial=np.flatnonzero(labels.get(INITIAL, np.arange(size) == 0)).tolist(),
        rewards=_read_rewards(path, pairs, branches, size, nondeterministic=nondeterministic),
        labels=labels,
        discount=discount,
        start=start,
    )


def _read_labels(path: Path, size: int) -> dict[str, Any]:
    """Return the states (S,) of each label; {} without a file."""
    if not path.exists():
        return {}
    (_, head), *rows = _split_lines(path)
    names = dict(re.findall(r'(\d+)="([^"]*)"', " ".join(head)))
    labels = {name: np.zeros(size, dtype=bool) for name in names.values()}
    for line, cells in rows:
        state = _parse_whole(cells[0].removesuffix(":"), path, line, size)
        for number in cells[1:]:
            if number not in names:
                raise _report_line(path, line, f"label {number} has no name")
            labels[names[number]][state] = True
    return labels


def _read_states(path: Path, size: int) -> tuple[str, ...]:
    """Return names of the states by the values of their variables; () without a file."""
    if not path.exists():
        return ()
    (_, head), *rows = _split_lines(path)
    names = "".join(head).strip("()").split(",")
    values: list[dict[str, Any]] = [{} for _ in range(size)]
    for line, cells in rows:
        number, _, state = "".join(cells).partition(":")
        given = state.strip("()").split(",")
        if len(given) != len(names):
            raise _report_line(path, line, f"{len(given)} values of {len(names)} variables")
        truth = {"true": True, "false": False}
        values[_parse_whole(number, path, line, size)] = {
            name: truth.get(text, int(text) if re.fullmatch(r"-?\d{1,18}", text) else text)
            for name, text in zip(names, given, strict=True)
        }
    return name_states(values)


def _read_rewards(
    path: Path, pairs: list[tuple[int, int]], branches: Any, size: int, *, nondeterministic: bool
) -> dict[str, dict[str, list[float]]]:
    """Return the rewards of "states" and "branches", by the number of their structure."""
    found: dict[str, dict[str, list[float]]] = {}
    place = {pair: number for number, pair in enumerate(pairs)}
    first = [0, *accumulate(len(branches[pair]) for pair in pairs)]
    for file in sorted(path.parent.glob(f"{path.stem}*rew")):
        structure = re.fullmatch(rf"{re.escape(path.stem)}(\d*)\.([st])rew", file.name)
        # NAME1.srew belongs to NAME1.tra, if there is such a model.
        if file.with_suffix(".tra").exists() and file.stem != path.stem:
            continue
        if structure is None:
            if file.name.startswith(f"{path.stem}."):
                fix = "end its name in srew for rewards of states, in trew for transitions"
                raise ModelError("no reward file of PRISM", where=str(file), fix=fix)
            continue
        own = found.setdefault(REWARD + structure[1], {})
        (_, head), *rows = _split_lines(file)
        of_states = structure[2] == "s"
        if not head or (of_states and head[0] != str(size)):
            raise _report_line(file, 1, f"the first line does not begin with {size} states")
        own["states" if of_states else "branches"] = [0.0] * (size if of_states else first[-1])
        width = 2 if of_states else 3 + nondeterministic
        for line, cells in rows:
            if len(cells) != width:
                raise _report_line(file, line, f"{len(cells)} values, not {width}")
            if of_states:
                own["states"][_parse_whole(cells[0], file, line, len(own["states"]))] = (
                    _parse_amount(cells[-1], file, line)
                )
                continue
            if not nondeterministic:
                cells = [cells[0], "0", *cells[1:]]
            state, choice, to = (_parse_whole(cell, file, line) for cell in cells[:3])
            targets = [each for each, _ in branches.get((state, choice), [])]
            if to not in targets:
                raise _report_line(file, line, f"{path.name} has no such transition")
            own["branches"][first[place[state, choice]] + targets.index(to)] = _parse_amount(
                cells[-1], file, line
            )
    return found


def _split_lines(path: Path) -> list[Row]:
    """Return the lines of a file that are not blank, nor comments, as words."""
    lines = enumerate(map(str.split, read_text(path, most=LARGE).split("\n")), 1)
    rows = [(number, words) for number, words in lines if words and words[0][0] != "#"]
    return rows or [(1, [])]


def _parse_whole(text: str, path: Path, line: int, size: int = 2**31) -> int:
    """Return a number of a state or choice; raise ModelError for another text."""
    if not re.fullmatch(r"\d{1,10}", text) or int(text) >= size:
        raise _report_line(path, line, f"{text!r} is not a number below {size:,}")
    return int(text)


def _parse_amount(text: str, path: Path, line: int) -> float:
    """Return a probability or reward."""
    try:
        return float(text)
    except ValueError:
        raise _report_line(path, line, f"{text!r} is not a number") from None


def _report_line(path: Path, line: int, what: str) -> ModelError:
    return ModelError(what, where=f"{path}, line {line}", fix="export the files by PRISM again")
