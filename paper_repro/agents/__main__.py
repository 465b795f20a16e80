"""`python -m paper_repro.agents`: conversations of the paper's two agents, and what they show."""

from __future__ import annotations

import click

from exact_mdp.analysis.exit_status import Programs
from exact_mdp.paper_repro.agents.cli import fetch_model, prompts, render, replay, run
from exact_mdp.paper_repro.agents.cli_measure import claims, measure, variants


class Recording(Programs):
    """Commands of which an interruption loses nothing that was recorded."""

    def invoke(self, ctx: click.Context) -> object:
        """Run the command that the words name."""
        try:
            return super().invoke(ctx)
        except KeyboardInterrupt as stop:
            stop.add_note("what was recorded stays, --resume goes on")
            raise


@click.group(cls=Recording)
def main() -> None:
    """The two agents of Yuan et al. (2025): a person living with dementia and a robot caregiver.

    A simulator for research on decision models. Not medical advice.
    """


for command in (run, replay, render, measure, variants, prompts, claims, fetch_model):
    main.add_command(command)

if __name__ == "__main__":
    main(prog_name="python -m paper_repro.agents")
