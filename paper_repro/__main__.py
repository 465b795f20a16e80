"""`python -m paper_repro`: reproduce the paper and print paper, exact and difference."""

from __future__ import annotations

import sys
import time
from pathlib import Path

import click

EPISODES = {True: 10_000, False: 100_000}


@click.command()
@click.option("--quick", is_flag=True, help="Check by 10,000 simulated episodes, not 100,000.")
@click.option(
    "--out",
    type=click.Path(file_okay=False, path_type=Path),
    default=Path("results"),
    show_default=True,
    help="Folder for numbers.json, report.md, figures and run.json.",
)
def main(quick: bool, out: Path) -> None:
    """Reproduce Yuan et al. (2025): every number beside the exact one."""
    from mdp import ModelError
    from paper_repro.run import run

    started = time.perf_counter()
    try:
        run(out, episodes=EPISODES[quick], quick=quick)
    except ModelError as error:
        click.echo(f"{type(error).__name__}: {error}", err=True)
        sys.exit(2)
    click.echo(f"done in {time.perf_counter() - started:.1f} s", err=True)


if __name__ == "__main__":
    main(prog_name="python -m paper_repro")
