"""`python -m paper_repro`: reproduce the paper and print paper, exact and difference."""

from __future__ import annotations

import time
from pathlib import Path

import click

from exact_mdp.analysis.exit_status import FAILED, Program


@click.command(cls=Program)
@click.option(
    "--quick",
    is_flag=True,
    help="Fewer training runs and simulated episodes; with --claim, fewer readings tried.",
)
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("results"),
    show_default=True,
    help="Folder for the report, numbers, figures and run.json; an interrupted run goes on there.",
)
@click.option(
    "--scheduler",
    metavar="ADDRESS",
    help="Search the readings and train under them on a Dask cluster: tcp://HOST:PORT, or local.",
)
@click.option("--claim", "name", metavar="ID", help="Work out this claim alone, and print it.")
@click.option(
    "--candidates", is_flag=True, help="Print what is found in the form of expected.toml."
)
def main(
    quick: bool, out: Path, scheduler: str | None, name: str | None, candidates: bool
) -> int | None:
    """Reproduce Yuan et al. (2025): every claim beside the exact answer.

    Exit status: 0 done, 1 a number differs from the pinned one, 2 bad input, 3 anything else.
    """
    started = time.perf_counter()
    try:
        if name is None:
            failed = _all(quick, out, scheduler, candidates)
        else:
            failed = _one(name, quick, out, scheduler, candidates)
    except KeyboardInterrupt as stop:
        if not getattr(stop, "__notes__", ()):
            stop.add_note(f"what is finished is kept in {out}, and the same command goes on")
        raise
    click.echo(f"done in {time.perf_counter() - started:.1f} s", err=True)
    return FAILED if failed else None


def _one(name: str, quick: bool, out: Path, scheduler: str | None, candidates: bool) -> bool:
    from exact_mdp.mdp import ModelError
    from exact_mdp.paper_repro.claims import chosen
    from exact_mdp.paper_repro.report.output import print_claim
    from exact_mdp.paper_repro.run import run_claims
    from exact_mdp.paper_repro.store import Store
    from exact_mdp.paper_repro.view import FULL, QUICK

    if candidates:
        raise ModelError(
            "--claim prints one claim and --candidates all of them",
            where="--candidates",
            fix="leave one of the two out",
        )
    if not name.strip():
        raise ModelError(
            "the name of the claim is empty",
            where="--claim",
            fix="give one, such as return.random; claims.json and the report list them",
        )
    claim = chosen(name)
    sizes, store = QUICK if quick else FULL, Store.under(out)
    (judged,) = run_claims([claim], sizes, store, quick=quick, scheduler=scheduler)
    print_claim(judged)
    return False


def _all(quick: bool, out: Path, scheduler: str | None, candidates: bool) -> bool:
    from exact_mdp.paper_repro import expected
    from exact_mdp.paper_repro.report.output import print_places, print_table
    from exact_mdp.paper_repro.run import run
    from exact_mdp.paper_repro.view import FULL, QUICK

    judged, off = run(out, sizes=QUICK if quick else FULL, quick=quick, scheduler=scheduler)
    if candidates:
        click.echo(expected.candidates(judged))
        return False
    print_table(judged)
    print_places(out)
    for line in off:
        click.echo(f"differs from expected.toml: {line}", err=True)
    return bool(off)


if __name__ == "__main__":
    main(prog_name="python -m paper_repro")
