"""`python -m exact_mdp.paper_repro`: reproduce the paper, list its claims, check one."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from exact_mdp.analysis.exit_status import FAILED, Programs

OUT = click.Path(file_okay=False, path_type=Path)
RUNS = click.option(
    "--runs",
    default=100,
    type=click.IntRange(1),
    show_default=True,
    help="Training runs of each exploration schedule, where it takes any.",
)


@click.group(
    cls=Programs,
    invoke_without_command=True,
    context_settings={"help_option_names": ["-h", "--help"]},
)
@click.option("--quick", is_flag=True, help="Fewer training runs: half a minute on two cores.")
@click.option(
    "--out",
    type=OUT,
    default=Path("results"),
    show_default=True,
    help="Folder for report, numbers, figures and run.json; an interrupted run continues there.",
)
@click.option(
    "--readme",
    type=OUT,
    metavar="FOLDER",
    help="Also write README.md, results.json and the figures of a full run there.",
)
@click.pass_context
def main(context: click.Context, quick: bool, out: Path, readme: Path | None) -> int | None:
    """Reproduce Yuan et al. (2025): every claim beside the exact answer.

    Exit status: 0 done, 1 a number differs from the pinned one, 2 bad input, 3 anything else.
    """
    if context.invoked_subcommand is not None:
        return None
    if quick and readme is not None:
        raise click.UsageError("--readme is for a full run; leave --quick out.", context)
    if sys.stderr.isatty():
        print("loading …", end="", file=sys.stderr, flush=True)
    from exact_mdp.paper_repro import run  # the help does not wait for it

    try:
        results = run.run_reproduction(out, quick=quick, readme=readme)
    except KeyboardInterrupt as stop:
        if not getattr(stop, "__notes__", ()):
            stop.add_note(f"finished work is kept in {out}, and the same command goes on")
        raise
    click.echo(run.format_claim_table(results))
    click.echo(f"\nReport: {out / 'report.md'}; figures: {out / 'figures'} (SVG and PNG)")
    off = run.compare_with_pinned(results["claims"])
    for line in off:
        click.echo(f"differs from expected.toml: {line}", err=True)
    if not off:
        agree = f"All {len(results['claims'])} claims are as pinned in expected.toml"
        click.echo(f"{agree}: verdicts, and numbers within their tolerances")
    if off:
        return FAILED
    return None


@main.command("list")
def list_command() -> None:
    """List all claims with their places in the paper."""
    from exact_mdp.paper_repro import run

    click.echo(run.list_claims())


@main.command("claim")
@click.argument("name", metavar="ID")
@click.option(
    "--set",
    "sets",
    multiple=True,
    metavar="KEY=VALUE",
    help="Another reading (readings.skip_timestep=own, readings.respectively=swapped), parameter "
    "(base.anger=1/10) or setting of the learner (training.ties=random); repeatable.",
)
@RUNS
def claim_command(name: str, sets: tuple[str, ...], runs: int) -> None:
    """Check one claim; `list` shows their names."""
    from exact_mdp.paper_repro import run

    click.echo(run.format_claim(name, sets, runs))


@main.command("figure")
@click.argument("name")
@click.option("--out", type=OUT, default=Path("results/figures"), show_default=True)
@RUNS
def figure_command(name: str, out: Path, runs: int) -> None:
    """Draw one figure as SVG and PNG; `list` shows their names after the claims."""
    from exact_mdp.paper_repro import run

    for path in run.draw_figure(name, out, runs):
        click.echo(path)


if __name__ == "__main__":
    main(prog_name="python -m exact_mdp.paper_repro")
