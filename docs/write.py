"""Write into the pages the parts made from the code: `make docs`; a test compares the two.

A page marks each place, and the text between the marks is written again:

    <!-- made by `make docs`: text exact_mdp.mdp.io.npz -->
    <!-- end -->

`python docs/write.py figures` also runs the blocks of the gallery and saves their figures.
"""

from __future__ import annotations

import ast
import inspect
import json
import re
import shlex
import sys
import tomllib
from collections.abc import Iterable, Set
from importlib import import_module
from pathlib import Path
from typing import Any

import click

import exact_mdp
from exact_mdp.paper_repro.silent_points import OPTIONS

DOCS = Path(__file__).resolve().parent
GOLDEN = DOCS.parent / "tests" / "golden"
MARKED = re.compile(r"(<!-- made by `make docs`: (\w+)([^\n]*) -->\n).*?(<!-- end -->)", re.S)
FILES = {
    "a model": "FORMATS",
    "a policy": "POLICIES",
    "a perception": "PERCEPTIONS",
    "transitions": "RECORDS",
}
FIGURES = re.compile(r"^```python\n(.*?)^```\n\n((?:!\[[^\n]*\n)+)", re.M | re.S)


def with_made_parts(page: str) -> str:
    """Return a page with its made parts as today's code makes them."""
    return MARKED.sub(
        lambda mark: f"{mark[1]}\n{MADE[mark[2]](mark[3].strip())}\n\n{mark[4]}", page
    )


def imported(place: str) -> Any:
    """Return the object that "module:name" names."""
    module, _, name = place.partition(":")
    return getattr(import_module(module), name)


def table(head: str, rows: Iterable[tuple[str, ...]]) -> str:
    """Return a table; `head` separates the names of its columns by commas."""
    names = head.split(", ")
    lines = [names, ["---"] * len(names), *([c.replace("|", "\\|") for c in row] for row in rows)]
    return "\n".join(f"| {' | '.join(cells)} |" for cells in lines)


def commands_in_short(names: Set[str], everyone: Set[str]) -> str:
    """Return the commands concerned; if they are most of all, "all but" the others."""
    others = ", ".join(sorted(everyone - names))
    if 2 * len(names) <= len(everyone):
        return ", ".join(sorted(names))
    return f"all but {others}" if others else "all"


# ---- commands ------------------------------------------------------------------------------------


def commands_of(group: str) -> dict[str, tuple[click.Command, click.Context]]:
    """Return the commands of a group, "module:name", by name."""
    pairs = {}
    for name in sorted(imported(group).list_commands(None)):
        command = imported(group).get_command(None, name)
        pairs[name] = command, click.Context(command, **command.context_settings)
    return pairs


def commands(words: str) -> str:
    """Return a table of the commands of a group; the words are "module:name program"."""
    group, _, program = words.partition(" ")
    rows = []
    for name, (command, context) in commands_of(group).items():
        usage = [piece for piece in command.collect_usage_pieces(context) if piece != "[OPTIONS]"]
        rows.append((f"`{' '.join([program, name, *usage])}`", command.get_short_help_str(500)))
    return table("command, what it does", rows)


def options(group: str) -> str:
    """Return every option of a group, with the commands that take it."""
    takers: dict[tuple[str, str], set[str]] = {}
    everyone = commands_of(group)
    for name, (command, context) in everyone.items():
        for option in command.get_params(context):
            record = option.get_help_record(context)
            if isinstance(option, click.Option) and record and "--help" not in option.opts:
                takers.setdefault(record, set()).add(name)
    rows = (
        (f"`{option}`", " ".join(help.split()), commands_in_short(names, everyone.keys()))
        for (option, help), names in sorted(takers.items())
    )
    return table("option, what it does, commands", rows)


def pinned_keys() -> dict[str, set[str]]:
    """Return the keys of the pinned answers, each with the commands that have it."""
    keys: dict[str, set[str]] = {}
    for part in tomllib.loads((GOLDEN / "cases.toml").read_text("utf-8")).values():
        for name, case in part.items():
            path = GOLDEN / "answers" / f"{name}.json"
            if path.exists():
                command = shlex.split(case if isinstance(case, str) else case[-1])[0]
                for key in json.loads(path.read_text("utf-8"))["answer"]:
                    keys.setdefault(key, set()).add(command)
    return keys


def meanings() -> dict[tuple[str, str], str]:
    """Return the meaning of each key of a command, {(command, key): meaning}.

    The docstring of the command's function says it below "Keys", that of `Given` for all commands;
    else it is what the class of the result, which the section names, says of its attribute.
    """
    shared, _ = explained_keys("analysis.cli.given:Given")
    classes = {
        node.name: node
        for path in Path(exact_mdp.__file__).parent.rglob("*.py")
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.ClassDef)
    }
    pinned: dict[str, set[str]] = {}
    for key, names in pinned_keys().items():
        for name in names:
            pinned.setdefault(name, set()).add(key)
    known = {}
    name_function = imported("exact_mdp.analysis.cli.commands:name_function")
    for group in imported("exact_mdp.analysis.cli.commands:MADE").values():
        for name, (module, _) in group.items():
            own, results = explained_keys(f"analysis.cli.{module}:{name_function(name)}")
            attributes = {}
            for each in reversed(results):
                attributes |= explained_attributes(classes[each])
            every = attributes | shared | own
            keys = own.keys() | (every.keys() & pinned.get(name, set()))
            known |= {(name, key): every[key] for key in keys}
    return known


def explained_keys(target: str) -> tuple[dict[str, str], list[str]]:
    """Return the keys that the docstring of "module:name" explains, and the classes it names."""
    _, _, section = (inspect.getdoc(imported(f"exact_mdp.{target}")) or "").partition(
        "Keys\n----\n"
    )
    results = re.match(r"Of (.*)\.\n", section)
    entries = " ".join(section[results.end() if results else 0 :].split()).removesuffix(".")
    pairs = (entry.partition(": ")[::2] for entry in filter(None, entries.split("; ")))
    texts = {key: text[:1].upper() + text[1:] for key, text in pairs}
    return texts, results[1].split(", ") if results else []


def explained_attributes(kind: ast.ClassDef) -> dict[str, str]:
    """Return the first sentence of the documentation of each attribute and property of a class."""
    section = re.search(r"Attributes\n-+\n(.*?)(?:\n\n|$)", ast.get_docstring(kind) or "", re.S)
    texts = {}
    for block in re.split(r"\n(?=\S)", section[1]) if section else []:
        head, _, text = block.partition("\n")
        texts |= dict.fromkeys(head.partition(" : ")[0].split(", "), " ".join(text.split()))
    for node in kind.body:
        if isinstance(node, ast.FunctionDef) and node.decorator_list:
            texts[node.name] = (ast.get_docstring(node) or "").partition("\n\n")[0]
    return {key: re.split(r"\.(?: |$)", text)[0] for key, text in texts.items() if text}


def answers(_: str) -> str:
    """Return a table of the meanings of all keys of `--json`."""
    rows: dict[tuple[str, str], set[str]] = {}
    everyone = set[str]()
    for (command, key), meaning in sorted(meanings().items(), key=lambda item: item[0][::-1]):
        rows.setdefault((f"`{key}`", meaning), set()).add(command)
        everyone.add(command)
    return table(
        "key, meaning, commands",
        ((*row, commands_in_short(names, everyone)) for row, names in rows.items()),
    )


# ---- Python --------------------------------------------------------------------------------------


def described(things: dict[str, Any]) -> str:
    """Return functions with the names of their parameters, and classes; each in one line."""
    rows = []
    for name, thing in things.items():
        given = [] if inspect.isclass(thing) else list(inspect.signature(thing).parameters)
        call = f"({', '.join(each for each in given if each != 'self')})"
        text = (inspect.getdoc(thing) or "").partition("\n")[0]
        rows.append((f"`{name}{'' if inspect.isclass(thing) else call}`", text))
    return table("name, what it is", rows)


def names(_: str) -> str:
    """Return the functions and classes that `exact_mdp` exports."""
    public = {name: getattr(exact_mdp, name) for name in sorted(exact_mdp.__all__, key=str.lower)}
    return described(
        {n: each for n, each in public.items() if inspect.isroutine(each) or inspect.isclass(each)}
    )


def methods(name: str) -> str:
    """Return the public methods of a class."""
    public = inspect.getmembers(getattr(exact_mdp, name), callable)
    return described({each: method for each, method in public if not each.startswith("_")})


def readings(_: str) -> str:
    """Return the options of each reading with their meanings, the default first."""
    return table(
        "key, options",
        (
            (
                f"`readings.{key}`",
                "; ".join(f"`{name.replace(' ', '-')}`: {means}" for name, means in each.items()),
            )
            for key, each in OPTIONS.items()
        ),
    )


def text(module: str) -> str:
    """Return the docstring of a module as Markdown: indented lines are code."""
    return inspect.getdoc(import_module(module)) or ""


def questions(_: str) -> str:
    """Return the results of every analysis and question, as the table of the tests counts them."""
    counted = tomllib.loads((DOCS.parent / "tests" / "questions" / "table.toml").read_text("utf-8"))
    asked = list(next(iter(counted.values())))
    rows = []
    for analysis, cells in counted.items():
        marks = []
        for answered, refused in cells.values():
            if not refused:
                marks.append("yes")
            elif not answered:
                marks.append("no")
            else:
                marks.append(f"{max(1, 100 * answered // (answered + refused))} %")
        rows.append((f"`{analysis}`", *marks))
    listed = "\n".join(f"{number}. {name}" for number, name in enumerate(asked, start=1))
    head = ", ".join(["", *map(str, range(1, len(asked) + 1))])
    least = min(sum(cell) for cells in counted.values() for cell in cells.values())
    return f"{listed}\n\n{table(head, rows)}\n\nModels in each cell: {least}."


def formats(_: str) -> str:
    """Return the kinds of files that are read, and which of them are written."""
    grouped, rows = imported("exact_mdp.mdp.io.formats:group_endings"), []
    for what, name in FILES.items():
        for each, endings in grouped(imported(f"exact_mdp.mdp.io.formats:{name}")).items():
            written = "yes" if each.writer else "no"
            if each.loses:
                written = f"without {each.loses}"
            rows.append((what, f"`{endings}`", each.holds, written))
    return table("a file of, with the ending, holds, is written", rows)


MADE = {
    each.__name__: each
    for each in (commands, options, answers, names, methods, readings, formats, questions, text)
}


def draw() -> None:
    """Run the blocks of the gallery and save their figures, in order."""
    import matplotlib.pyplot as plt
    from PIL import Image  # matplotlib brings it

    for block, shown in FIGURES.findall((DOCS / "gallery.md").read_text("utf-8")):
        plt.close("all")
        exec(compile(block, "docs/gallery.md", "exec"), {})
        for number, target in zip(
            plt.get_fignums(), re.findall(r"\(([^)]+)\)", shown), strict=True
        ):
            file = DOCS / target
            file.parent.mkdir(exist_ok=True)
            plt.figure(number).savefig(file, dpi=100, bbox_inches="tight")
            Image.open(file).convert("RGB").quantize(64).save(file, optimize=True)


if __name__ == "__main__":
    for path in DOCS.rglob("*.md"):
        path.write_text(with_made_parts(path.read_text("utf-8")), "utf-8")
    if sys.argv[1:] == ["figures"]:
        draw()
