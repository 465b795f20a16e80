"""The commands, by what they are for: each is the function that it is made from.

To add one, write its function (`derive` says what its parameters become), which returns a `Report`,
and name it here.
"""

from __future__ import annotations

import click

from exact_mdp.analysis.cli.derive import command

POLICY = """POLICY is optimal, random, always:ACTION, or a file: .json {"0000": "none", ...};
.csv with the header status,action; .npy or .npz with a Q-table or with probabilities of actions
(--kind q, --kind policy; auto reads an array as probabilities if the row of each state with a
choice is a distribution, and refuses it if its greedy policy would differ)."""

SETS = ("sets", "discount")
QUESTION = ("reach", "until", "reward", "allowed", "minimize", "start")
ASKED = (*QUESTION, *SETS)
OF_POLICY = ("kind", "perception", "horizon")
VARIED = ("parameters", "ranges", "relative")
HELD = (*VARIED, "policy", "perception", *ASKED)

MADE: dict[str, dict[str, tuple[str, tuple[str, ...]]]] = {
    "Check": {
        "check": ("check:check", ("criterion", *OF_POLICY, *ASKED)),
        "verify": ("policies:verify", ("horizon", *ASKED)),
    },
    "Solve": {
        "solve": ("policies:solve", ("horizon", "criterion", *ASKED)),
        "evaluate": ("policies:evaluate", ("criterion", *OF_POLICY, *ASKED)),
        "returns": ("policies:returns", (*OF_POLICY, *ASKED)),
        "simulate": ("policies:simulate", (*OF_POLICY, *ASKED)),
    },
    "Vary": {
        "tornado": ("vary:tornado", HELD),
        "gradient": ("vary:gradient", ("parameters", "policy", "perception", *ASKED)),
        "threshold": ("vary:threshold", (*VARIED, *ASKED)),
        "curve": ("vary:curve", HELD),
        "one-way": ("vary:one_way", HELD),
        "two-way": ("vary:two_way", HELD),
        "psa": ("vary:psa", ("parameters", "policy", "perception", *ASKED)),
        "sobol": ("vary:sobol", HELD),
        "robust": ("vary:robust", HELD),
        "explore": ("vary:explore", ("ranges", "relative", "kind", *ASKED)),
    },
    "Trade": {
        "tradeoff": ("trade:tradeoff", ("horizon", *SETS)),
        "rationalize": ("trade:rationalize", (*OF_POLICY, *SETS)),
        "risk": ("trade:risk", ("horizon", *SETS)),
    },
    "Models": {
        "info": ("models:info", SETS),
        "convert": ("models:convert", SETS),
        "data": ("models:data", ()),
        "train": ("train:train", SETS),
    },
    "Care": {
        "new": ("models:new", ()),
        "lint": ("models:lint", ()),
        "perception": ("trade:perception", SETS),
    },
}


class Commands(click.Group):
    """The commands, made when they are asked for, and listed by what they are for."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names."""
        return [name for made in MADE.values() for name in made]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return a command; None where there is none of the name."""
        made = {name: each for group in MADE.values() for name, each in group.items()}
        if cmd_name in made and cmd_name not in self.commands:
            target, shared = made[cmd_name]
            policies = {"kind", "perception"} & {*shared} or cmd_name in ("risk", "tradeoff")
            epilog = POLICY if policies else ""
            self.commands[cmd_name] = command(cmd_name, f"analysis.cli.{target}", shared, epilog)
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write each group with its commands and what they do."""
        for title, names in MADE.items():
            made = [self.get_command(ctx, name) for name in names]
            lines = [(str(each.name), each.get_short_help_str(66)) for each in made if each]
            with formatter.section(title):
                formatter.write_dl(lines)
