"""The commands, each made from a function: its signature gives the options, its docstring the help.

To add the command "one-way", write the function `one_way_command`, which returns a `Report`, in a
module of this folder, and name the command in `MADE`. The module's source is parsed, not imported,
so that help appears at once. A parameter of the function becomes:

    given: Given                   the argument MODEL, with the options of `Given` that are shared
    policy: Policy                 an argument or option POLICY, from which `Given` makes the policy
    without a default              an argument, or a required option if it is keyword-only
    : bool                         a flag
    : int                          a whole number
    : Sequence or Mapping          an option of the singular name that may be repeated, unless
                                   the type in the docstring says "once"
    anything else                  an option with a text

Options that are not given are not passed, so that the function's defaults apply; a default is a
literal. The type of a parameter in the docstring is shown as the option's value: a word in
capitals, or words in quotes. It may add the limits of a whole number ("N, 1 to 100") or the endings
of an output file ("FILE, .csv or .json"). "{module:NAME}" is replaced by the keys of that dict, and
"{formats:NAME}" by the description of these formats. The section "Keys" explains the keys of the
JSON output, "key: meaning; …"; a first line "Of CLASS." adds the attributes of that class.
"""

from __future__ import annotations

import ast
import re
import sys
from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any, NamedTuple

import click

from exact_mdp.analysis.exit_status import StrictCommand
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io import formats
from exact_mdp.mdp.io.files import redirect_output
from exact_mdp.mdp.io.formats import POLICIES, describe_formats

PACKAGE = Path(__file__).resolve().parents[2]
HELP = ["-h", "--help"]
GIVEN = ("given", "Given")

POLICY = f"""POLICY is optimal, random, always:ACTION, or a file: {describe_formats(POLICIES)}
(--kind q, --kind policy; auto reads an array as probabilities if the row of each state with a
choice is a distribution, and refuses it if its greedy policy would differ)."""

SETS = ("sets", "envs", "constants", "discount", "start")
WORK = "Records and parallel work"
OF_WORK = ("confidence", "by", "evidence", "n_jobs", "out")  # options of the section `WORK`
QUESTION = ("reach", "until", "reward", "allowed", "minimize", "maximize")
ASKED = (*QUESTION, *SETS)
OF_FRONT = tuple(name for name in ASKED if name != "reward")  # a front names its totals itself
OF_POLICY = ("kind", "perception", "horizon")
VARIED = ("parameters", "ranges", "relative", "policy")  # listed beside a command's own
HELD = (*VARIED, *OF_POLICY, *ASKED)

# Each command with the module of its function, and the options of `Given` that it has.
MADE: dict[str, dict[str, tuple[str, tuple[str, ...]]]] = {
    "Check": {
        "check": ("check", ("criterion", *OF_POLICY, *ASKED)),
        "verify": ("policies", ("horizon", *ASKED)),
    },
    "Solve": {
        "solve": ("policies", ("horizon", "criterion", *ASKED)),
        "evaluate": ("policies", ("criterion", *OF_POLICY, *ASKED)),
        "returns": ("policies", (*OF_POLICY, *ASKED)),
        "simulate": ("policies", (*OF_POLICY, *ASKED)),
    },
    "Vary": {
        "tornado": ("vary", ("criterion", *HELD)),
        "gradient": ("vary", ("criterion", "parameters", *HELD[3:])),
        "threshold": ("vary", ("criterion", *VARIED[:3], "horizon", *ASKED)),
        "curve": ("vary", ("criterion", *HELD)),
        "one-way": ("vary", ("criterion", *HELD)),
        "two-way": ("vary", ("criterion", *HELD)),
        "psa": ("vary", ("criterion", "parameters", *HELD[3:])),
        "sobol": ("vary", ("criterion", *HELD)),
        "robust": ("vary", ("criterion", *HELD)),
        "explore": ("vary", ("criterion", "ranges", "relative", "kind", "horizon", *ASKED)),
    },
    "Trade": {
        "tradeoff": ("trade", ("criterion", "horizon", *OF_FRONT)),
        "rationalize": ("trade", ("criterion", *OF_POLICY, *ASKED)),
        "ce": ("trade", ("horizon", *SETS)),
        "risk": ("trade", ("horizon", *ASKED)),
    },
    "Models": {
        "info": ("models", SETS),
        "convert": ("models", SETS),
        "data": ("models", ()),
        "train": ("train", SETS),
    },
    "Care": {
        "new": ("models", ()),
        "lint": ("models", ()),
        "perception": ("trade", SETS),
    },
}


class CommandParameter(NamedTuple):
    """A parameter of a function, with its type and its text from the docstring."""

    name: str
    kind: str  # the annotation, as it is written
    default: Any
    required: bool  # whether it has no default
    named: bool  # whether it is keyword-only, and so an option
    form: str
    help: str

    @property
    def endings(self) -> list[str]:
        """The endings that an output file may have."""
        return re.findall(r"\.\w+", self.form)

    @property
    def multiple(self) -> bool:
        """Whether several values may be given."""
        return self.kind.startswith("Sequence")

    def to_click(self) -> click.Parameter:
        """Return the argument or option."""
        words = re.findall(r'"([^"]+)"', self.form)
        form = "|".join(words) or self.form.partition(",")[0]
        if not self.named:
            return self._to_argument(form)
        name, help_ = self.name, self.help
        if self.multiple:  # --parameter for `parameters`, --policy for `policies`
            name = re.sub("ie$", "y", name.removesuffix("s"))
        names = ["--" + name.replace("_", "-"), self.name]
        # A number of 0 is shown, although it equals False.
        if not self.required and repr(self.default) not in ("None", "False", "()"):
            help_ = f"{help_[:-1]} ({self.default})."
        if self.kind == "bool":
            return click.Option(names, is_flag=True, default=None, help=help_)
        if self.multiple and "once" not in self.form:
            help_ += " May be repeated."
        whole = None
        if self.kind.startswith("int"):
            ends = re.search(r"(\d+) to (\d+)", self.form)
            if ends:
                whole = click.IntRange(int(ends[1]), int(ends[2]))
            else:
                whole = click.IntRange(0)
        return click.Option(
            names,
            metavar=form,
            multiple=self.multiple,
            required=self.required,
            type=whole,
            help=help_,
        )

    def _to_argument(self, form: str) -> click.Argument:
        """Return the argument, which is shown as `form`, by default as its name in capitals."""
        metavar, nargs = form, 1
        if self.multiple:
            nargs = -1
        if not metavar:
            metavar = self.name.upper()
            if self.multiple:
                metavar += "..."
        if not self.required:
            metavar = f"[{metavar}]"
        return click.Argument([self.name], required=self.required, nargs=nargs, metavar=metavar)


def name_function(command: str) -> str:
    """Return the name of a command's function: `one_way_command` for "one-way"."""
    return command.replace("-", "_") + "_command"


def parse_signature(module: str, name: str) -> tuple[str, list[CommandParameter]]:
    """Return the text of the docstring of a function or dataclass of a module, and its parameters.

    A parameter that the docstring does not explain is explained by `Given` or by another function
    of the module.
    """
    near, far = load_definitions(module), load_definitions(GIVEN[0])
    said = defaultdict[str, tuple[str, str]](lambda: ("", ""))
    for node in (*reversed(near.values()), *far.values(), near[name]):
        said |= _parse_docstring(node)[1]
    parameters = []
    for parameter, annotation, default, named in _list_parameters(near[name]):
        value = None
        if default is not None:
            value = ast.literal_eval(default)
        parameters.append(
            CommandParameter(
                parameter,
                ast.unparse(annotation) if annotation else "",
                value,
                default is None,
                named,
                *said[parameter],
            )
        )
    return _parse_docstring(near[name])[0], parameters


Definition = ast.FunctionDef | ast.ClassDef


@cache
def load_definitions(module: str) -> dict[str, Definition]:
    """Return the functions and classes of a module of this folder, parsed but not imported."""
    source = Path(__file__).with_name(f"{module}.py").read_text("utf-8")
    nodes = ast.parse(source).body
    return {node.name: node for node in nodes if isinstance(node, Definition)}


def _list_parameters(
    node: Definition,
) -> Iterator[tuple[str, ast.expr | None, ast.expr | None, bool]]:
    """Yield name, annotation and default of each parameter, and whether it is keyword-only.

    The parameters of a dataclass are its fields; all that are read here are keyword-only.
    """
    if isinstance(node, ast.ClassDef):
        for field in node.body:
            if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name):
                yield field.target.id, field.annotation, field.value, True
        return
    # Defaults of positional parameters belong to the last ones.
    positional, defaults = node.args.args, node.args.defaults
    without = [None] * (len(positional) - len(defaults))
    for each, default in zip(positional, [*without, *defaults], strict=True):
        yield each.arg, each.annotation, default, False
    for each, default in zip(node.args.kwonlyargs, node.args.kw_defaults, strict=True):
        yield each.arg, each.annotation, default, True


def _parse_docstring(node: Definition) -> tuple[str, dict[str, tuple[str, str]]]:
    """Return a docstring's text, and type and text of each parameter."""
    text = re.sub(r"\{formats:(\w+)\}", _describe_files, ast.get_docstring(node) or "")
    head, *sections = re.split(r"\n\n(?=Parameters\n-|Keys\n-)", text)
    parameters = [each for each in sections if each.startswith("Parameters")]
    said: dict[str, tuple[str, str]] = {}
    if not parameters:
        return head, said
    # A block begins with "names : type", and its text is indented.
    for block in re.split(r"\n(?=\S)", parameters[0].split("\n", 2)[2]):
        form, _, below = block.partition("\n")
        names, _, kind = form.partition(" : ")
        text = re.sub(r"\{([\w.]+):(\w+)\}", _read_dict_keys, " ".join(below.split()))
        said |= dict.fromkeys(names.split(", "), (kind, text))
    return head, said


def _describe_files(match: re.Match[str]) -> str:
    """Return the description of the formats "{formats:NAME}"."""
    return describe_formats(getattr(formats, match[1]))


def _read_dict_keys(match: re.Match[str]) -> str:
    """Return the keys of a dict "{module:NAME}", read from the module's source."""
    path = PACKAGE.joinpath(*match[1].split(".")).with_suffix(".py")
    for node in ast.parse(path.read_text("utf-8")).body:
        if isinstance(node, ast.AnnAssign) and ast.unparse(node.target) == match[2]:
            assert isinstance(node.value, ast.Dict)
            return ", ".join(ast.literal_eval(key) for key in node.value.keys if key)
    raise LookupError(match[0])


class Command(StrictCommand):
    """A command whose help lists its options in sections: own, model, work and output."""

    shared: Sequence[str] = ()

    def format_options(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the sections."""
        sections: dict[str, list[tuple[str, str]]]
        sections = {title: [] for title in ("Options", "Model", WORK, "Output")}
        for each in self.get_params(ctx):
            record = each.get_help_record(ctx)
            if record is None or isinstance(each, click.Argument):
                continue
            if {"--json", "--markdown", "--help"} & {*each.opts}:
                title = "Output"
            elif each.name in OF_WORK:
                title = WORK
            elif each.name in self.shared:
                title = "Model"
            else:
                title = "Options"
            sections[title].append(record)
        for title, records in sections.items():
            if records:
                with formatter.section(title):
                    formatter.write_dl(records)


def make_command(name: str, module: str, shared: Sequence[str], epilog: str) -> click.Command:
    """Return a command, whose function is in a module of this folder.

    `shared` are the parameters of `Given` that it has as options; `epilog` stands at the end of the
    help.
    """
    text, own = parse_signature(module, name_function(name))
    said, *examples = re.split(r"\s*^Example: ", text, flags=re.M)
    named = {each.name for each in own}
    asked = [each for each in parse_signature(*GIVEN)[1] if each.name in {*shared} - named]
    params: list[click.Parameter] = []
    for each in own:
        if each.name == "given":
            params.append(click.Argument(["model"]))
        else:
            params.append(each.to_click())
    params += [each.to_click() for each in asked]
    for form, what in (("json", "one JSON object"), ("markdown", "Markdown")):
        option = [f"--{form}", f"as_{form}"]
        params.append(click.Option(option, is_flag=True, help=f"Print {what}."))

    def run_and_print(*, as_json: bool, as_markdown: bool, **options: Any) -> int:
        if as_json and as_markdown:
            raise ModelError("two forms of one output", where="--markdown", fix="leave out --json")
        try:
            # The user's code may print, which must not mix with the result on standard output.
            with redirect_output():
                report = _call_function(name, module, own, [each.name for each in asked], options)
        except click.exceptions.Exit as end:  # raised by the code that was called, not by --help
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
    name: str, module: str, own: list[CommandParameter], asked: list[str], options: dict[str, Any]
) -> Any:
    """Call a command's function with the options that were given, and return its report."""
    imported = import_module(f"exact_mdp.analysis.cli.{module}")
    call: Callable[..., Any] = getattr(imported, name_function(name))
    typed = {key: value for key, value in options.items() if value is not None and value != ()}
    files = ((typed[p.name], p.endings) for p in own if p.endings and p.name in typed)
    import_module("exact_mdp.analysis.cli.words").check_outputs(files)
    words = {each.name: typed[each.name] for each in own if each.name in typed}
    # Options of the model, and a policy that is read for that model, go through `Given`.
    if any(each.name == "given" for each in own):
        has = {*asked} | {each.name for each in own if each.kind.startswith("Policy")}
        shared = {key: typed[key] for key in has if key in typed}
        kind = import_module("exact_mdp.analysis.cli.given").Given
        words["given"] = given = kind(model=options["model"], has=has, **shared)
        if "policy" in has - {*asked} and given.taken is not None:
            words["policy"] = given.taken
    return call(**words)


def _list_all_commands() -> dict[str, tuple[str, tuple[str, ...]]]:
    """Return the entries of all groups of `MADE`."""
    every = dict[str, tuple[str, tuple[str, ...]]]()
    for group in MADE.values():
        every |= group
    return every


class Commands(click.Group):
    """The group of all commands, each made when it is first needed."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        """Return the names of all commands."""
        return list(_list_all_commands())

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        """Return the command of a name; None if there is none."""
        made = _list_all_commands()
        if cmd_name in made and cmd_name not in self.commands:
            module, shared = made[cmd_name]
            epilog = ""
            if {"kind", "perception"} & {*shared} or cmd_name in ("risk", "tradeoff"):
                epilog = POLICY
            self.commands[cmd_name] = make_command(cmd_name, module, shared, epilog)
        return self.commands.get(cmd_name)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        """Write the commands group by group, each with a short description."""
        for title, names in MADE.items():
            lines = []
            for name in names:
                command = self.get_command(ctx, name)
                if command is not None:
                    lines.append((name, command.get_short_help_str(66)))
            with formatter.section(title):
                formatter.write_dl(lines)
