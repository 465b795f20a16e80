"""The main job: work out every claim, draw, and write everything beside a run record."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

from tqdm import tqdm

from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.paper_repro.claims import Judged, PaperClaim, all_claims, judge
from exact_mdp.paper_repro.claims.judge import tried_again, verdicts
from exact_mdp.paper_repro.claims.under import Readings
from exact_mdp.paper_repro.expected import disagreements, expected
from exact_mdp.paper_repro.readings.study import reading_study
from exact_mdp.paper_repro.report.output import entry_of, numbers_of
from exact_mdp.paper_repro.store import Store
from exact_mdp.paper_repro.view import SEED, Sizes, View, alternatives, default_view

ALTERNATIVES = 16


def run(
    out: Path, *, sizes: Sizes, quick: bool, scheduler: str | None = None
) -> tuple[list[Judged], list[str]]:
    """Write numbers, report, figures and run record into `out`.

    Parameters
    ----------
    out : folder, made where it does not exist; what an interrupted run left there is used
    sizes : how much is sampled
    quick : said in run.json
    scheduler : a Dask cluster for the search over the readings and the training under them

    Returns
    -------
    judged : every claim
    off : what differs from the pinned values; nothing where all agree
    """
    from exact_mdp.paper_repro.report.figures import PICTURES, draw_all
    from exact_mdp.paper_repro.report.parts import agents_part, readings_part
    from exact_mdp.paper_repro.report.report import Shown, render
    from exact_mdp.paper_repro.report.tables import all_tables

    started = time.perf_counter()
    store = Store.under(out)
    store.clear_others()
    reused = store.used
    view = default_view(sizes, store)
    claims = all_claims()
    figures = [
        Shown(name=p.name, title=p.title, caption=p.caption, alt=p.alt, place=p.place)
        for p in PICTURES
    ]
    agents, drawn = agents_part()
    with _bar(len(claims) + ALTERNATIVES + sizes.supported + len(PICTURES) + 3) as bar:
        tick = partial(_tick, bar)
        tick("all readings of the text")
        study = reading_study(
            seed=SEED,
            out=store.folder("readings"),
            quick=quick,
            scheduler=scheduler,
            progress=True,
        )
        readings = Readings.of(study)
        others = list(_others(view, sizes, readings))
        # Other processes take what needs no training: other readings, and most of the figures.
        apart = replace(view)
        drawn |= {p.name: partial(p.draw, apart) for p in PICTURES if not p.learns}
        again = tried_again(claims, readings)
        draw = partial(draw_all, folder=out / "figures", dpi=sizes.dpi)
        work = [partial(draw, part) for part in _parts(drawn)]
        work += [partial(verdicts, other, again) for other in others]
        with _beside(work) as finished:
            judged = judge(
                claims, view, others=_after(finished, others), readings=readings, progress=tick
            )
        part, more = readings_part(study)
        draw(more, progress=tick)
        draw({p.name: partial(p.draw, view) for p in PICTURES if p.learns}, progress=tick)
        parts = [part, agents]
    off = disagreements(judged, expected())
    record = _record(view, sizes, quick, time.perf_counter() - started, reused)
    markdown, page = render(
        out, judged=judged, view=view, tables=all_tables(view), figures=figures, parts=parts,
        record=record, pinned=off,
    )  # fmt: skip
    record.pop("shown")
    _write(out / "numbers.json", numbers_of(judged))
    _write(out / "claims.json", [entry_of(each) for each in judged])
    write_atomically(out / "report.md", markdown)
    write_atomically(out / "report.html", page)
    _write(out / "run.json", record)
    return judged, off


def run_claims(
    claims: Sequence[PaperClaim],
    sizes: Sizes,
    store: Store,
    *,
    quick: bool,
    scheduler: str | None = None,
) -> list[Judged]:
    """Work some claims out, with as little else as they need.

    A quick run tries readings that differ from the default in one point; a full one searches all
    readings, which takes a minute or two unless `store` holds the search.
    """
    view = default_view(sizes, store)
    if quick or not any(claim.open for claim in claims):
        return judge(claims, view, others=alternatives(view, sizes))
    readings = Readings.run(store.folder("readings"), scheduler=scheduler, progress=True)
    return judge(claims, view, others=_others(view, sizes, readings), readings=readings)


def _others(view: View, sizes: Sizes, readings: Readings) -> Iterator[View]:
    return chain(alternatives(view, sizes), readings.best(view, sizes))


@contextmanager
def _beside(work: Sequence[Callable[[], object]]) -> Iterator[Iterator[object]]:
    """Start work in other processes, one for each core; give what they return, in order."""
    from joblib import Parallel, delayed

    parallel = Parallel(n_jobs=-1, return_as="generator", batch_size=1)
    with closing(parallel(delayed(each)() for each in work)) as finished:
        yield finished


def _after(finished: Iterator[object], views: Sequence[View]) -> Iterator[View]:
    """Yield views once the work on them is done, so that it is found in the store."""
    for _ in finished:
        pass
    yield from views


def _parts(drawn: Mapping[str, Callable[[], Any]]) -> list[dict[str, Callable[[], Any]]]:
    """Return figures in two parts: those of the agents, which share what they show, and others."""
    parts: list[dict[str, Callable[[], Any]]] = [{}, {}]
    for name, draw in drawn.items():
        parts[not name.startswith("agents_")][name] = draw
    return parts


def _bar(total: int) -> Any:
    return tqdm(total=total, disable=not sys.stderr.isatty(), leave=False)


def _tick(bar: Any, what: str) -> None:
    bar.set_description(f"{what:36.36}")
    bar.update()


def _write(path: Path, data: object) -> None:
    write_atomically(path, json.dumps(data, indent=1, ensure_ascii=False) + "\n")


def _record(view: View, sizes: Sizes, quick: bool, seconds: float, reused: bool) -> dict[str, Any]:
    scenario = view.scenario
    record = run_record(view.mdp, model=scenario.name, solver="auto", seed=SEED)
    record |= {
        "seconds": round(seconds, 2),
        "quick": quick,
        "reused": "with finished parts of an earlier run" if reused else "from nothing",
        "episodes": sizes.episodes,
        "training_runs": sizes.runs,
        "readings": dict(scenario.readings),
        "tasks": list(scenario.tasks),
        "max_trial": scenario.max_trial,
        "discount": str(scenario.discount),
    }
    shown = {
        "model": f"{record['model']}, {record['model_hash']}",
        "seed": SEED,
        "training runs of each schedule": sizes.runs,
        "simulated episodes behind each check": f"{sizes.episodes:,}",
        "versions": ", ".join(f"{name} {v}" for name, v in record["versions"].items()),
        "platform": record["platform"],
        "commit": record["commit"] or "not a checkout",
        "date": record["date"],
    }
    return record | {"shown": shown}
