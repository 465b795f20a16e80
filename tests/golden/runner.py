"""Run golden cases in this process, and compare what they print with pinned answers.

Every key is compared, and how a value is compared depends on what it claims:

    "p/q", integers, truth values, words   exactly, a fraction as a number
    floats of seeded samples (estimated)   to 1e-12 of the value
    other floats                           to 1e-9 of the value, or within the error bounds of both
                                           answers where these are wider
    error bounds                           as small as they were, or 1e-9 of the largest number
    actions of an optimal policy           one of the optimal ones, which are pinned as "a|b"
    "*"                                    anything: text, time, paths, and choices that an answer
                                           leaves open, such as the policy at a vertex of a front

Long lists are pinned by their length and their first entries.
"""

import contextlib
import json
import math
import os
import shlex
import tomllib
from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from support.cli_runner import Done
from support.cli_runner import run as command

FOLDER = Path(__file__).parent
ANSWERS, CERTIFICATES = FOLDER / "answers", FOLDER / "certificates"
CASES: dict[str, dict[str, Any]] = tomllib.loads((FOLDER / "cases.toml").read_text("utf-8"))
QVBS = os.environ.get("QVBS")

# What an answer says in words, or how it was found.
FREE = {
    "assumptions", "certificate", "doubts", "fix", "iterations", "method", "model_hash", "notice",
    "rerun", "seconds", "settings", "solver", "source", "status", "text", "title", "versions",
    "what", "why", "written",
}  # fmt: skip
LONGEST, SHOWN = 24, 6  # entries of a list, and how many of a longer one are pinned
EXACT, SEEDED = 1e-9, 1e-12


def run(line: str, tmp: Path, *more: str) -> Done:
    """Run one command in this process, in the folder of the golden files."""
    words = [word.format(tmp=tmp.as_posix(), qvbs=QVBS) for word in shlex.split(line)]
    with contextlib.chdir(FOLDER):
        return command(*words, *more, "--json")


def answer(case: str | list[str], tmp: Path) -> dict[str, Any]:
    """Return the status and the JSON of a case's last command, and the tables that it wrote."""
    lines = [case] if isinstance(case, str) else case
    for line in lines[:-1]:
        before = run(line, tmp)
        assert before.status == 0, before.err
    earlier = set(tmp.iterdir())
    done = run(lines[-1], tmp)
    assert done.status in (0, 1), f"{lines[-1]}: {done.err}"
    body = trimmed(json.loads(done.out.replace(tmp.as_posix(), "{tmp}")))
    new = sorted({*tmp.glob("*.csv")} - earlier)
    tables = {path.name: path.read_text("utf-8").split() for path in new}
    files = {"files": trimmed(tables)} if tables else {}
    return {"status": done.status, "answer": body} | files


def trimmed(value: Any) -> Any:
    """Return an answer without what is free to change, and with long lists cut."""
    if isinstance(value, dict):
        free = {key: "*" for key in value if key in FREE}
        if value.get("violations"):
            free["violations"] = "some"
        return {key: free.get(key) or trimmed(each) for key, each in value.items()}
    if isinstance(value, list):
        cut = len(value) > LONGEST
        shown = [trimmed(each) for each in value[: SHOWN if cut else None]]
        return [*shown, f"… {len(value)} entries"] if cut else shown
    return value


def opened(content: dict[str, Any], case: str | list[str], tmp: Path) -> dict[str, Any]:
    """Return an answer to be pinned, with every choice that it leaves open marked."""
    body = content["answer"]
    line = case if isinstance(case, str) else case[-1]
    for name in ("vertices", "pieces"):
        listed = body.get(name)
        for each in listed if isinstance(listed, list) else []:
            if isinstance(each, dict) and "policy" in each:
                each["policy"] = anything(each["policy"])
    several = "--subject-to" in line or "--criterion average" in line
    for key in ("policy", "policy_by_state") if line.startswith("solve") else ():
        if body.get(key):
            body[key] = anything(body[key]) if several else optimal_actions(body[key], line, tmp)
    if line.startswith("rationalize") and body.get("weights"):
        body["weights"] = anything(body["weights"])
    return content


def anything(choices: dict[str, Any]) -> dict[str, str]:
    return dict.fromkeys(choices, "*")


def optimal_actions(policy: dict[str, str], line: str, tmp: Path) -> dict[str, str]:
    """Return the optimal actions of each state, "a|b" where there are several."""
    assert run(line, tmp, "--out", f"{tmp}/values.npz").status == 0
    words = shlex.split(line)
    shared = [f"{a} {shlex.quote(b)}" for a, b in pairwise(words)
              if a in ("--set", "--discount")]  # fmt: skip
    names = json.loads(run(f"info {words[1]} {' '.join(shared)}", tmp).out)["action_names"]
    with np.load(tmp / "values.npz") as arrays:
        rows = arrays["optimal"]
    return {
        state: "|".join(dict.fromkeys([action, *(names[a] for a in np.flatnonzero(row))]))
        for (state, action), row in zip(policy.items(), rows, strict=False)
    }


# ---- comparison --------------------------------------------------------------------------------


def differences(wanted: dict[str, Any], given: dict[str, Any]) -> list[str]:
    body = wanted["answer"]
    seeded = isinstance(body, dict) and body.get("claim") == "estimated"
    largest = max(map(abs, floats(wanted)), default=0.0)
    return list(unequal(wanted, given, "", SEEDED if seeded else EXACT, 0.0, largest))


def floats(value: Any) -> Iterator[float]:
    if isinstance(value, float) and math.isfinite(value):
        yield value
    elif isinstance(value, dict | list):
        for each in value.values() if isinstance(value, dict) else value:
            yield from floats(each)


def is_bound(key: str) -> bool:
    ends = ("error_bound", "value_error", " error", "regret_bound")
    return key == "error" or key.endswith(ends)


def bounds(node: Any) -> Iterator[float]:
    """Yield the error bounds that a node states of its own numbers."""
    for key, each in node.items():
        if key == "error_bounds" or is_bound(key):
            yield from floats({"": each})


def unequal(
    a: Any, b: Any, where: str, relative: float, slack: float, largest: float
) -> Iterator[str]:
    """Yield the differences of `b` from the pinned `a`; floats may differ by `slack`."""
    differs = f"{where or 'answer'}: {str(b)[:90]}, pinned {str(a)[:90]}"
    if a == "*":
        return
    if isinstance(a, dict) and isinstance(b, dict):
        own = [max(width, default=slack / 2) for width in (list(bounds(a)), list(bounds(b)))]
        for key in [*a, *(key for key in b if key not in a)]:
            inside = f"{where}.{key}" if where else key
            if key not in b or key not in a:
                yield f"{inside}: {'missing' if key in a else 'new, with no pinned value'}"
            elif key == "error_bounds" or is_bound(key):
                yield from grown(a[key], b[key], inside, EXACT * largest)
            else:
                yield from unequal(a[key], b[key], inside, relative, sum(own), largest)
    elif isinstance(a, list) and isinstance(b, list):
        if len(a) != len(b):
            yield f"{where}: {len(b)} entries, pinned {len(a)}"
        for n, (one, other) in enumerate(zip(a, b, strict=False)):
            yield from unequal(one, other, f"{where}[{n}]", relative, slack, largest)
    elif isinstance(a, str) and isinstance(b, str):
        if a != b and b not in a.split("|") and not same_fraction(a, b):
            yield differs
    elif isinstance(a, bool) or isinstance(b, bool) or not is_number(a) or not is_number(b):
        if type(a) is not type(b) or a != b:
            yield differs
    elif isinstance(a, int) and isinstance(b, int):
        if a != b:
            yield differs
    elif not abs(a - b) <= max(relative * abs(a), slack, 1e-15 * largest):
        yield differs


def grown(a: Any, b: Any, where: str, allowed: float) -> Iterator[str]:
    """Yield the error bounds that are larger than the pinned ones, and than what is allowed."""
    if isinstance(a, dict) and isinstance(b, dict):
        if a.keys() != b.keys():
            yield f"{where}: bounds of {sorted(b)}, pinned {sorted(a)}"
        for key in a.keys() & b.keys():
            yield from grown(a[key], b[key], f"{where}.{key}", allowed)
    elif not (is_number(a) and is_number(b)):
        if a != b:
            yield f"{where}: {b}, pinned {a}"
    elif not 0 <= b <= max(a, allowed):
        yield f"{where}: a bound of {b}, pinned {a}"


def is_number(value: Any) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool)


def same_fraction(a: str, b: str) -> bool:
    try:
        return Fraction(a) == Fraction(b)
    except (ValueError, ZeroDivisionError):
        return False
