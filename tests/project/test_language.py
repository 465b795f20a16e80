"""How the code names things: a function by a verb and its object, and each thing by one name."""

import ast
import re
from collections import defaultdict
from collections.abc import Iterator
from pathlib import Path

import exact_mdp

PACKAGE = Path(exact_mdp.__file__).parent
ROOT = Path(__file__).resolve().parents[2]
PARTICIPLE = re.compile(r"[a-z]+(ed|en|ing)")
IRREGULAR = re.compile(
    "known|kept|shown|meant|taken|given|held|told|found|made|said|left|lost|seen|read|written|"
    "chosen|drawn|least|most|short|long|alone|alike|poor|slow|whole|apart|common|often|nearly"
)
VERBS = {"feed", "need", "seed", "embed", "exceed"}
# Names that users script against, and their overrides.
PUBLIC = {"perceived", "counted", "negated", "moving", "reaching", "earning"}
INNER = {"claimed", "fixed", "flipped", "seen"}  # short helpers inside one function
SEVERAL_HOMES = {"main", "__dir__", "Level"}  # entry points; the checker has levels of its own


def modules() -> Iterator[tuple[Path, ast.Module]]:
    """Yield the modules but for the proven checker, which has the names of the Coq program."""
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.name != "verified.py":
            yield path, ast.parse(path.read_text("utf-8"))


def functions() -> list[tuple[Path, str]]:
    """Return the names of all functions, without properties and special methods."""
    found = list[tuple[Path, str]]()
    for path, tree in modules():
        for node in ast.walk(tree):
            if not isinstance(node, ast.FunctionDef) or node.name.startswith("__"):
                continue
            if not any("property" in ast.unparse(each) for each in node.decorator_list):
                found.append((path, node.name.lstrip("_")))
    return found


def test_a_function_is_a_verb_with_its_object() -> None:
    names = functions()
    words = [name for _, name in names if "_" not in name]
    assert len(words) <= 0.2 * len(names)
    for path, name in names:
        bare = PARTICIPLE.fullmatch(name) or IRREGULAR.fullmatch(name)
        assert not bare or name in VERBS | PUBLIC | INNER, (path, name)


def test_a_name_has_one_home() -> None:
    homes = defaultdict[str, set[Path]](set)
    for path, tree in modules():
        for node in tree.body:
            if isinstance(node, ast.FunctionDef | ast.ClassDef):
                homes[node.name].add(path)
    assert {name for name, where in homes.items() if len(where) > 1} <= SEVERAL_HOMES


def test_the_glossary_explains_each_word_once() -> None:
    page = (ROOT / "ARCHITECTURE.md").read_text("utf-8")
    glossary = page.partition("## Glossary")[2].partition("\n## ")[0]
    words = [line.split("|")[1].strip() for line in glossary.splitlines() if line.startswith("| ")]
    words = [word for word in words if word != "word"]
    assert len(words) == len(set(words)) >= 60


def test_the_code_is_plain() -> None:
    """An `if` statement reads more easily than a conditional expression; long steps say why."""
    conditional = code = comments = 0
    for path, tree in modules():
        conditional += sum(isinstance(node, ast.IfExp) for node in ast.walk(tree))
        lines = [line.strip() for line in path.read_text("utf-8").splitlines()]
        comments += sum(line.startswith("#") for line in lines)
        code += sum(bool(line) and not line.startswith("#") for line in lines)
    # Lines of docstrings count as code here.
    assert conditional <= 6 / 1000 * code
    assert comments >= 2.7 / 100 * code


def is_text(node: ast.expr) -> bool:
    """Return whether an expression is a text, or a list."""
    if isinstance(node, ast.Constant):
        return isinstance(node.value, str)
    return isinstance(node, ast.JoinedStr | ast.List)


def is_truth_value(node: ast.expr) -> bool:
    """Return whether an expression is plainly a truth value."""
    if isinstance(node, ast.Call):
        return ast.unparse(node.func) == "bool"
    negated = isinstance(node, ast.UnaryOp) and isinstance(node.op, ast.Not)
    return negated or isinstance(node, ast.Compare | ast.BoolOp)


def test_no_text_is_multiplied_by_a_truth_value() -> None:
    for path, tree in modules():
        for node in ast.walk(tree):
            if isinstance(node, ast.BinOp) and isinstance(node.op, ast.Mult):
                for one, other in ((node.left, node.right), (node.right, node.left)):
                    said = path, ast.unparse(node)
                    assert not (is_text(one) and is_truth_value(other)), said


def test_no_frame_is_walked_and_no_text_is_run() -> None:
    for path, tree in modules():
        called = {ast.unparse(n.func) for n in ast.walk(tree) if isinstance(n, ast.Call)}
        assert not called & {"exec", "eval", "sys._getframe", "inspect.currentframe"}, path


def test_the_english_is_plain() -> None:
    """A relative clause is not a noun: "the value" reads more easily than "what it is worth"."""
    allowed = {"checker.py", "duals.py"}  # whose sentences others compare with
    for path, _ in modules():
        text = path.read_text("utf-8")
        assert path.name in allowed or "Return what" not in text, path
        assert not re.search(r"\bfor ever\b", text), path
