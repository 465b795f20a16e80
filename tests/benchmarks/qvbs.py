"""Models with published exact answers: each property solved and proven, fraction for fraction.

    python tests/benchmarks/qvbs.py FOLDER [--only TEXT] [--quick] [--out FILE.json]

FOLDER holds models (.umb, .npz) and `index.json`, a list with one entry for each property:

    file             the model, in FOLDER
    measure          "reach": the probability of reaching `target`, "reward": the expected reward
                     until then
    target, allowed  labels; allowed is null where all states may be passed through
    reward           the name of a reward model, for "reward"
    objective        "max", "min", or null for a Markov chain
    start            a state, where the file has several initial ones (0)
    value            the published answer, "p/q", "inf" or "-inf"
    storm_cpu_seconds   what another tool took for model checking alone, optional

Each file is read in a process of its own, and every property answered twice: in floats with a
bound, and exactly with a certificate that the checker accepts. Seconds are the processor's, for
`solve`, and for `certify` with its check, without reading, and once libraries and compiled loops
are loaded (a first small model sees to it: small ones do without); memory is the most that the
process held. Then the property is asked on the command line, from start to finish by the clock,
unless --quick is given. The ratio is that of `certify` with its check to the other tool's time,
which is for the answer alone. The exit status is 1 where an answer is missing or not the published
one.

Any folder of this form will do. The Quantitative Verification Benchmark Set (Hartmanns, Klauck,
Parker, Quatmann and Ruijters, TACAS 2019, doi 10.1007/978-3-030-17462-0_20) publishes such answers.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import warnings
from collections.abc import Iterable, Iterator
from fractions import Fraction
from importlib import import_module
from itertools import groupby
from math import inf
from pathlib import Path
from statistics import median
from time import perf_counter, process_time
from typing import Any

from exact_mdp import MDP, certify, load, solve

LIMIT = 300  # seconds for all properties of one file, and for one command
Entry = dict[str, Any]


def asked(mdp: MDP, entry: Entry) -> MDP:
    """Return the model whose optimal value is the answer."""
    sense = "min" if entry["objective"] == "min" else "max"
    mdp = mdp.with_(start=entry.get("start") or 0, sense=sense)
    if entry["measure"] == "reach":
        return mdp.reaching(entry["target"], entry.get("allowed"))
    return mdp.until(entry["target"], entry.get("reward"))


def words(entry: Entry) -> list[str]:
    """Return the same question on the command line."""
    found = ["--reach" if entry["measure"] == "reach" else "--until", entry["target"]]
    found += ["--start", str(entry.get("start") or 0)]
    for key in ("allowed", "reward"):
        found += [f"--{key}", entry[key]] if entry.get(key) else []
    return [*found, *(["--minimize"] if entry["objective"] == "min" else [])]


def published(entry: Entry) -> Fraction | float:
    """Return the published answer."""
    text = entry["value"]
    return float(text) if text in ("inf", "-inf") else ratio(text)


def ratio(text: str) -> Fraction:
    """Return "p/q" as a number, of any length."""
    top, _, bottom = text.partition("/")
    return Fraction(int(top), int(bottom or 1))


def within(found: Any, value: Fraction | float) -> bool:
    """Return whether a bounded answer holds the published one."""
    if value in (inf, -inf):
        return bool(found.value == value)
    low, high = found.interval
    return bool(Fraction(low) <= value <= Fraction(high))


# ---- one file, in a process of its own -----------------------------------------------------------


def work(folder: Path, entries: Iterable[Entry]) -> Iterator[Entry]:
    """Yield what came out for each property of one file."""
    mdp = None
    load_libraries()
    for entry in entries:
        begun = process_time()
        mdp = load(folder / entry["file"]) if mdp is None else mdp
        found: Entry = {"reading": process_time() - begun}
        for name, answer in (("float", _bounded), ("exact", _certified)):
            try:
                model = asked(mdp, entry)
                begun = process_time()
                found[f"{name}_right"] = answer(model, published(entry))
                found[f"{name}_seconds"] = process_time() - begun
            except Exception as error:
                found[f"{name}_right"], found[f"{name}_error"] = False, f"{error!r}"[:300]
        found["megabytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        yield found


def load_libraries() -> None:
    """Answer a small model, of a cycle and of states in order, both ways, with compiled loops."""
    for name in ("numba", "scipy.sparse.csgraph"):
        import_module(name)
    size, part = 60, Fraction(1, 4)
    rows: list[Any] = [
        (s, a, [(part, (k * s + a + k) % size, 1 + s % 3) for k in (1, 7, 13)] + [(part, size, 0)])
        for s in range(size)
        for a in (0, 1)
    ]
    rows += [(size, 0, [(1, size, 0)]), (size + 1, 0, [(1, size + 1, 0)])]
    rows.append((size + 1, 1, [(1, size, 1)]))
    rows += [(s, a, [(1, s - 1 - a, a)]) for s in range(size + 3, 2 * size) for a in (0, 1)]
    rows.append((size + 2, 0, [(1, 0, 0)]))
    model = MDP.from_outcomes(rows)
    if certify(model).violations() or not solve(model).start.interval:
        raise RuntimeError("the small model is not solved")


def _bounded(model: MDP, value: Fraction | float) -> bool:
    return within(solve(model).start, value)


def _certified(model: MDP, value: Fraction | float) -> bool:
    proof = certify(model)
    return proof.start_value == value and proof.violations() == []


# ---- all of them ---------------------------------------------------------------------------------


def run(folder: Path, entries: list[Entry], *, command: bool) -> list[Entry]:
    """Return what came out for each property, file by file; prints a line for each."""
    results = []
    for file, listed in groupby(entries, key=lambda entry: entry["file"]):
        group = list(listed)
        program = [sys.executable, __file__, str(folder), "--work", json.dumps(group)]
        done = _launched(program)
        said = [json.loads(line) for line in done.splitlines() if line.startswith("{")]
        said += [{"exact_error": f"no answer: {done[-200:]}"}] * (len(group) - len(said))
        for entry, found in zip(group, said, strict=True):
            if command:
                found |= _commanded(folder / file, entry)
            storm = entry.get("storm_cpu_seconds")
            if storm and "exact_seconds" in found:
                found["ratio"] = found["exact_seconds"] / storm
            results.append(entry | found)
            print(_line(results[-1]), flush=True)
    return results


def _launched(program: list[str]) -> str:
    try:
        done = subprocess.run(program, capture_output=True, encoding="utf-8", timeout=LIMIT)
    except subprocess.TimeoutExpired as error:
        return (error.stdout or b"").decode() + f"\nover {LIMIT} seconds"
    return done.stdout if done.returncode in (0, 1) else done.stdout + done.stderr


def _commanded(path: Path, entry: Entry) -> Entry:
    """Return how the command line answers."""
    program = Path(sys.executable).with_name("exact-mdp")
    begun = perf_counter()
    said = _launched(
        [str(program), "solve", str(path), *words(entry), "--discount", "1", "--certify", "--json"]
    )
    seconds = perf_counter() - begun
    try:
        text = json.loads(said)["exact_start_value"]
    except (ValueError, KeyError):
        return {"command_right": False, "command_error": said[-300:], "command_seconds": seconds}
    found = float(text) if text in ("inf", "-inf") else ratio(text)
    return {"command_right": found == published(entry), "command_seconds": seconds}


def _line(row: Entry) -> str:
    def cell(name: str) -> str:
        right = {True: "ok", False: "WRONG", None: "-"}[row.get(f"{name}_right")]
        return f"{right:>5} {row.get(f'{name}_seconds', float('nan')):7.3f} s"

    title = f"{row['file'][:38]} {row['property']}"
    parts = [f"{title:<56}", *(cell(name) for name in ("float", "exact", "command"))]
    parts += [f"{row.get('megabytes', float('nan')):6.0f} MB", f"x {row.get('ratio', 0):8.1f}"]
    errors = [row[key] for key in row if key.endswith("_error")]
    return "  ".join([*parts, *errors])


def summary(results: list[Entry]) -> list[str]:
    """Return what all of it comes to."""
    lines = []
    for name in ("float", "exact", "command"):
        rows = [row for row in results if f"{name}_right" in row]
        if rows:
            seconds = [row[f"{name}_seconds"] for row in rows if f"{name}_seconds" in row] or [inf]
            right = sum(row[f"{name}_right"] for row in rows)
            lines.append(
                f"{name}: {right} of {len(rows)} right; median {median(seconds):.3g} s, "
                f"worst {max(seconds):.3g} s"
            )
    large = [row["ratio"] for row in results if "ratio" in row and row.get("states", 0) > 1000]
    if large:
        lines.append(
            f"models of over 1,000 states: ratio {median(large):.3g} in the median, "
            f"{max(large):.3g} at worst, at most 3 on {sum(ratio <= 3 for ratio in large)} of "
            f"{len(large)}"
        )
    most = max((row.get("megabytes", 0) for row in results), default=0)
    return [*lines, f"most memory: {most:.0f} MB"]


def main(arguments: list[str]) -> int:
    """Run the list; the exit status is 1 where an answer is missing or wrong."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="files with this text in their names")
    parser.add_argument("--quick", action="store_true", help="leave the command line out")
    parser.add_argument("--out", type=Path, help="write all results as JSON")
    parser.add_argument("--work", help=argparse.SUPPRESS)
    given = parser.parse_args(arguments)
    sys.set_int_max_str_digits(0)
    if given.work:
        warnings.simplefilter("ignore")
        for found in work(given.folder, json.loads(given.work)):
            print(json.dumps(found), flush=True)
        return 0
    index = json.loads((given.folder / "index.json").read_text(encoding="utf-8"))
    entries = [entry for entry in index if given.only in entry["file"]]
    results = run(given.folder, entries, command=not given.quick)
    print("\n".join(summary(results)))
    if given.out:
        given.out.write_text(json.dumps(results, indent=1), encoding="utf-8")
    names = ("float", "exact", *(() if given.quick else ("command",)))
    return 0 if all(row.get(f"{name}_right") for row in results for name in names) else 1


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
