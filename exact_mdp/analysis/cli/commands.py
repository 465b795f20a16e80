"""The commands, each made from a function: its signature gives the options, its docstring the help.

To add one, write its function, which returns a `Report`, and name it in `MADE`. Its source is read
and not imported, so that help comes at once. What a parameter becomes:

    given: Given                   the argument MODEL, with the options of `Given` that are shared
    policy: Policy                 an argument or option POLICY, of which `Given` makes the policy
    without a default              an argument, a required option where it is keyword-only
    : bool                         a flag
    : int                          a whole number
    : Sequence or Mapping          an option of the singular name that may be repeated, unless
                                   the type in the docstring says "once"
    anything else                  an option with a text

What is not typed is not passed: the function's own default holds. In the docstring's type stand the
word in capitals or the words in quotes that the help shows for the value, the limits of a whole
number ("N, 1 to 100"), and the endings of a file that is written ("FILE, .csv or .json"). For
"{module:NAME}" in a text stand the keys of that dict. Below
"Keys" it says what the keys of the JSON mean, "key: meaning; …", after the classes whose attributes
others are.
"""

from __future__ import annotations

import ast
import inspect
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import click

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import redirect_output

PACKAGE = Path(__file__).resolve().parents[2]
HELP = ["-h", "--help"]
GIVEN = "analysis.cli.given:Given"

POLICY = """POLICY is optimal, random, always:ACTION, or a file: .json {"0000": "none", ...};
.csv with the header status,action; .npy or .npz with a Q-table or with probabilities of actions
(--kind q, --kind policy; auto reads an array as probabilities if the row of each state with a
choice is a distribution, and refuses it if its greedy policy would differ)."""

SETS = ("sets", "discount", "start")
WORK = "Records and parallel work"
OF_WORK = ("confidence", "by", "evidence", "n_jobs", "out")  # options that stand last
QUESTION = ("reach", "until", "reward", "allowed", "minimize", "maximize")
ASKED = (*QUESTION, *SETS)
OF_POLICY = ("kind", "perception", "horizon")
VARIED = ("parameters", "ranges", "relative", "policy")  # listed beside a command's own
HELD = (*VARIED, *OF_POLICY, *ASKED)

MADE: dict[str, dict[str, tuple[str, tuple[str, ...]]]] = {
    "Check": {
        "check": ("check:check_command", ("criterion", *OF_POLICY, *ASKED)),
        "verify": ("policies:verify_command", ("horizon", *ASKED)),
    },
    "Solve": {
        "solve": ("policies:solve_command", ("horizon", "criterion", *ASKED)),
        "evaluate": ("policies:evaluate_command", ("criterion", *OF_POLICY, *ASKED)),
        "returns": ("policies:returns_command", (*OF_POLICY, *ASKED)),
        "simulate": ("policies:simulate_command", (*OF_POLICY, *ASKED)),
    },
    "Vary": {
        "tornado": ("vary:tornado_command", HELD),
        "gradient": ("vary:gradient_command", ("parameters", *HELD[3:])),
        "threshold": ("vary:threshold_command", (*VARIED[:3], "horizon", *ASKED)),
        "curve": ("vary:curve_command", HELD),
        "one-way": ("vary:one_way_command", HELD),
        "two-way": ("vary:two_way_command", HELD),
        "psa": ("vary:psa_command", ("parameters", *HELD[3:])),
        "sobol": ("vary:sobol_command", HELD),
        "robust": ("vary:robust_command", HELD),
        "explore": ("vary:explore_command", ("ranges", "relative", "kind", "horizon", *ASKED)),
    },
    "Trade": {
        "tradeoff": ("trade:tradeoff_command", ("horizon", *SETS)),
        "rationalize": ("trade:rationalize_command", (*OF_POLICY, *SETS)),
        "risk": ("trade:risk_command", ("horizon", *SETS)),
    },
    "Models": {
        "info": ("models:info_command", SETS),
        "convert": ("models:convert_command", SETS),
        "data": ("models:data_command", ()),
        "train": ("train:train_command", SETS),
    },
    "Care": {
        "new": ("models:new_command", ()),
        "lint": ("models:lint_command", ()),
        "perception": ("trade:perception_command", SETS),
    },
}


class CommandParameter(NamedTuple):
    """A parameter of a function, with what the docstring says of its type and of itself."""

    name: str
    kind: str  # its type, as it is written
    default: Any
    named: bool  # whether it is an option
    form: str
    help: str

    @property
    def endings(self) -> list[str]:
        """The endings that a file may have which is written."""
        return re.findall(r"\.\w+", self.form)

    def to_click(self) -> click.Parameter:
        """Return the argument or option."""
        required, multiple = self.default is inspect.Parameter.empty, self.kind[:8] == "Sequence"
        words = re.findall(r'"([^"]+)"', self.form)
        form = "|".join(words) or self.form.partition(",")[0]
        if not self.named:
            metavar = form or self.name.upper() + "..." * multiple
            metavar = metavar if required else f"[{metavar}]"
            nargs = -1 if multiple else 1
            return click.Argument([self.name], required=required, nargs=nargs, metavar=metavar)
        name = re.sub("ie$", "y", self.name.removesuffix("s")) if multiple else self.name
        names = ["--" + name.replace("_", "-"), self.name]
        shown = not required and repr(self.default) not in ("None", "False", "()")
        help_ = f"{self.help[:-1]} ({self.default})." if shown else self.help
        if self.kind == "bool":
            return click.Option(names, is_flag=True, default=None, help=help_)
        ends = re.search(r"(\d+) to (\d+)", self.form)
        whole = click.IntRange(int(ends[1]), int(ends[2])) if ends else click.IntRange(0)
        return click.Option(
            names,
            metavar=form,
            multiple=multiple,
            required=required,
            type=whole if self.kind.startswith("int") else None,
            help=help_ + " May be repeated." * (multiple and "once" not in self.form),
        )


def parse_signature(target: str) -> tuple[str, list[CommandParameter]]:
    """Return what the docstring of "module:name" says, and its parameters."""
    module, _, name = target.partition(":")
    near, far = load_stubs(module), load_stubs(GIVEN.partition(":")[0])
    said = defaultdict[str, tuple[str, str]](lambda: ("", ""))
    for each in (*reversed(near.values()), *far.values(), near[name]):
        said |= _parse_docstring(each)[1]  # what one does not explain, another one does
    known = [
        CommandParameter(
            p.name, str(p.annotation), p.default, p.kind is p.KEYWORD_ONLY, *said[p.name]
        )
        for p in inspect.signature(near[name]).parameters.values()
    ]
    return _parse_docstring(near[name])[0], known


@cache
def load_stubs(module: str) -> dict[str, Any]:
    """Return the functions and dataclasses of a module without their code, and so without delay."""
    path = PACKAGE.joinpath(*module.split(".")).with_suffix(".py")
    nodes: dict[str, ast.FunctionDef | ast.ClassDef] = {}
    for node in ast.parse(path.read_text("utf-8")).body:
        if isinstance(node, ast.FunctionDef):
            nodes[node.name], node.body = node, node.body[:1]
        elif isinstance(node, ast.ClassDef):
            nodes[node.name] = node
            node.body = [each for each in node.body if isinstance(each, ast.Expr | ast.AnnAssign)]
    tree, names = ast.Module([*nodes.values()], []), {"dataclass": dataclass}
    exec(compile(tree, str(path), "exec"), names)
    return {name: names[name] for name in nodes}


def _parse_docstring(section: object) -> tuple[str, dict[str, tuple[str, str]]]:
    """Return a docstring's text, and type and text of each parameter."""
    head, *sections = re.split(r"\n\n(?=Parameters\n-|Keys\n-)", inspect.getdoc(section) or "")
    rest = next((each for each in sections if each.startswith("Parameters")), "\n\n")
    said: dict[str, tuple[str, str]] = {}
    for block in re.split(r"\n(?=\S)", rest.split("\n", 2)[2]):
        form, _, below = block.partition("\n")
        names, _, kind = form.partition(" : ")
        text = re.sub(r"\{([\w.]+):(\w+)\}", _read_dict_keys, " ".join(below.split()))
        said |= dict.fromkeys(names.split(", "), (kind, text))
    return head, said


def _read_dict_keys(match: re.Match[str]) -> str:
    """Return the keys of a dict "{module:NAME}", read from the module's source."""
    path = PACKAGE.joinpath(*match[1].split(".")).with_suffix(".py")
    (found,) = (
        node.value
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == match[2]
    )
    assert isinstance(found, ast.Dict)
    return ", ".join(ast.literal_eval(key) for key in found.keys if key)


class Command(click.Command):
    """A command whose options stand in sections: its own, the model's, those of work, of all."""

    shared: Sequence[str] = ()

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the sections."""
        sections: dict[str, list[tuple[str, str]]]
        sections = {title: [] for title in ("Options", "Model", WORK, "Output")}
        for each in self.get_params(ctx):
            record = each.get_help_record(ctx)
            if record is None or isinstance(each, click.Argument):
                continue
            last = bool({"--json", "--markdown", "--help"} & {*each.opts})
            title = "Model" if each.name in self.shared else "Options"
            title = "Output" if last else WORK if each.name in OF_WORK else title
            sections[title].append(record)
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def make_command(name: str, target: str, shared: Sequence[str], epilog: str) -> click.Command:
    """Return the command that calls the function "module:name" of this package.

    `shared` are the parameters of `Given` that it has as options; `epilog` stands below these.
    """
    text, own = parse_signature(target)
    said, *examples = re.split(r"\s*^Example: ", text, flags=re.M)
    named = {each.name for each in own}
    asked = [each for each in parse_signature(GIVEN)[1] if each.name in {*shared} - named]
    params: list[click.Parameter]
    params = [click.Argument(["model"]) if p.name == "given" else p.to_click() for p in own]
    params += [each.to_click() for each in asked]
    for form, what in (("json", "one JSON object"), ("markdown", "Markdown")):
        option = [f"--{form}", f"as_{form}"]
        params.append(click.Option(option, is_flag=True, help=f"Print {what}."))

    def run_and_print(*, as_json: bool, as_markdown: bool, **options: Any) -> int:
        if as_json and as_markdown:
            raise ModelError("two forms of one output", where="--markdown", fix="leave out --json")
        try:
            with redirect_output():  # a module of the user's may print: the result is printed below
                report = _call_function(target, own, [each.name for each in asked], options)
        except click.exceptions.Exit as end:  # not of --help, but of code that was called
            sys.exit(end.exit_code)
        print_report = import_module("exact_mdp.analysis.cli.render").print_report
        print_report(report, as_json=as_json, as_markdown=as_markdown)
        return int(report.passed is False)

    made = Command(
        name,
        params=params,
        callback=run_and_print,
        help="\n".join([said, "", "\b", "Example:", *examples]),
        short_help=text.partition("\n")[0],
        epilog=epilog,
        context_settings={"help_option_names": HELP},
    )
    made.shared = [each.name for each in asked if each.name not in VARIED]
    return made


def _call_function(
    target: str, own: list[CommandParameter], asked: list[str], options: dict[str, Any]
) -> Any:
    """Call the function with what was typed, and return its report."""
    module, _, name = target.partition(":")
    call: Callable[..., Any] = getattr(import_module(f"exact_mdp.{module}"), name)
    typed = {key: value for key, value in options.items() if value is not None and value != ()}
    files = ((typed[p.name], p.endings) for p in own if p.endings and p.name in typed)
    import_module("exact_mdp.analysis.cli.words").check_outputs(files)
    words = {each.name: typed[each.name] for each in own if each.name in typed}
    if any(each.name == "given" for each in own):
        has = {*asked} | {each.name for each in own if each.kind.startswith("Policy")}
        shared = {key: typed[key] for key in has if key in typed}
        kind = import_module("exact_mdp.analysis.cli.given").Given
        words["given"] = given = kind(model=options["model"], has=has, **shared)
        if "policy" in has - {*asked} and given.taken is not None:
            words["policy"] = given.taken
    return call(**words)


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
            self.commands[cmd_name] = make_command(
                cmd_name, f"analysis.cli.{target}", shared, epilog
            )
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write each group with its commands and what they do."""
        for title, names in MADE.items():
            made = [self.get_command(ctx, name) for name in names]
            lines = [(str(each.name), each.get_short_help_str(66)) for each in made if each]
            with formatter.section(title):
                formatter.write_dl(lines)
