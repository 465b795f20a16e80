"""`python -m paper_repro.agents`: conversations of the paper's two agents, and what they show."""

from __future__ import annotations

import sys

import click

from paper_repro.agents.cli_measure import claims, measure, variants
from paper_repro.agents.cli_run import fetch_model, prompts, render, replay, run


class Group(click.Group):
    """Commands whose errors are one message and exit status 2."""

    def invoke(self, ctx: click.Context) -> object:
        from mdp.errors import ModelError

        try:
            return super().invoke(ctx)
        except ModelError as error:
            click.echo(f"{type(error).__name__}: {error}", err=True)
            sys.exit(2)
        except KeyboardInterrupt:
            click.echo("stopped; what was recorded stays, --resume goes on", err=True)
            sys.exit(130)


@click.group(cls=Group)
def main() -> None:
    """The two agents of Yuan et al. (2025): a person living with dementia and a robot caregiver.

    A simulator for research on decision models. Not medical advice.
    """


for command in (run, replay, render, measure, variants, prompts, claims, fetch_model):
    main.add_command(command)

if __name__ == "__main__":
    main(prog_name="python -m paper_repro.agents")
