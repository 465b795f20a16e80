"""`python -m paper_repro`: reproduce the paper and print paper, exact and difference."""

from __future__ import annotations

import time
from pathlib import Path

import click

from exact_mdp.analysis.exit_status import FAILED, Program
from exact_mdp.mdp.errors import ModelError, extra


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
    help="Folder for report, numbers, figures and run.json; an interrupted run continues there.",
)
@click.option(
    "--summary",
    is_flag=True,
    help="Write only summary.html, one page of A4 with what was found; no figures are drawn.",
)
@click.option("--claim", "name", metavar="ID", help="Work out only this claim, and print it.")
@click.option(
    "--set",
    "sets",
    multiple=True,
    metavar="KEY=VALUE",
    help="Print which verdicts change under another reading (readings.skip_timestep=own), "
    "parameter (base.anger=1/10) or setting of the learner (training.rate=0.1); repeatable. With "
    "--quick without the claims that take training runs.",
)
@click.option("--candidates", is_flag=True, help="Print the results in the form of expected.toml.")
def main(
    quick: bool,
    out: Path,
    summary: bool,
    name: str | None,
    sets: tuple[str, ...],
    candidates: bool,
) -> int | None:
    """Reproduce Yuan et al. (2025): every claim beside the exact answer.

    Exit status: 0 done, 1 a number differs from the pinned one, 2 bad input, 3 anything else.
    """
    started = time.perf_counter()
    if name is not None and candidates:
        raise ModelError(
            "--claim prints one claim and --candidates all of them",
            where="--candidates",
            fix="leave one of the two out",
        )
    if sets and (name is not None or candidates):
        raise ModelError(
            "--set compares all verdicts with those of the default reading",
            where="--set",
            fix=f"leave {'--candidates' if candidates else '--claim'} out",
        )
    if summary and (sets or name is not None or candidates):
        raise ModelError(
            "--summary is about all claims under the default reading",
            where="--summary",
            fix="leave --claim, --set and --candidates out",
        )
    if name is not None and not name.strip():
        raise ModelError(
            "the name of the claim is empty",
            where="--claim",
            fix="give one, such as return.random; claims.json and the report list them",
        )
    try:
        with extra("plots"):
            from exact_mdp.paper_repro import run as work  # the help does not wait for it
        if summary:
            work.summarise(out, quick=quick)
            failed = False
        else:
            failed = work.reproduce(out, quick, name, candidates, sets)
    except KeyboardInterrupt as stop:
        if not getattr(stop, "__notes__", ()):
            stop.add_note(f"what is finished is kept in {out}, and the same command goes on")
        raise
    click.echo(f"done in {time.perf_counter() - started:.1f} s", err=True)
    return FAILED if failed else None


if __name__ == "__main__":
    main(prog_name="python -m paper_repro")
