"""Explicit files of PRISM: NAME.tra, and beside it NAME.lab, .srew, .trew and .sta if there are.

    .tra     "states choices transitions", then "state choice next-state probability [action]";
             of a DTMC "states transitions", then "state next-state probability"
    .lab     0="init" 1="deadlock" 2="goal", then "state: label label"
    .srew    "states nonzero", then "state reward"
    .trew    "states choices nonzero", then "state choice next-state reward"; of a DTMC two numbers,
             and "state next-state reward"
    .sta     (x,y), then "state:(0,3)"

A file that numbers several reward structures (NAME1.srew, NAME2.srew) has one for each. Numbers are
floats, as PRISM's are.

Source: https://www.prismmodelchecker.org/manual/Appendices/ExplicitModelFiles
"""

from __future__ import annotations

import re
from collections import defaultdict
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.explicit import INITIAL, REWARD, build_explicit_model, name_states
from exact_mdp.mdp.io.files import LARGE, read_text
from exact_mdp.mdp.model import MDP

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
