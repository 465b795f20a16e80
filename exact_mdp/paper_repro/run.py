"""The main job: work out every claim, draw, and write everything beside a run record."""

from __future__ import annotations

import json
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import replace
from functools import partial
from itertools import chain
from pathlib import Path
from typing import Any

import click
import tqdm

from exact_mdp.analysis.exit_status import warner
from exact_mdp.analysis.record import run_record
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.paper_repro.claims import Judged, PaperClaim, Verdict, all_claims, chosen, judge
from exact_mdp.paper_repro.claims.judge import (
    best_supported,
    candidates,
    disagreements,
    expected,
    tried_again,
    verdicts,
)
from exact_mdp.paper_repro.reading import (
    FULL,
    QUICK,
    SEED,
    Reading,
    Sizes,
    Store,
    alternatives,
    changed,
    default,
)
from exact_mdp.paper_repro.readings.evidence import Evidence
from exact_mdp.paper_repro.readings.findings import reading_study, weighed, weighed_before
from exact_mdp.paper_repro.report import agents, learner, output, readings, tradeoffs
from exact_mdp.paper_repro.report.figures import PICTURES, draw_all
from exact_mdp.paper_repro.report.output import counted, entry_of
from exact_mdp.paper_repro.report.report import render, summary
from exact_mdp.paper_repro.report.tables import all_tables

Work = Callable[[], object]


def reproduce(
    out: Path,
    quick: bool,
    name: str | None,
    form: bool,
    sets: Sequence[str] = (),
) -> bool:
    """Print one claim or all of them, perhaps in the `form` of expected.toml, or what changes.

    Returns whether a number differs from the pinned one.
    """
    sizes = QUICK if quick else FULL
    if sets:
        changed(default(sizes), sets)  # a wrong name leaves no folder
        compare(sets, sizes, Store.under(out), quick=quick)
        return False
    if name is not None:
        claims = [chosen(name)]  # a wrong name leaves no folder
        store = Store.under(out)
        (found,) = run_claims(claims, sizes, store, quick=quick)
        output.print_claim(found)
        return False
    judged, off = run(out, sizes=sizes, quick=quick)
    if form:
        click.echo(candidates(judged))
        return False
    output.print_table(judged)
    output.print_places(out)
    for line in off:
        click.echo(f"differs from expected.toml: {line}", err=True)
    return bool(off)


def run(out: Path, *, sizes: Sizes, quick: bool) -> tuple[list[Judged], list[str]]:
    """Write numbers, report, figures and run record into `out`.

    What an interrupted run left there is used. Returns every claim, and what differs from the
    pinned values.
    """
    started = time.perf_counter()
    store = Store.under(out)
    store.clear_others()
    reused, reading, claims = store.used, default(sizes, store), all_claims()
    with tqdm.tqdm(disable=not sys.stderr.isatty(), leave=False) as bar:
        tick = partial(_tick, bar)
        tick("all readings of the text")
        study = reading_study(seed=SEED, out=store.folder("readings"), quick=quick, progress=True)
        others = list(_others(reading, sizes, study.main))
        bar.total = bar.n + len(claims) + len(others) + len(readings.PICTURES) + len(PICTURES)
        again, draw = tried_again(claims, study.main), partial(draw_all, folder=out / "figures")
        draw = partial(draw, dpi=sizes.dpi)
        # Other processes take what needs no training: other readings, and most of the figures.
        # The figures of the agents share what they show.
        apart = replace(reading)
        still: dict[str, Callable[[], Any]] = {
            p.name: partial(p.draw, apart) for p in (*PICTURES, *tradeoffs.PICTURES) if not p.learns
        }
        work: list[Work] = [
            partial(draw, {p.name: p.draw for p in agents.PICTURES}),
            partial(draw, still),
            *(partial(verdicts, other, again) for other in others),
        ]
        with _beside(work) as finished:
            judged = judge(
                claims,
                reading,
                others=_after(finished, others),
                learners=reading.learners,
                evidence=study.main,
                progress=tick,
            )
        draw({p.name: partial(p.draw, study) for p in readings.PICTURES}, progress=tick)
        draw({p.name: partial(p.draw, reading) for p in PICTURES if p.learns}, progress=tick)
    off = disagreements(judged, expected())
    record = _record(reading, sizes, quick)
    record |= {
        "seconds": round(time.perf_counter() - started, 2),
        "reused": "with finished parts of an earlier run" if reused else "from nothing",
    }
    markdown, page = render(
        out,
        judged=judged,
        reading=reading,
        tables=all_tables(reading),
        figures=PICTURES,
        parts=[
            learner.learner_part(judged, reading),
            readings.readings_part(study, reading),
            tradeoffs.tradeoffs_part(reading),
            agents.agents_part(),
        ],
        record=record,
        pinned=off,
        main=study.main,
    )
    entries = [entry_of(each) for each in judged]
    _write(out / "numbers.json", [each for each in entries if each["exact"] is not None])
    _write(out / "claims.json", entries)
    write_atomically(out / "report.md", markdown)
    write_atomically(out / "report.html", page)
    write_atomically(out / "summary.html", summary(judged, reading, study.main, record))
    _write(out / "run.json", record)
    return judged, off


def summarise(out: Path, *, quick: bool) -> None:
    """Write the page for those who read no more: every claim is worked out, nothing is drawn."""
    sizes, store = QUICK if quick else FULL, Store.under(out)
    reading, folder = default(sizes, store), store.folder("readings")
    found, *_ = weighed(seed=SEED, out=folder, quick=quick, progress=True)
    others = _others(reading, sizes, found)
    judged = judge(
        all_claims(),
        reading,
        others=others,
        learners=reading.learners,
        evidence=found,
        progress=_say,
    )
    page = out / "summary.html"
    write_atomically(page, summary(judged, reading, found, _record(reading, sizes, quick)))
    click.echo(counted(judged))
    click.echo(f"One page: {page}")


def run_claims(
    claims: Sequence[PaperClaim],
    sizes: Sizes,
    store: Store,
    *,
    quick: bool,
) -> list[Judged]:
    """Work some claims out, with as little else as they need.

    Open claims are tried under the readings that differ from the default in one point; under all
    of them where `store` holds the search over these and the training that weighs it, as the main
    job leaves them.
    """
    reading = default(sizes, store)
    folder = store.folder("readings")
    known = [size for size in (False, True) if weighed_before(folder, quick=size)]
    if quick or not any(claim.open for claim in claims) or not known:
        others, learners = _alike(reading, claims), [] if quick else reading.learners
        return judge(claims, reading, others=others, learners=learners, progress=_say)
    found, *_ = weighed(seed=SEED, out=folder, quick=known[0], progress=True)
    others = _others(reading, sizes, found)
    return judge(claims, reading, others=others, evidence=found, progress=_say)


def compare(sets: Sequence[str], sizes: Sizes, store: Store, *, quick: bool) -> None:
    """Print which verdicts change under KEY=VALUE changes; a quick run leaves learning out.

    A default verdict that changes is shown as the page has it, other readings tried.
    """
    reading = default(sizes, store)
    other = changed(reading, sets)
    claims = [claim for claim in all_claims() if not (quick and claim.learns)]
    if quick:
        left = len(all_claims()) - len(claims)
        click.echo(f"{left} claims take training runs; --quick leaves them out, all of them")
        if other.training:
            click.echo("so no claim about training is compared: leave --quick out for these")
    before = judge(claims, reading, progress=_say)
    after = judge(claims, other, progress=_say)
    pairs = [
        (was, now)
        for was, now in zip(before, after, strict=True)
        if was.finding.verdict is not now.finding.verdict
    ]
    unsure = [was.claim for was, _ in pairs if was.finding.verdict is Verdict.NOT_REPRODUCED]
    again = run_claims(unsure, sizes, store, quick=quick) if unsure else []
    page = {each.claim.id: each for each in again}
    shown = [(page.get(was.claim.id, was), now) for was, now in pairs]
    output.print_changes(other.label, shown, len(claims))


def _say(what: str) -> None:
    """Say on standard error what is worked out, where no bar shows it."""
    click.echo(f"{what} …", err=True)


def _others(reading: Reading, sizes: Sizes, found: Evidence) -> Iterator[Reading]:
    return chain(alternatives(reading), best_supported(found, reading, sizes))


def _alike(reading: Reading, claims: Sequence[PaperClaim]) -> Iterator[Reading]:
    """Yield the readings with one change; training is taken to end with the completions as here."""
    learns = any(claim.learns for claim in claims)
    yield from alternatives(replace(reading, ends=reading.completions) if learns else reading)


@contextmanager
def _beside(work: Sequence[Work]) -> Iterator[Iterator[object]]:
    """Start work in other processes, one for each core; give what they return, in order."""
    import joblib

    parallel = joblib.Parallel(n_jobs=-1, return_as="generator", batch_size=1)
    with closing(parallel(joblib.delayed(_done)(each) for each in work)) as finished:
        yield finished


_WARN = warner()  # tells each text once in a process


def _done(work: Work) -> object:
    """Do what is worked on in another process, which tells warnings as the command does."""
    warnings.showwarning = _WARN
    return work()


def _after(finished: Iterator[object], others: Sequence[Reading]) -> Iterator[Reading]:
    """Yield readings once the work on them is done, so that it is found in the store."""
    for _ in finished:
        pass
    yield from others


def _tick(bar: Any, what: str) -> None:
    bar.set_description(f"{what:36.36}")
    bar.update()


def _write(path: Path, data: object) -> None:
    write_atomically(path, json.dumps(data, indent=1, ensure_ascii=False) + "\n")


def _record(reading: Reading, sizes: Sizes, quick: bool) -> dict[str, Any]:
    scenario = reading.scenario
    record = run_record(reading.mdp, model=scenario.name, solver="auto", seed=SEED)
    return record | {
        "quick": quick,
        "episodes": sizes.episodes,
        "training_runs": sizes.runs,
        "readings": dict(scenario.readings),
        "tasks": list(scenario.tasks),
        "max_trial": scenario.max_trial,
        "discount": str(scenario.discount),
    }
