"""The reference of the commands: what `--help` says, from the declarations that it comes from.

    ```{commands} exact_mdp.analysis.cli:cli exact-mdp
    ```

The command may be a group, whose commands follow as sections. `{keys}` lists the keys of a mapping
{key: meaning}, such as those of scenario files; `{json-keys}` those of what `--json` prints.
"""

from __future__ import annotations

from importlib import import_module
from inspect import cleandoc
from typing import Any

import click
from answers import SOURCE, answers, declared, meaning
from docutils import nodes
from plain_text import blocks, inline
from sphinx.application import Sphinx
from sphinx.util.docutils import SphinxDirective


def named(words: str) -> Any:
    """Return what "module:name" names."""
    module, _, name = words.partition(":")
    return getattr(import_module(module), name)


def terms(pairs: list[tuple[str, str]]) -> list[nodes.Node]:
    """Return a list of terms in code with their meanings."""
    if not pairs:
        return []
    found = nodes.definition_list()
    for term, said in pairs:
        told = nodes.definition("", nodes.paragraph("", "", *inline(said)))
        found += nodes.definition_list_item("", nodes.term("", "", nodes.literal("", term)), told)
    return [found]


def described(command: click.Command, program: str) -> list[nodes.Node]:
    """Return a command's usage, its help and its options."""
    context = click.Context(command, info_name=program, color=False, terminal_width=80)
    usage = " ".join([program, *command.collect_usage_pieces(context)])
    options = [
        record
        for option in command.get_params(context)
        if "--help" not in option.opts and (record := option.get_help_record(context)) and record[1]
    ]
    found: list[nodes.Node] = [nodes.literal_block(usage, usage, language="text")]
    found += blocks(cleandoc(command.help or "").replace("\b\n", ""))
    found += terms(options)
    found += blocks(command.epilog or "")
    return found


class Commands(SphinxDirective):
    """Describe a command, or a group and each of its commands."""

    required_arguments = 1
    optional_arguments = 1
    final_argument_whitespace = True

    def run(self) -> list[nodes.Node]:
        """Return one section for each command of a group."""
        command, program = named(self.arguments[0]), self.arguments[1]
        found = described(command, program)
        for name, each in getattr(command, "commands", {}).items():
            section = nodes.section(names=[name])
            section += nodes.title("", name)
            section += described(each, f"{program} {name}")
            self.state.document.note_implicit_target(section, section)
            found.append(section)
        return found


class Keys(SphinxDirective):
    """List the keys of a mapping and what each means."""

    required_arguments = 1

    def run(self) -> list[nodes.Node]:
        """Return the list."""
        return terms([(str(key), str(told)) for key, told in named(self.arguments[0]).items()])


class JsonKeys(SphinxDirective):
    """List the keys of every answer."""

    def run(self) -> list[nodes.Node]:
        """Return a section for each command."""
        self.env.note_dependency(str(SOURCE))
        lines, meanings = declared()
        found: list[nodes.Node] = []
        for command, answer in answers(lines):
            section = nodes.section(names=[f"json {command}"])
            section += nodes.title("", command)
            shown = f"exact-mdp {lines[command]} --json"
            section += nodes.literal_block(shown, shown, language="text")
            section += terms([(key, meaning(command, key, meanings) or "") for key in answer])
            self.state.document.note_implicit_target(section, section)
            found.append(section)
        return found


def setup(app: Sphinx) -> dict[str, bool]:
    """Add the directives."""
    app.add_directive("commands", Commands)
    app.add_directive("keys", Keys)
    app.add_directive("json-keys", JsonKeys)
    return {"parallel_read_safe": True}
