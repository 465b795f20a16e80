"""The documentation: its code runs, its lists are whole. `make docs` checks links and builds it."""

from __future__ import annotations

import ast
import importlib.util
import json
import re
import time
import tomllib
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import matplotlib as mpl
import matplotlib.pyplot as plt
import pytest
from browser import CHROMIUM, Browser
from cli_runner import run

from exact_mdp import MDP

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
SCRIPTS = sorted((DOCS / "gallery").glob("*/*.py"))
# These pages have tests of their own: test_coming_from, test_interval_command.
ELSEWHERE = {"coming_from.md", "data.md"}
SLOW = {"average.md", "scale.md", "tradeoffs.md"}


def module(name: str) -> ModuleType:
    """Return a module of the documentation's extensions; those that need Sphinx are not loaded."""
    found = importlib.util.spec_from_file_location(name, DOCS / "extensions" / f"{name}.py")
    assert found
    assert found.loader
    made = importlib.util.module_from_spec(found)
    found.loader.exec_module(made)
    return made


# ---- pages -------------------------------------------------------------------------------------


def blocks(page: Path, kind: str) -> list[str]:
    """Return the blocks of one language on a page."""
    return re.findall(rf"^```{kind}\n(.*?)^```$", page.read_text("utf-8"), re.M | re.S)


def pages() -> Iterator[object]:
    for page in sorted(DOCS.rglob("*.md")):
        if blocks(page, "python") and page.name not in ELSEWHERE:
            marks = [pytest.mark.slow] if page.name in SLOW else []
            yield pytest.param(page, id=page.stem, marks=marks)


@pytest.fixture
def empty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty folder to work in, and figures that nobody sees."""
    monkeypatch.chdir(tmp_path)
    with mpl.rc_context({"backend": "Agg"}):
        yield tmp_path
    plt.close("all")


def test_pages_import_public_names() -> None:
    """All but the one that says how to add to the toolkit."""
    for page in {*DOCS.rglob("*.md"), DOCS.parent / "README.md"} - {DOCS / "how-to" / "adding.md"}:
        assert not re.search(r"^(from|import) exact_mdp\.\w", page.read_text("utf-8"), re.M), page


@pytest.mark.parametrize("page", list(pages()))
def test_python_of_a_page_runs(page: Path, empty: Path) -> None:
    """The blocks of a page run in their order, as a reader types them."""
    names: dict[str, object] = {}
    for block in blocks(page, "python"):
        exec(compile(block, str(page), "exec", dont_inherit=True), names)


def test_the_certificate_shown_is_the_one_made(empty: Path) -> None:
    """What the page checks by hand: the file, to the letter, and that its claims hold."""
    page, names = DOCS / "reference" / "certificates.md", {}
    (block,), (shown,) = blocks(page, "python"), blocks(page, "json")
    exec(compile(block, str(page), "exec", dont_inherit=True), names)
    model = names["model"]
    assert isinstance(model, MDP)
    assert (empty / "proof.json").read_text("utf-8") == shown
    h = json.loads(shown)["h"]
    value = [
        int(top, 16) / int(h["below"][g], 16) for top, g in zip(h["top"], h["group"], strict=True)
    ]
    wait, stop = 1 + (value[0] / 2 + value[1] / 2) / 2, 1 + value[1] / 2
    assert (value[0], value[1]) == (pytest.approx(wait), 0)
    assert stop < value[0]


def test_every_page_is_in_an_index() -> None:
    listed = {
        (index.parent / f"{name}.md").resolve()
        for index in DOCS.rglob("*.md")
        for tree in re.findall(r"```\{toctree\}\n(.*?)```", index.read_text("utf-8"), re.S)
        for name in re.findall(r"^([\w./-]+)$", tree, re.M)
    }
    assert set(DOCS.rglob("*.md")) - listed == {DOCS / "index.md"}


def test_the_tutorials_are_the_notebooks() -> None:
    link = DOCS / "tutorials" / "notebooks"
    # In a checkout without links it is a file with the path in it.
    led = link if link.is_symlink() else link.parent / link.read_text("utf-8").strip()
    assert led.resolve() == ROOT / "notebooks"


# ---- JSON keys ---------------------------------------------------------------------------------


@pytest.mark.parametrize("part", ["quick", pytest.param("long", marks=pytest.mark.slow)])
def test_every_key_has_a_meaning_and_every_meaning_a_key(part: str) -> None:
    """`long` runs every line, and so knows that no meaning is left over."""
    of = module("answers")
    lines, meanings = of.declared()
    long = {"psa", "sobol", "train", "perception", "check --confidence"}
    taken = {
        command: line for command, line in lines.items() if part == "long" or command not in long
    }
    unknown, used = set(), set()
    for command, answer in of.answers(taken):
        for key in answer:
            own = f"{command}: {key}"
            unknown |= {own} if of.meaning(command, key, meanings) is None else set()
            used.add(own if own in meanings else key)
    assert unknown == set()
    if part == "long":
        assert set(meanings) - used == set()


def test_every_command_has_a_line() -> None:
    listed = run("--help").out.partition("Check:")[2]
    names = set(re.findall(r"^  ([a-z][\w-]*)  ", listed, re.M))
    lines = tomllib.loads((DOCS / "reference" / "json.toml").read_text("utf-8"))["lines"].values()
    assert names
    assert names - {line.split()[0] for line in lines} == set()


# ---- the gallery -------------------------------------------------------------------------------


def test_every_figure_is_in_the_gallery() -> None:
    """A script is called as the function that draws its figure."""
    functions = {
        node.name.removeprefix("plot_").removeprefix("draw_")
        for path in (ROOT / "exact_mdp" / "analysis" / "plots").glob("*.py")
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.FunctionDef) and node.name.startswith(("plot_", "draw_"))
    }
    assert len(functions) > 30
    assert functions - {script.stem for script in SCRIPTS} == set()


def test_a_script_is_short_and_its_group_is_shown() -> None:
    shown = re.findall(r"```\{gallery\} (\w+)", (DOCS / "gallery" / "index.md").read_text("utf-8"))
    assert {script.parent.name for script in SCRIPTS} == set(shown)
    for script in SCRIPTS:
        text = script.read_text("utf-8")
        lines = [line for line in text.partition('"""\n\n')[2].splitlines() if line.strip()]
        assert 2 <= len(lines) <= 14, script


@pytest.mark.slow
@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.stem)
def test_a_script_draws_one_figure(script: Path, empty: Path) -> None:
    exec(compile(script.read_text("utf-8"), str(script), "exec"), {})
    (number,) = plt.get_fignums()
    axes = plt.figure(number).axes
    assert any(ax.has_data() or ax.texts for ax in axes)


# ---- the built pages -----------------------------------------------------------------------------

BUILT = ROOT / "build" / "docs" / "html"
LOOKED_AT = ("index", "gallery/index", "reference/json", "reference/commands", "explanation/claims")


@pytest.mark.slow
@pytest.mark.skipif(not (BUILT / "index.html").exists(), reason="`make docs` builds the pages")
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium")
def test_pages_fit_a_screen_and_a_phone_and_are_searched_without_a_server(tmp_path: Path) -> None:
    with Browser(tmp_path) as browser:
        for wide in (1200, 390):
            for name in LOOKED_AT:
                browser.open(BUILT / f"{name}.html", wide=wide)
                assert browser.js("document.documentElement.scrollWidth") <= wide, (name, wide)
                assert [
                    url for url in browser.asked if not url.startswith(("file:", "data:"))
                ] == []
        browser.open(BUILT / "search.html", wide=1200)
        browser.js("Search.performSearch('certificate')")
        found = "document.querySelectorAll('#search-results li a').length"
        while browser.js(found) <= 5:
            time.sleep(0.2)
        assert browser.errors == []
