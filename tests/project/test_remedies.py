"""What messages advise is there, and works: options, commands, names, keywords, files.

Every text of the package that is read by people, fixes and notes above all, is taken from its
syntax tree. What looks like code in it has to be covered by a rule; the table beside this file
follows advice: a call that is refused, words of its fix, and the call that does as it says.
"""

import ast
import inspect
import math
import re
import tomllib
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import fields, is_dataclass
from fractions import Fraction
from functools import cache
from inspect import getmembers
from pathlib import Path
from pkgutil import resolve_name
from tempfile import TemporaryDirectory
from typing import Any

import click
import numpy as np
import pandas as pd
import pytest
import scipy.sparse as sp
from cli_runner import ROOT, run
from records import POLICY, estimated, recorded  # noqa: F401 - the table names it
from refusal_tables import refused

import exact_mdp
from exact_mdp import (
    MDP,
    Certificate,
    Family,
    ModelError,
    OffPolicy,
    Parameter,
    Posterior,
    Robust,
    Scenario,
    Solution,
    certify,
    load,
)

PACKAGE = ROOT / "exact_mdp"
EXTRAS = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"][
    "optional-dependencies"
]
PUBLIC = {name: getattr(exact_mdp, name) for name in vars(exact_mdp)["__all__"]}
KINDS = {
    "mdp": MDP,
    "model": MDP,
    "certificate": Certificate,
    "family": Family,
    "scenario": Scenario,
    "solution": Solution,
}
MODULES = {"exact_mdp": exact_mdp, "np": np, "numpy": np, "pandas": pd, "math": math}
RETURNED = {"solve": Solution, "certify": Certificate, "load": Scenario, "with_": MDP}

# What is the user's own, or another package's: the words before a dot or a bracket.
OTHERS = {
    "pathlib",
    "pickle",
    "agent",
    "array",
    "bool",
    "encode",
    "env",
    "float",
    "frame",
    "lambda",
    "log",
    "mod",
    "net",
    "reset",
}
OTHERS |= {"F", "KL", "step", "table"}
# What stands before "=" and is no keyword of Python: a total, a column, an option of Gymnasium.
OWN = {"name", "trial", "inadmissible_action_strategy"}
# Words after the name of the program that are no command.
AFTER = {"certificate", "model", "this", "wrote"}

# Texts with a whole line of code, and the test that runs it.
RUN_ELSEWHERE = {
    "number the episodes: frame[": "mdp/io/test_transitions.py",
    "add the state that follows: frame[": "mdp/io/test_transitions.py",
}

CODE = re.compile(
    r"--[a-z]|\b[A-Za-z_]\w*\(|\b[A-Za-z_]+=(?![=\s])|\b[A-Za-z_]\w*\.[A-Za-z_]{2,}|(?<!\w)\.[a-z]{2,7}\b"
    r"|exact-mdp|\bpip\b"
)


def parts_of(node: ast.AST) -> list[ast.AST]:
    """The pieces that a text is joined of, in order."""
    if isinstance(node, ast.JoinedStr):
        return list(node.values)
    if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add):
        return [*parts_of(node.left), *parts_of(node.right)]
    return [node]


def written(node: ast.AST) -> str:
    """The text that a node writes, {} where it is filled."""
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return node.value
    parts = parts_of(node)
    return "{}" if parts == [node] else "".join(map(written, parts))


def is_no_message(node: ast.AST) -> bool:
    """Docstrings, the help of options, and patterns."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Attribute):
        return isinstance(node.func.value, ast.Name) and node.func.value.id == "re"
    if isinstance(node, ast.keyword):
        return node.arg == "help"
    return isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)


def texts_in(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """The texts in a module, with their lines."""
    waiting = [tree]
    while waiting:
        node = waiting.pop()
        if isinstance(node, ast.Name) or is_no_message(node):
            continue
        inside = list(ast.iter_child_nodes(node))
        joined = isinstance(node, ast.Constant | ast.JoinedStr | ast.BinOp)
        if joined and set(text := written(node)) - set("{}"):
            yield node.lineno, text
            pieces = [each for part in parts_of(node) for each in parts_of(part)]
            inside = [each for each in pieces if not set(written(each)) - set("{}")]
        waiting.extend(inside)


@cache
def texts() -> list[tuple[str, str]]:
    """All texts of the package but what the paper says, each with its file and line."""
    paths = [each for each in PACKAGE.rglob("*.py") if not re.match("section_|claim", each.name)]
    return [
        (f"{path.relative_to(PACKAGE)}:{line}", text)
        for path in sorted(paths)
        for line, text in texts_in(ast.parse(path.read_text("utf-8")))
    ]


@cache
def messages() -> dict[str, str]:
    """The sentences of the package that hold code, by place."""
    found = {}
    for place, text in texts():
        sentence = re.search(r"[a-z]{2,} [a-z(\"'-]|--[a-z]+.* ", text)
        shown = re.match(r"<|[A-Z]\w+\((?!.*\. )", text)  # HTML, or a result in one line
        elsewhere = any(text.startswith(each) for each in RUN_ELSEWHERE)
        if sentence and not shown and not elsewhere and CODE.search(text):
            found[f"{place} {text}"] = text
    return found


@cache
def endings() -> set[str]:
    """The endings of files that the code compares with."""
    return {text for _, text in texts() if re.fullmatch(r"\.[a-z]{2,7}", text)}


OPTION = re.compile(r"--([a-z][a-z-]+)(?: ([A-Za-z{}][\w.{}-]*)=\S*)?")


@cache
def options(program: str) -> set[str]:
    """The options of a program, of all its commands."""
    group = resolve_name(f"exact_mdp.{program}")
    context = click.Context(group)
    commands = [group.get_command(context, name) for name in group.list_commands(context)]
    return {name for each in [group, *commands] for param in each.params for name in param.opts}


def expression(text: str, start: int) -> str:
    """The call that begins in a text, with the calls of what it returns."""
    end = depth = 0
    for end in range(start, len(text)):
        depth += (text[end] in "([{") - (text[end] in ")]}")
        if text[end] in ")" and depth == 0 and not re.match(r"\.\w+\(", text[end + 1 :]):
            break
    return text[start : end + 1]


@cache
def commands() -> list[str]:
    """The commands of the program."""
    group = resolve_name("exact_mdp.analysis.cli:cli")
    return list(group.list_commands(click.Context(group)))


def keywords(function: Any) -> set[str]:
    """The names of what a function takes; of `with_`, also the parts of a model."""
    taken = inspect.signature(function).parameters
    changed = {each.name for each in fields(MDP)} | {"states"}
    return {*taken} | (changed if function is MDP.with_ else set())


def everything() -> list[Any]:
    """What public names can be called with keywords, and what they have that can."""
    classes = [each for each in PUBLIC.values() if inspect.isclass(each)]
    methods = [each for kind in classes for name, each in getmembers(kind) if name[0] != "_"]
    return [each for each in [*PUBLIC.values(), *methods] if callable(each)]


@cache
def any_keyword() -> set[str]:
    """The keywords of all public names."""
    found = set[str]()
    for each in everything():
        with suppress(ValueError, TypeError):
            found |= keywords(each)
    return found


def of(node: ast.expr) -> Any:
    """What an expression of a message stands for: an object, a class for what is of it, or None.

    Asserts that all of it is there, with the keywords that it is given.
    """
    if isinstance(node, ast.Name):
        known = KINDS | MODULES | PUBLIC
        if node.id in known:
            return known[node.id]
        if hasattr(MDP, node.id):  # as in within(N)
            return getattr(MDP, node.id)
        assert node.id in OTHERS, f"nothing is called {node.id}"
        return None
    if isinstance(node, ast.Attribute):
        owner = of(node.value)
        if owner is None:
            return None
        named = {each.name for each in fields(owner)} if is_dataclass(owner) else set()
        assert hasattr(owner, node.attr) or node.attr in named, f"{ast.unparse(node)} is not there"
        return getattr(owner, node.attr, None)
    if isinstance(node, ast.Call):
        function = of(node.func)
        for each in node.keywords:
            known = function is None or function in MODULES or each.arg in keywords(function)
            assert known, f"{ast.unparse(node.func)} takes no {each.arg}="
        for inner in [*node.args, *(each.value for each in node.keywords)]:
            for call in ast.walk(inner):
                if isinstance(call, ast.Call | ast.Attribute):
                    of(call)
        return RETURNED.get(getattr(function, "__name__", ""))
    return None


def parsed(text: str) -> ast.expr:
    """Code of a message as Python: "…" and {} stand for what is given, as do words with a space."""
    text = text.replace("…", "...").replace("‖", ",").replace("{}", "_")
    return ast.parse(text.replace("next state", "next_state"), mode="eval").body


def check_names_of(text: str, program: str) -> None:
    """Assert that what a text names is there; that nothing is left that looks like code."""
    for name, part in OPTION.findall(text):
        assert f"--{name}" in options(program), f"no command has --{name}"
        if name == "evidence" and part != "NAME":
            assert any(part in keywords(each) for each in (Robust, Posterior, OffPolicy)), part
    text = OPTION.sub("", text)
    for word in re.findall(r"exact-mdp ([a-z]+)", text):
        assert word in {*AFTER, *commands()}, f"there is no command {word}"
    for name in re.findall(r"exact-mdp\[(\w+)\]", text):
        assert name in EXTRAS, f"there is no extra {name}"
    text = re.sub(r"(pip install )?\"?exact-mdp(\[[\w{}]+\])?\"?|pip install \.", "", text)
    while match := re.search(r"(?<![\w.])[A-Za-z_][\w.]*\(", text):
        call = expression(text, match.start())
        of(parsed(call))
        text = text.replace(call, "")
    for name in re.findall(r"\b([A-Za-z_]+)=(?!=)", text):
        assert name in any_keyword() | OWN or name.isupper(), f"nothing takes {name}="
    text = re.sub(r"\b[A-Za-z_]+=(?!=)", "", text)
    for dotted in re.findall(r"\b[A-Za-z_]\w*(?:\.[A-Za-z_]\w*)+(?![\w…])", text):
        if f".{dotted.rpartition('.')[2]}" not in endings():
            resolve_name(dotted) if dotted.startswith("exact_mdp.") else of(parsed(dotted))
    text = re.sub(r"\b[A-Za-z_]\w*(\.[A-Za-z_]\w*)+", "", text)
    for member in re.findall(r"(?<![\w.])\.([a-z]{2,7})\b", text):
        assert f".{member}" in endings() or hasattr(Solution, member), f"no file ends in .{member}"
    text = re.sub(r"\.[a-z]{2,7}\b", "", text)
    assert not (found := CODE.search(text)), f"no rule covers {found and found[0]!r}"


def test_what_messages_name_is_there() -> None:
    faults = {}
    for place, text in messages().items():
        module = "analysis.cli:cli"
        if place.startswith("paper_repro"):
            agents = "agents." if "/agents/" in place else ""
            module = f"paper_repro.{agents}__main__:main"
        try:
            check_names_of(text, module)
        except (AssertionError, ImportError, SyntaxError) as error:
            faults[place] = str(error)
    assert len(messages()) > 150
    assert faults == {}


# ---- advice that is followed ---------------------------------------------------------------------

F, inf, nan = Fraction, math.inf, math.nan
EYE = np.eye(2)
ALIKE = [EYE, EYE]
THREE = np.array([[[0, 1, 0], [0, 0, 1], [1, 0, 0]], [[0, 0, 1], [1, 0, 0], [0, 1, 0]]])
HALVES = np.random.default_rng(0).dirichlet([1] * 9, (1, 9))
LISTED = {0: {0: [(1.0, 0, 0, True)]}}
LOOP = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
EVEN = MDP.from_arrays(
    [EYE] * 2, [[1, 0], [0, 1]], "1/2", layout="ass", states=["a", "b"], actions=["l", "r"]
)
GOAL = MDP.from_outcomes(
    [(0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)]),
     (2, 0, [(1, 2, 0)])],
    labels={"goal": [False, True, False]},
)  # fmt: skip
COSTS = EVEN.with_(sense="min")
EARN = MDP.from_outcomes(
    [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 2)])], components={"a": [1, 0], "b": [0, 2]}
)
SWING = MDP.from_outcomes([(0, 0, [(1, 1, -1)]), (1, 0, [(1, 0, 1)])])
FALLING = MDP.from_outcomes(
    [(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])],
    sense="min",
    labels={"goal": [False, True]},
)
APART = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (1, 0, [(1, 1, -1)])], start=["1/2", "1/2"])
SURE = MDP.from_outcomes([(0, 0, [(1, 0, 1)])], 1 - 1e-9)
STAYS = MDP.from_outcomes([(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])])
WAITING = MDP.from_outcomes(
    [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 0, -1)]), (0, 2, [(1, 0, 0)]), (1, 0, [(1, 1, 0)])]
)
WIDE = MDP.from_arrays([np.roll(np.eye(49), 1, axis=1)], [0] * 49, "1/2")


def family(reward: Any, **how: Any) -> Family:
    def build(at: Any) -> MDP:
        return MDP.from_arrays(
            [[[at["p"], 1 - at["p"]], [0, 1]]] * 2,
            [[reward(at["p"]), "1/3"], [0, 0]],
            "1/2",
            layout="ass",
        )

    half = Parameter(name="p", value="1/4", low=0, high=1)
    return Family(parameters=(half,), build=build, **how)


FAMILY = family(lambda p: p)
SQUARED, SQUARED_2 = family(lambda p: p**2), family(lambda p: p**2, degrees={"p": 2})
BROKEN = family(lambda p: min(p, F(1, 2)))
BROKEN_THERE = family(lambda p: min(p, F(1, 2)), breaks={"p": ["1/2"]})
FREE = Family(parameters={"p": 0}, build=lambda at: LOOP)
KINK = family(lambda p: F(1, 3))
CHANGING, KEPT = (
    Family(
        parameters=(Parameter(name="p", value="1/4", low=0, high=1),),
        build=lambda at, kept=kept: MDP.from_function(
            0,
            lambda s: [0] if s == 0 else [],
            lambda s, a: [(at["p"], 1, 1), (1 - at["p"], 2, 0)],
            impossible=kept,
        ),
    )
    for kept in (False, True)
)
ALONE = {"effect": "reward", "cost": "reward"}
FRAME = recorded(np.random.default_rng(4), 100)
SEEN = estimated(FRAME)


def saved(how: Any) -> MDP:
    with TemporaryDirectory() as folder:
        how(LOOP, path := Path(folder) / "model.npz")
        return load(next(path.parent.iterdir()))


def reread(certificate: Certificate) -> Certificate:
    with TemporaryDirectory() as folder:
        certificate.save(path := Path(folder) / "proof.json")
        return Certificate.load(path)


def rows() -> list[tuple[str, str, str]]:
    """The rows of the table beside this file; <one|other> in the last part is each in turn."""
    found = []
    table = Path(__file__).with_suffix(".txt").read_text("utf-8")
    for line in re.sub(r"\n {4}", " ", table).splitlines():
        if line and not line.startswith("#"):
            call, said, then = line.split(" -> ")
            head, *choice = re.split(r"<([^<>]*\|[^<>]*)>", then)
            for each in choice[0].split("|") if choice else [""]:
                found.append((call, said, "".join([head, each, *choice[1:]])))
    return found


WORLD = {**PUBLIC, "np": np, "pd": pd, "sp": sp, **globals()}
SAVED = {"apart": APART, "costs": COSTS, "earn": EARN, "even": EVEN, "goal": GOAL, "loop": LOOP}
SAVED |= {"seen": SEEN, "swing": SWING}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the files that commands of the table name."""
    folder = tmp_path_factory.mktemp("remedies")
    for name, model in SAVED.items():
        model.save(folder / f"{name}.npz")
    np.save(folder / "table.npy", [[3.0, 1], [1, 2]])
    np.save(folder / "shares.npy", [[1.0, 0], [0, 1]])
    certify(EVEN).save(folder / "even.json")
    FRAME.to_csv(folder / "records.csv", index=False)
    FRAME.rename(columns={"reward": "gain"}).to_csv(folder / "sold.csv", index=False)
    FRAME.assign(done=True, terminated=False).to_csv(folder / "ended.csv", index=False)
    (folder / "drawn.toml").write_text('"reward.1" = {sd = 0.1}', "utf-8")
    assert run("new", folder / "care.toml").status == 0
    return folder


@pytest.mark.parametrize("call, said, then", rows())
def test_advice_can_be_followed(
    call: str, said: str, then: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(folder)
    if call.startswith("$ "):
        assert said in run(call[2:]).error().fix
        assert (done := run(then)).status == 0, done.err
        return
    with pytest.raises(ModelError) as caught:
        eval(call, WORLD)
    assert said in caught.value.fix
    eval(then, WORLD)


@pytest.mark.parametrize(
    "call, useless",
    [
        ('evaluate(SWING, "random").visits', "average"),
        ('tradeoff(EARN, ["a", "b"])', "what is 0"),
        ('ValueIteration().solve(GOAL.until("goal"))', "stays put"),
        ('tornado(FAMILY, names=["q"])', "moving("),
        ("tornado(EARN)", "policy"),
        ("gradient(SWING)", "range"),
        ("MDP.from_arrays(EYE[None])", "MDP.load"),
    ],
)
def test_what_does_not_help_is_not_advised(call: str, useless: str) -> None:
    assert useless not in refused(lambda: eval(call, WORLD)).fix
