"""Us and other solvers side by side: same data, one run, every answer checked before it is timed.

    python tests/benchmarks/compare.py [--quick] [--only NAME] [--largest STATES] [--rounds 3]

Each solver works in a process of its own, round after round in turn, so that all meet the same
noise. An answer counts where it is within tolerance of a reference whose Bellman residual, worked
out by SciPy alone, proves it, and within the bound that its solver claims; a wrong one is reported
as wrong and not timed. Writes RESULTS.md, results.json and a figure. A part of the models may
be measured alone: what results.json holds of the others is kept.
"""

from __future__ import annotations

import argparse
import ctypes
import gc
import json
import os
import pickle
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np
from contenders import CONTENDERS, FAR, OURS, SECONDS, TOLERANCE, timed
from numpy.typing import NDArray
from workloads import FULL, QUICK, Workload, garnet

HERE = Path(__file__).parent
SHORT, MOST_REPEATS = 0.5, 100  # seconds that short calls are repeated for, and how often at most
MOST_FOR_LISTS = 4_000_000  # transitions that lists for mdpsolver and Storm are made of
LINEAR_PROGRAMS = {"linear program": [lambda n=n: garnet(n, 0.95) for n in (100, 300, 1000)]}


# ---- one solver, in a process of its own ---------------------------------------------------------


def work(path: str, family: str, contender: str, repeats: int, values: str) -> None:
    """Solve a saved workload and print what it took as JSON."""
    workload: Workload = pickle.loads(Path(path).read_bytes())
    run = partial(timed, workload, *CONTENDERS[family][contender](workload))
    before = _at_rest()
    answers = [run()]
    slow, first = answers[0].seconds, _resident("VmHWM") - before
    before = _at_rest() if slow < 20 else before
    ends = perf_counter() + SHORT
    for number in range(MOST_REPEATS if slow < 2 else 1 if slow < 20 else 0):
        if number >= repeats and perf_counter() > ends:
            break
        answers.append(run())
    peak = _resident("VmHWM")
    np.save(values, answers[-1].value)
    best = min(answers[1:] or answers, key=lambda answer: answer.seconds)
    print(
        json.dumps(
            {
                "first": answers[0].seconds,
                "seconds": best.seconds,
                "solving": best.solving,
                "bound": best.bound,
                "memory": max(0, peak - before),
                "first memory": max(0, first),
                "note": best.note,
            }
        )
    )


def _at_rest() -> int:
    """Give back to the system what nobody holds; count the peak from here on, and return this."""
    gc.collect()
    ctypes.CDLL(None).malloc_trim(0)
    Path("/proc/self/clear_refs").write_text("5")
    return _resident()


def _resident(what: str = "VmRSS") -> int:
    """Return bytes in memory, now or (VmHWM) at most since `_at_rest`."""
    for line in Path("/proc/self/status").read_text().splitlines():
        if line.startswith(what):
            return int(line.split()[1]) * 1024
    raise RuntimeError(f"/proc/self/status does not tell {what}")


# ---- the reference -------------------------------------------------------------------------------


def backup(workload: Workload, value: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return (S,) T V, by SciPy and NumPy alone."""
    q = workload.reward + workload.discount * (workload.transition @ value)
    return np.maximum.reduceat(q, workload.first)


def reference(workload: Workload) -> tuple[NDArray[np.float64], float]:
    """Return values and how far they can be from the optimum, by their Bellman residual.

    At discount 1 the bound is the residual times the number of layers.
    """
    from exact_mdp import PolicyIteration, solve

    value = solve(workload.model(), None if "layered" in workload.name else PolicyIteration()).value
    residual = float(np.abs(backup(workload, value) - value).max())
    steps = 5 * workload.size + 1 if workload.discount == 1 else 1 / (1 - workload.discount)
    return value, residual * steps


# ---- the run -------------------------------------------------------------------------------------


def measure(family: str, workload: Workload, rounds: int, folder: Path) -> Iterator[dict[str, Any]]:
    """Yield a row for each solver of a family on one model."""
    value, proven = reference(workload)
    allowed = TOLERANCE * max(1.0, float(np.abs(value).max()) * 1e-3) + proven
    path = folder / "workload"
    path.write_bytes(pickle.dumps(workload))
    contenders = dict(CONTENDERS[family])
    if workload.transition.nnz > MOST_FOR_LISTS:
        for name in ("mdpsolver MPI", "Storm, topological"):
            contenders.pop(name, None)
    timings: dict[str, list[dict[str, Any]]] = {name: [] for name in contenders}
    spent = dict.fromkeys(contenders, 0.0)
    errors: dict[str, float] = {}
    for turn in range(rounds):
        for name in contenders:
            if turn and (not timings[name] or _is_far(timings[name], timings)):
                continue
            started = perf_counter()
            once = _in_a_process(path, family, name, folder / "values.npy")
            spent[name] += perf_counter() - started
            if once is not None:
                timings[name].append(once)
                gap = np.abs(np.load(folder / "values.npy") - value)
                errors[name] = max(errors.get(name, 0.0), float(gap.max()))
    for name, runs in timings.items():
        row = {
            "family": family,
            "size": workload.size,
            "states": workload.states,
            "transitions": int(workload.transition.nnz),
            "bytes": workload.bytes,
            "contender": name,
            "measured": f"{datetime.now(UTC):%Y-%m-%d}",
            "spent": round(spent[name], 1),
            "reference proven within": proven,
            "allowed": allowed,
        }
        if not runs:
            yield row | {"verdict": f"no answer within {SECONDS} s, or an error"}
        elif errors[name] > min(allowed, (runs[0]["bound"] or np.inf) + proven):
            yield row | {"verdict": "wrong", "error": errors[name]}
        else:
            yield row | {
                "verdict": "right",
                "error": errors[name],
                "seconds": [run["seconds"] for run in runs],
                "solving": [run["solving"] for run in runs],
                "first": [run["first"] for run in runs],
                "memory": min(run["memory"] for run in runs),
                "first memory": min(run["first memory"] for run in runs),
                "bound": runs[0]["bound"],
                "note": runs[0]["note"],
            }


def _is_far(own: list[dict[str, Any]], timings: dict[str, list[dict[str, Any]]]) -> bool:
    """Return whether a solver took many times as long as ours, so that noise does not matter."""
    ours = [each["seconds"] for name, runs in timings.items() if OURS in name for each in runs]
    return bool(ours) and own[0]["seconds"] > FAR * min(ours)


def _in_a_process(path: Path, family: str, name: str, values: Path) -> dict[str, Any] | None:
    command = [sys.executable, str(HERE / "compare.py"), "--work", str(path), family, name]
    environment = dict(os.environ)
    environment["PYTHONPATH"] = os.pathsep.join([str(HERE.parent.parent), str(HERE)])
    try:
        done = subprocess.run(
            [*command, "--values", str(values)],
            capture_output=True, text=True, timeout=SECONDS, env=environment, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        print(f"    {name}: stopped after {SECONDS} s", file=sys.stderr)
        return None
    if done.returncode:
        print(f"    {name}: {done.stderr.strip().splitlines()[-1:]}", file=sys.stderr)
        return None
    return json.loads(done.stdout.splitlines()[-1])


def read_once(gigabytes: float = 0.8) -> float:
    """Return the bytes that this machine reads in a second: a dot product, all its threads."""
    x = np.ones(int(gigabytes * 1e9 / 8))
    seconds = []
    for _ in range(5):
        started = perf_counter()
        float(x @ x)
        seconds.append(perf_counter() - started)
    return x.nbytes / min(seconds)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--quick", action="store_true", help="the two smallest sizes of each")
    parser.add_argument("--only", default="", help="families whose name contains this")
    parser.add_argument("--largest", type=float, default=np.inf, help="most states")
    parser.add_argument("--out", type=Path, default=HERE)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--work", nargs=3, metavar=("FILE", "FAMILY", "SOLVER"))
    parser.add_argument("--values")
    options = parser.parse_args()
    if options.work:
        work(*options.work, repeats=3, values=options.values)
        return
    from results import write

    families = (QUICK if options.quick else FULL) | LINEAR_PROGRAMS
    earlier = options.out / "results.json"
    part = options.quick or options.only or options.largest < np.inf
    rows = json.loads(earlier.read_text()) if part and earlier.exists() else []
    bandwidth = read_once()
    with tempfile.TemporaryDirectory() as folder:
        for family, sizes in families.items():
            if options.only not in family:
                continue
            for build in sizes:
                workload = build()
                if workload.states > options.largest:
                    continue
                print(f"{family}, {workload.states:,} states", file=sys.stderr, flush=True)
                same = (family, workload.states)
                rows = [row for row in rows if (row["family"], row["states"]) != same]
                for row in measure(family, workload, options.rounds, Path(folder)):
                    rows.append(row)
                    shown = f"{min(row['seconds']):.4f} s" if "seconds" in row else row["verdict"]
                    print(f"    {row['contender']:24} {shown}", file=sys.stderr, flush=True)
                names = list(FULL | LINEAR_PROGRAMS)
                rows = [row for row in rows if row["family"] in names]
                rows.sort(key=lambda row: (names.index(row["family"]), row["states"]))
                write(rows, bandwidth, options.out)
    slow = [row for row in rows if row["verdict"] == "wrong" and row["contender"].startswith(OURS)]
    sys.exit(1 if slow else 0)


if __name__ == "__main__":
    main()
