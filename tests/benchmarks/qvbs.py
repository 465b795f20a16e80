"""Models with published exact answers: each property solved and proven, fraction for fraction.

    python tests/benchmarks/qvbs.py FOLDER [--only TEXT] [--out FILE.json]

FOLDER holds models (.umb, .npz) and `index.json`, a list with one entry for each property:

    file, property   the model, in FOLDER, and what the property is called
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
`solve`, and for `certify` with its check, once libraries and compiled loops are loaded; memory is
the most that the process held. The ratio is that of the second to the other tool's time, which is
for the answer alone. The exit status is 1 where an answer is missing or not the published one.

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
from fractions import Fraction
from importlib import import_module
from itertools import groupby
from math import isinf
from pathlib import Path
from statistics import median
from time import process_time
from typing import Any

from exact_mdp import MDP, certify, load, solve

LIMIT = 300  # seconds for all properties of one file
Entry = dict[str, Any]


def asked(mdp: MDP, entry: Entry) -> MDP:
    """Return the model whose optimal value is the answer."""
    sense = "min" if entry["objective"] == "min" else "max"
    mdp = mdp.with_(start=entry.get("start") or 0, sense=sense)
    if entry["measure"] == "reach":
        return mdp.reaching(entry["target"], entry.get("allowed"))
    return mdp.until(entry["target"], entry.get("reward"))


def published(entry: Entry) -> Fraction | float:
    if entry["value"] in ("inf", "-inf"):
        return float(entry["value"])
    top, _, bottom = entry["value"].partition("/")  # of any length
    return Fraction(int(top), int(bottom or 1))


def bounded(model: MDP, value: Fraction | float) -> bool:
    """Whether a bounded answer holds the published one."""
    start = solve(model).start
    low, high = start.interval
    return bool(start.value == value if isinf(value) else Fraction(low) <= value <= Fraction(high))


def certified(model: MDP, value: Fraction | float) -> bool:
    proof = certify(model)
    return proof.start_value == value and proof.violations() == []


# ---- one file, in a process of its own -----------------------------------------------------------


def work(folder: Path, entries: list[Entry]) -> None:
    """Print what came out for each property of one file."""
    warnings.simplefilter("ignore")
    load_libraries()
    mdp = load(folder / entries[0]["file"])
    for entry in entries:
        out: Entry = {}
        for name, answer in (("float", bounded), ("exact", certified)):
            try:
                model, begun = asked(mdp, entry), process_time()
                out[f"{name}_right"] = answer(model, published(entry))
                out[f"{name}_seconds"] = process_time() - begun
            except Exception as error:
                out[f"{name}_right"], out[f"{name}_error"] = False, f"{error!r}"[:300]
        out["megabytes"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        print(json.dumps(out), flush=True)


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


# ---- all of them ---------------------------------------------------------------------------------


def run(folder: Path, entries: list[Entry]) -> list[Entry]:
    """Return what came out for each property, file by file; prints a line for each."""
    results = []
    for _, group in groupby(entries, key=lambda entry: entry["file"]):
        listed = list(group)
        program = [sys.executable, __file__, str(folder), "--work", json.dumps(listed)]
        try:
            done = subprocess.run(program, capture_output=True, encoding="utf-8", timeout=LIMIT)
            printed, why = done.stdout, done.stderr[-200:]
        except subprocess.TimeoutExpired as error:
            printed, why = (error.stdout or b"").decode(), f"over {LIMIT} seconds"
        answers = [json.loads(line) for line in printed.splitlines() if line.startswith("{")]
        answers += [{"exact_error": f"no answer: {why}"}] * (len(listed) - len(answers))
        for entry, answer in zip(listed, answers, strict=True):
            row = entry | answer
            if row.get("storm_cpu_seconds") and "exact_seconds" in row:
                row["ratio"] = row["exact_seconds"] / row["storm_cpu_seconds"]
            parts = [f"{row['file'][:38]} {row['property']:<18}"]
            for name in ("float", "exact"):
                right = "ok" if row.get(f"{name}_right") else "WRONG"
                parts.append(f"{right:>5} {row.get(f'{name}_seconds', float('nan')):7.3f} s")
            parts.append(f"{row.get('megabytes', 0):6.0f} MB  x {row.get('ratio', 0):8.1f}")
            print("  ".join(parts + [row[k] for k in row if k.endswith("_error")]), flush=True)
            results.append(row)
    return results


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--only", default="", help="files with this text in their names")
    parser.add_argument("--out", type=Path, help="write all results as JSON")
    parser.add_argument("--work", help=argparse.SUPPRESS)
    given = parser.parse_args()
    sys.set_int_max_str_digits(0)
    if given.work:
        work(given.folder, json.loads(given.work))
        return 0
    index = json.loads((given.folder / "index.json").read_text("utf-8"))
    results = run(given.folder, [entry for entry in index if given.only in entry["file"]])
    for name in ("float", "exact"):
        seconds = [row.get(f"{name}_seconds", float("inf")) for row in results]
        right = sum(bool(row.get(f"{name}_right")) for row in results)
        print(f"{name}: {right} of {len(results)} right; median {median(seconds):.3g} s, "
              f"worst {max(seconds):.3g} s")  # fmt: skip
    ratios = [row["ratio"] for row in results if "ratio" in row and row.get("states", 0) > 1000]
    if ratios:
        print(f"over 1,000 states: ratio {median(ratios):.3g}, at worst {max(ratios):.3g}")
    if given.out:
        given.out.write_text(json.dumps(results, indent=1), encoding="utf-8")
    return 0 if all(row.get("float_right") and row.get("exact_right") for row in results) else 1


if __name__ == "__main__":
    sys.exit(main())
