"""README, pages and docstrings: code runs, links lead somewhere, what is made from code is new."""

import ast
import importlib.util
import inspect
import json
import re
import shlex
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from typing import Any

import matplotlib as mpl
import matplotlib.pyplot as plt
import numpy as np
import pytest
from cli_runner import main

from exact_mdp.paper_repro.agents.__main__ import main as agents

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
TOP = [ROOT / f"{name}.md" for name in ("README", "ARCHITECTURE", "CONTRIBUTING", "SECURITY")]
PAGES = {page.relative_to(ROOT).as_posix(): page for page in [*TOP, *sorted(DOCS.rglob("*.md"))]}
SLOW = {"docs/tradeoffs.md", "docs/sensitivity.md"}
# Not run: what needs Storm, a key, or a file of the reader's.
NEEDS = ("model.prism", "model.umb", "--backend", "MyEnv")
CODE = re.compile(r"^```.*?^```$", re.M | re.S)
PROGRAMS = ("exact-mdp ", "python -m exact_mdp.paper_repro.agents ")
SHOWN = {
    "README.md": ["Fraction(6561, 250)"],
    "docs/coming_from.md": [
        "-8.571428", "-20. ", "Policy([0 0]", "[74.6496 78.1056 82.1056] Policy([0 0 0]", "-4 ",
        "('LEFT', 'DOWN', 'RIGHT', 'UP') row 1, column 2",
    ],
    "docs/models.md": ["204.437844292 ±", "26.244", "\n1\n1/3\n"],
    "docs/records.md": ["True (0.0, 0.0)"],
    "docs/theory.md": ["[  5. -inf   0.]", "3.24 ±", "81/25 38/5"],
}  # fmt: skip
spec = importlib.util.spec_from_file_location("write", DOCS / "write.py")
assert spec
assert spec.loader
write = importlib.util.module_from_spec(spec)
spec.loader.exec_module(write)


def text(name: str) -> str:
    return PAGES[name].read_text("utf-8")


def blocks(name: str) -> list[tuple[str, str]]:
    return re.findall(r"^```(\w*)\n(.*?)^```$", text(name), re.M | re.S)


def lines(block: str) -> list[str]:
    """Return the command lines of a block that can be run."""
    listed = [line for line in block.splitlines() if line.startswith(PROGRAMS)]
    return [line for line in listed if not any(word in line for word in NEEDS)]


def pages_with_code() -> Iterator[object]:
    for name in sorted(set(PAGES) - {"docs/gallery.md"}):  # which has a test of its own
        if any(kind == "python" or (not kind and lines(body)) for kind, body in blocks(name)):
            yield pytest.param(name, marks=[pytest.mark.slow] * (name in SLOW))


@pytest.mark.parametrize("name", list(pages_with_code()))
def test_the_code_of_a_page_runs(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """All blocks in their order; a gate whose Q-table is made up here finds what it loses."""
    monkeypatch.chdir(tmp_path)
    np.save("q_table.npy", np.eye(4)[[1] * 16])
    names: dict[str, object] = {}
    printed = ""
    with mpl.rc_context({"backend": "Agg"}):
        for kind, body in blocks(name):
            if kind == "python":
                exec(compile(body, name, "exec", dont_inherit=True), names)
            for line in lines(body) if not kind else []:
                words = shlex.split(line)
                if words[0] == "python":
                    with pytest.raises(SystemExit, match=r"^0$"):
                        agents(words[3:])
                else:
                    assert main(words[1:]) == int("q_table.npy" in words), line
            printed += capsys.readouterr().out
    plt.close("all")
    shown = SHOWN.get(name, []) + [body for kind, body in blocks(name) if kind == "text"]
    assert [each for each in shown if each not in printed] == []


def test_there_is_something_to_run() -> None:
    assert len(list(pages_with_code())) >= 12
    assert sum(len(lines(body)) for name in PAGES for kind, body in blocks(name) if not kind) >= 30


@pytest.mark.parametrize("name", PAGES)
def test_a_page_imports_public_names_and_needs_no_build(name: str) -> None:
    assert not re.search(r"^(from|import) exact_mdp\.\w", text(name), re.M)
    assert not re.search(r"^(```|:::)\{|\{(doc|ref|py:\w+)\}`|^\.\. \w+::", text(name), re.M)


@pytest.mark.parametrize("name", [name for name in PAGES if name.startswith("docs/")])
def test_what_is_made_from_the_code_is_new(name: str) -> None:
    """Where it is not: `make docs` writes it again."""
    assert text(name) == write.with_made_parts(text(name))


def anchors(page: Path) -> set[str]:
    """Return the names by which a code host links the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", page.read_text("utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", each.lower()).replace(" ", "-") for each in headings}


@pytest.mark.parametrize("name", PAGES)
def test_links_lead_somewhere(name: str) -> None:
    """Files and headings; no page shows what a command rewrites and `make clean` removes."""
    page = PAGES[name]
    links = re.findall(r"\]\(([^)\s]+)\)", CODE.sub("", text(name)))
    for link in (link for link in links if "://" not in link):
        path, _, anchor = link.partition("#")
        target = (page.parent / path).resolve() if path else page
        assert target.exists(), link
        assert target.relative_to(ROOT).parts[0] != "results", link
        assert not anchor or anchor in anchors(target), link


def test_every_page_is_in_the_index() -> None:
    links = re.findall(r"\]\(([\w/]+\.md)", text("docs/README.md"))
    listed = {(DOCS / link).resolve() for link in links}
    assert set(DOCS.rglob("*.md")) - listed == {DOCS / "README.md"}


def test_the_front_is_short() -> None:
    assert len(text("README.md").split()) <= 800
    assert len(text("CONTRIBUTING.md").split()) <= 500
    prose = "".join(text(name) for name in PAGES if name == "README.md" or name.startswith("docs/"))
    by_hand = re.sub(r"<!-- made by.*?<!-- end -->", "", CODE.sub("", prose), flags=re.S)
    assert sum(bool(re.search(r"[A-Za-z0-9]", word)) for word in by_hand.split()) <= 10_300


def test_every_key_has_a_meaning_and_every_meaning_a_key() -> None:
    """The keys are those of the pinned answers."""
    keys = {(command, key) for key, names in write.pinned_keys().items() for command in names}
    assert keys == write.meanings().keys()
    shared, _ = write.explained_keys("analysis.cli.given:Given")
    assert shared.keys() <= {key for _, key in keys}


def test_the_certificate_shown_is_the_one_made(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the page checks by hand: the file, to the letter, and that its claims hold."""
    monkeypatch.chdir(tmp_path)
    listed = blocks("docs/reference/certificates.md")
    (block,), (shown,) = ([body for kind, body in listed if kind == k] for k in ("python", "json"))
    exec(compile(block, "certificates.md", "exec", dont_inherit=True), {})
    assert Path("proof.json").read_text("utf-8") == shown
    h = json.loads(shown)["h"]
    below = [h["below"][group] for group in h["group"]]
    value = [int(top, 16) / int(each, 16) for top, each in zip(h["top"], below, strict=True)]
    wait, stop = 1 + (value[0] / 2 + value[1] / 2) / 2, 1 + value[1] / 2
    assert (value[0], value[1]) == (pytest.approx(wait), 0)
    assert stop < value[0]


def test_every_figure_is_in_the_gallery() -> None:
    """A picture is called as the function that draws it; `docs/write.py figures` makes them."""
    functions = {
        node.name.removeprefix("plot_").removeprefix("draw_")
        for path in (ROOT / "exact_mdp" / "analysis" / "plots").glob("*.py")
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.FunctionDef) and node.name.startswith(("plot_", "draw_"))
    }
    pictures = set(re.findall(r"\(figures/(\w+)\.png\)", text("docs/gallery.md")))
    assert len(functions) > 20
    assert functions <= pictures == {path.stem for path in (DOCS / "figures").glob("*")}


@pytest.mark.slow
def test_a_block_of_the_gallery_draws_one_figure_for_each_picture() -> None:
    drawn = write.FIGURES.findall(text("docs/gallery.md"))
    assert len(drawn) == text("docs/gallery.md").count("```python")
    for block, shown in drawn:
        plt.close("all")
        exec(compile(block, "gallery.md", "exec"), {})
        figures = [plt.figure(number) for number in plt.get_fignums()]
        assert len(figures) == shown.count("![")
        assert all(any(ax.has_data() or ax.texts for ax in each.axes) for each in figures)
    plt.close("all")


# ---- docstrings ----------------------------------------------------------------------------------

ROOMS = ("", ".mdp", ".solvers", ".analysis", ".analysis.plots")


def public() -> Iterator[tuple[str, Any]]:
    """Every exported function, and every class method of an exported class."""
    for module in (import_module(f"exact_mdp{room}") for room in ROOMS):
        for name in getattr(module, "__all__", ()):
            thing = getattr(module, name)
            if inspect.isfunction(thing):
                yield name, thing
            elif inspect.isclass(thing):
                for key, method in inspect.getmembers(thing, inspect.ismethod):
                    if not key.startswith("_") and "exact_mdp" in method.__func__.__module__:
                        yield f"{name}.{key}", method.__func__


PUBLIC = dict(public())


@pytest.mark.parametrize("name", PUBLIC)
def test_a_public_function_is_documented(name: str) -> None:
    """It names its parameters, says what it returns, and has an example that the doctests run."""
    text, signature = inspect.getdoc(PUBLIC[name]) or "", inspect.signature(PUBLIC[name])
    named = [key for key in signature.parameters if key != "cls"]
    assert not named or "Parameters\n---" in text
    for key in named:
        assert re.search(rf"^[^:]*\b{key}\b[^:]*( :|$)", text, re.M), key
    assert signature.return_annotation in ("None", "Iterator[None]") or "Returns\n---" in text
    assert ">>>" in text
