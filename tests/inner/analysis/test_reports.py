"""Reports as Markdown, HTML, JUnit and figures: names and messages stay text."""

from __future__ import annotations

import io
from pathlib import Path
from xml.etree import ElementTree

import pytest
from made_models import corridor

from exact_mdp import ModelError, Scenario, check, plots
from exact_mdp.analysis import github
from exact_mdp.analysis.cli.render import markdown
from exact_mdp.analysis.layout import arrange, symbols
from exact_mdp.analysis.pages.audit import audit_page
from exact_mdp.analysis.pages.page import render
from exact_mdp.analysis.plots.style import picture
from exact_mdp.mdp.report import Report, Table


def test_markdown_shows_facts_and_notes() -> None:
    table = Table(title="t", rows=[{"a": 1}], columns={"a": "a"}, note="what a is")
    report = Report(title="*", facts={"x": None, "y_z": 2}, tables={"t": table})
    assert markdown(report).splitlines() == [
        r"## \*", "", "|  |  |", "| --- | --- |", "| y z | 2 |", "", "### t", "", "what a is", "",
        "| a |", "| ---: |", "| 1 |",
    ]  # fmt: skip


def test_unsafe_characters_are_written_as_codes() -> None:
    """Names cannot hold them, but names of files and messages can."""
    page = render("base.html.j2")
    assert "\x1b" not in page
    audit = check(corridor(["a", "b"]), [1, 0])
    report = Report(title="", facts={}, notes=["it stops"])
    shown = audit_page(audit, report, "m\x1b[31m\u202e", "p", rerun="x\ny", first=9)
    assert r"m\x1b[31m\u202e" in shown
    assert "x\ny" in shown
    assert "Note: it stops" in shown


# ---- places ------------------------------------------------------------------------------------


def test_every_state_has_a_place_of_its_own() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[2], max_trial=2).compile()
    for words in ({}, {"across": ["trial"]}, {"down": ["status"], "across": ["trial", "subtask"]}):
        found = arrange(mdp, **words)
        places = set(zip(found.row[found.shown], found.column[found.shown], strict=True))
        assert len(places) == len(found.shown) == mdp.space.regular
        assert len(found.rows) * len(found.columns) == mdp.space.regular
    part = arrange(mdp, subtask=1, trial=0)
    assert (len(part.shown), part.rows, part.columns) == (16, *[("00", "01", "10", "11")] * 2)
    for state in part.shown:
        digits = part.rows[part.row[state]] + part.columns[part.column[state]]
        assert mdp.space.as_dict(state)["status"] == digits
    assert {mdp.space.label(s).split(",")[0] for s in part.shown} == {"subtask 1"}
    for bad in ({"subtask": 5}, {"nothing": 0}, {"shape": (3, 4)}):
        with pytest.raises(ModelError):
            arrange(mdp, **bad)


@pytest.mark.parametrize(
    ("actions", "expected"),
    [
        ("UP down Left right", "↑↓←→"),
        ("north east south west", "↑→↓←"),
        ("u d l r", "↑↓←→"),
        ("s m", "sm"),
        ("stop go", ["stop", "go"]),
        ("repair a0", ["a0", "a1"]),  # where some names are long, "a1" must not be a name too
    ],
)
def test_signs_of_actions(actions: str, expected: str | list[str]) -> None:
    assert symbols(actions.split()) == list(expected)


def test_nothing_is_said_elsewhere(capsys: pytest.CaptureFixture[str]) -> None:
    github.annotate("a", "b")
    github.summarise("c")
    assert capsys.readouterr() == ("", "")
    assert github.inert("::error::x ##[y]") == "::error::x ##[y]"


def test_names_stay_text_in_figures(tmp_path: Path) -> None:
    """Dollar signs, angle brackets and quotes are letters of a name: no formula, no element."""

    @picture
    def plot(ax: object = None) -> object:
        import matplotlib.pyplot as plt

        ax = plt.subplots()[1]
        ax.set_title("from $x^$ to $y$")
        ax.set_xlabel("<script>&\"'")
        ax.bar(range(2), [1, 2], label="$z_$")
        ax.set_xticks(range(2), ["$\\frac$", "</text>"])
        ax.legend()
        return ax

    with plots.style():
        ax = plot()
        plots.save(ax.figure, tmp_path, "names")
    root = ElementTree.parse(tmp_path / "names.svg").getroot()
    texts = {"".join(text.itertext()) for text in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"from $x^$ to $y$", "<script>&\"'", "$\\frac$", "</text>", "$z_$"} <= texts
    assert not list(root.iter("{http://www.w3.org/2000/svg}script"))
    ax.figure.savefig(io.BytesIO(), format="svg")


def test_every_figure_is_drawn_as_written() -> None:
    """A new figure that forgets the rule is found here."""
    import importlib
    import pkgutil

    from exact_mdp import analysis

    for module in pkgutil.iter_modules(analysis.plots.__path__):
        found = importlib.import_module(f"exact_mdp.analysis.plots.{module.name}")
        for name, function in vars(found).items():
            if name.startswith("plot_"):
                assert hasattr(function, "__wrapped__"), f"{module.name}.{name}"
