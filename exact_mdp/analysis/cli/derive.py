"""Commands made from functions: the signature gives arguments and options, the docstring the help.

The source of a function is read and not imported, so that help comes at once. What a parameter
becomes:

    given: Given                   the argument MODEL, with the options of `given` that are shared
    policy: Policy                 an argument or option POLICY, of which `given` makes the policy
    without a default              an argument, a required option where it is keyword-only
    : bool                         a flag
    : int                          a whole number
    : Sequence or Mapping          an option of the singular name that may be repeated
    anything else                  an option with a text

What is not typed is not passed: the function's own default holds. The words in capitals or quotes
before "optional" in the docstring's type stand in the help for the value. Below "Keys" it says what
the keys of the JSON mean, "key: meaning; …", after the classes whose attributes others are.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from inspect import cleandoc
from pathlib import Path
from typing import Any

import click

from exact_mdp.analysis.cli.words import Whole
from exact_mdp.mdp.io.files import aside

PACKAGE = Path(__file__).resolve().parents[2]
HELP = ["-h", "--help"]
GIVEN = "analysis.cli.given:given"
VARIED = ("parameters", "ranges", "relative", "policy")  # of `given`, beside a command's own


@dataclass(frozen=True)
class Parameter:
    """A parameter of a function, with what its docstring says."""

    name: str
    kind: str
    default: str
    keyword: bool
    form: str
    help: str

    @property
    def multiple(self) -> bool:
        """Whether it takes several values."""
        return self.kind.startswith(("Sequence", "Mapping", "Iterable"))

    def click(self) -> click.Parameter:
        """Return the argument or option."""
        words = re.findall(r'"([^"]+)"', self.form)
        form = "|".join(words) or self.form.partition(",")[0]
        if not self.keyword:
            metavar = form or self.name.upper() + "..." * self.multiple
            metavar = f"[{metavar}]" if self.default else metavar
            nargs = -1 if self.multiple else 1
            return click.Argument(
                [self.name], required=not self.default, nargs=nargs, metavar=metavar
            )
        name = re.sub("ie$", "y", self.name.removesuffix("s")) if self.multiple else self.name
        names = ["--" + name.replace("_", "-"), self.name]
        shown = self.default not in ("", "None", "False", "()")
        help_ = f"{self.help[:-1]} ({self.default})." if shown else self.help
        if self.kind == "bool":
            return click.Option(names, is_flag=True, default=None, help=help_)
        return click.Option(
            names,
            metavar=form,
            multiple=self.multiple,
            required=not self.default,
            type=Whole(self.form) if self.kind.startswith("int") else None,
            help=help_ + " May be repeated." * self.multiple,
        )


def function(target: str) -> tuple[str, list[Parameter]]:
    """Return what the docstring of "module:name" says, and its parameters."""
    module, _, name = target.partition(":")
    near, far = (
        [each for each in _tree(place).body if isinstance(each, ast.FunctionDef)]
        for place in (module, GIVEN.partition(":")[0])
    )
    section = next(each for each in near if each.name == name)
    said: dict[str, tuple[str, str]] = {}
    for each in reversed([section, *far, *near]):  # what one does not explain, another one does
        said |= _documented(each)[1]
    return _documented(section)[0], [*_parameters(section.args, said)]


def _documented(function: ast.FunctionDef) -> tuple[str, dict[str, tuple[str, str]]]:
    """Return a docstring's text, and type and text of each parameter."""
    text = cleandoc(ast.get_docstring(function) or "")
    head, *sections = re.split(r"\n\n(?=Parameters\n-|Keys\n-)", text)
    rest = next((each for each in sections if each.startswith("Parameters")), "\n\n")
    said: dict[str, tuple[str, str]] = {}
    for block in re.split(r"\n(?=\S)", rest.split("\n", 2)[2]):
        form, _, below = block.partition("\n")
        names, _, kind = form.partition(" : ")
        said |= dict.fromkeys(names.split(", "), (kind, " ".join(below.split())))
    return head, said


@cache
def _tree(module: str) -> ast.Module:
    return ast.parse(PACKAGE.joinpath(*module.split(".")).with_suffix(".py").read_text("utf-8"))


def _parameters(args: ast.arguments, said: dict[str, tuple[str, str]]) -> Iterator[Parameter]:
    missing = [None] * (len(args.args) - len(args.defaults))
    placed = [*zip(args.args, [*missing, *args.defaults], strict=True)]
    named = [*zip(args.kwonlyargs, args.kw_defaults, strict=True)]
    for keyword, pairs in ((False, placed), (True, named)):
        for arg, default in pairs:
            form, text = said.get(arg.arg, ("", ""))
            kind = ast.unparse(arg.annotation) if arg.annotation else ""
            value = "" if default is None else ast.unparse(default).strip("'")
            yield Parameter(arg.arg, kind, value, keyword, form, text)


class Command(click.Command):
    """A command whose options stand in sections: its own, those of the model, those of all."""

    shared: Sequence[str] = ()

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the sections."""
        sections: dict[str, list[tuple[str, str]]] = {"Options": [], "Model": [], "Output": []}
        for each in self.get_params(ctx):
            record = each.get_help_record(ctx)
            if record is None or isinstance(each, click.Argument):
                continue
            last = bool({"--json", "--markdown", "--help"} & {*each.opts})
            title = "Output" if last else "Model" if each.name in self.shared else "Options"
            sections[title].append(record)
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def command(
    name: str, target: str, shared: Sequence[str] = (), *, markdown: bool = False, epilog: str = ""
) -> click.Command:
    """Return the command that calls the function "module:name" of this package.

    `shared` are the parameters of `given` that it has as options; `epilog` stands below these.
    """
    text, own = function(target)
    said, *examples = re.split(r"\s*^Example: ", text, flags=re.M)
    named = {each.name for each in own}
    asked = [each for each in function(GIVEN)[1] if each.name in {*shared} - named]
    params: list[click.Parameter]
    params = [click.Argument(["model"]) if p.name == "given" else p.click() for p in own]
    params += [each.click() for each in asked]
    forms = {"json": "one JSON object"} | ({"markdown": "Markdown"} if markdown else {})
    for form, what in forms.items():
        option = [f"--{form}", f"as_{form}"]
        params.append(click.Option(option, is_flag=True, help=f"Print {what}."))

    def work(*, as_json: bool, as_markdown: bool = False, **options: Any) -> int:
        try:
            with aside():  # a module of the user's may print: the result is printed below
                report = _report(target, own, [each.name for each in asked], options)
        except click.exceptions.Exit as end:  # not of --help, but of code that was called
            sys.exit(end.exit_code)
        show = import_module("exact_mdp.analysis.cli.render").show
        show(report, as_json=as_json, as_markdown=as_markdown)
        return int(report.passed is False)

    made = Command(
        name,
        params=params,
        callback=work,
        help="\n".join([said, "", "\b", "Example:", *examples]),
        short_help=text.partition("\n")[0],
        epilog=epilog,
        context_settings={"help_option_names": HELP},
    )
    made.shared = [each.name for each in asked if each.name not in VARIED]
    return made


def _report(target: str, own: list[Parameter], asked: list[str], options: dict[str, Any]) -> Any:
    """Call the function with what was typed, and return its report."""
    module, _, name = target.partition(":")
    call: Callable[..., Any] = getattr(import_module(f"exact_mdp.{module}"), name)
    typed = {key: value for key, value in options.items() if value is not None and value != ()}
    names = [each.name for each in own]
    words = {name: typed[name] for name in names if name in typed}
    if "given" in names:
        given = import_module("exact_mdp.analysis.cli.given").given
        has = {each.name for each in own if each.kind.startswith("Policy")} | {*asked}
        has |= {"parameters"} & {*names}
        shared = {key: typed[key] for key in has if key in typed}
        words["given"] = given(options["model"], has=has, **shared)
        if "policy" in has.intersection(names) and words["given"].taken is not None:
            words["policy"] = words["given"].taken
    return call(**words)
