"""What `check` shows besides its text: Markdown, a page, GitHub's annotations and summary."""

import json
import re
import shlex
from fractions import Fraction as F
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from cli_runner import Done, launch, run
from made_models import corridor

from exact_mdp import MDP, check, save

NASTY = [
    "<script>alert(1)</script>", "$x^$", "::error::x", "##[add-mask]x", "a | b", "`|` *b* _c_",
    "\"q\" 'r'", "&amp; {{ 7*7 }} {% if %}", "</title><img src=x onerror=alert(1)>",
]  # fmt: skip


class Seen(HTMLParser):
    """The elements and the text of a page."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.tags, self.texts = list[tuple[str, dict[str, str | None]]](), list[str]()
        self.feed(page)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append((tag, dict(attrs)))

    def handle_data(self, data: str) -> None:
        self.texts.append(data)


@pytest.fixture
def nasty(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    start = dict.fromkeys(range(len(NASTY)), F(1, len(NASTY)))
    save(corridor(NASTY).with_(start=start), tmp_path / "m.npz")
    np.save(tmp_path / "lazy.npy", np.ones(len(NASTY), dtype=int) * ([1] * 8 + [0]))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def checked(*words: str) -> Done:
    done = run("check", "m.npz", "lazy.npy", *words)
    assert done.status == 1, done.err
    return done


def test_a_page_holds_verdict_table_picture_and_how_to_rerun(nasty: Path) -> None:
    checked("--html", "p.html")
    page = (nasty / "p.html").read_text("utf-8")
    seen, content = Seen(page), json.loads(checked("--json").out)
    assert [tag for tag, _ in seen.tags].count("script") == 1
    assert not [a for _, a in seen.tags if {"src", "href", "onerror"} & set(a)]
    assert "default-src 'none'" in page
    for name in NASTY[:-1]:
        assert f"state {name}" in seen.texts  # a cell that holds the name and nothing else
    assert (
        f"✗ failed: the regret is not zero: it is {content['regret']:.10g} (certified)"
        in seen.texts
    )
    rerun = shlex.split(next(text for text in seen.texts if text.startswith("exact-mdp")))
    assert rerun == ["exact-mdp", "check", "m.npz", "lazy.npy", "--html", "p.html"]
    cells = [a for tag, a in seen.tags if tag == "td" and a.get("class") in ("wrong", "idle", "")]
    assert len(cells) == len(NASTY)
    wrong = [a["title"] for a in cells if a["class"] == "wrong"]
    assert len(wrong) == len(content["disagreements"]) == len(NASTY) - 1
    assert sum(each["share"] for each in content["disagreements"]) == pytest.approx(1)
    text = checked().out
    assert re.search(r"state +yours +optimal +value lost +visits +share", text)
    assert "yours: the policy's action" in text
    for each in content["disagreements"]:
        said = f"{each['state']}: yours {each['learned']}, optimal {each['optimal']}; "
        assert [title for title in wrong if str(title).startswith(said)]


def test_a_policy_that_never_ends_is_shown_with_its_infinite_loss(tmp_path: Path) -> None:
    stays = MDP.from_outcomes(
        [(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, -3)]), (1, 0, [(1, 1, 0)])], discount=1
    )
    save(stays, tmp_path / "m.npz")
    (tmp_path / "p.csv").write_text("state,action\n0,0\n1,0\n")
    done = run(
        "check", tmp_path / "m.npz", tmp_path / "p.csv", "--html", tmp_path / "p.html", "--json"
    )
    (wrong,) = done.result["disagreements"]
    assert (done.status, wrong["cost"], wrong["share"]) == (1, "inf", None)
    assert "loses inf" in (tmp_path / "p.html").read_text("utf-8")
    check(stays, [0, 0]).plot().figure.canvas.draw()


def test_markdown_shows_names_as_they_are(nasty: Path) -> None:
    out = checked("--markdown").out
    rows = [line for line in out.splitlines() if line.startswith("| state")]
    assert len(rows) == len(NASTY)  # the headings, and a row for each wrong state
    for row, name in zip(rows[1:], NASTY[:-1], strict=True):
        assert len(re.split(r"(?<!\\)\|", row)) == 8  # six cells
        first = re.split(r"(?<!\\)\|", row)[1].strip()
        assert re.sub(r"\\(.)", r"\1", first) == f"state {name}"
        assert not re.search(r"(?<!\\)[<>`*_$&\[]", first)
    assert run("check", "m.npz", "lazy.npy", "--markdown", "--json").status == 2


def test_a_page_that_cannot_be_written_is_refused_before_any_work(nasty: Path) -> None:
    for name in ("p.txt", "nowhere/p.html"):
        run("check", "m.npz", "lazy.npy", "--html", name).refusal()
    assert not (nasty / "p.txt").exists()


# ---- GitHub Actions ----------------------------------------------------------------------------


def on_github(monkeypatch: pytest.MonkeyPatch, summary: Path) -> None:
    monkeypatch.setenv("GITHUB_ACTIONS", "true")
    monkeypatch.setenv("GITHUB_STEP_SUMMARY", str(summary))


def commands(text: str) -> list[str]:
    """Return what a runner takes for commands, as its source reads lines."""
    lines = text.splitlines()
    return [line for line in lines if line.lstrip().startswith("::") or "##[" in line]


def test_a_failed_check_is_annotated_and_summed_up(
    nasty: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_github(monkeypatch, nasty / "summary.md")
    done = checked()
    assert commands(done.out) == []
    (annotation,) = commands(done.err)
    assert annotation.startswith("::error title=lazy.npy in m%3A failed::read as a policy")
    assert "%0Afailed: the regret is not zero" in annotation
    assert "%0A" in annotation
    summary = (nasty / "summary.md").read_text("utf-8")
    assert summary.startswith("## lazy.npy in m: failed\n")
    assert "| state | yours | optimal |" in summary
    assert commands(checked("--json").out) == []
    assert json.loads(checked("--json").out)["disagreements"][3]["state"] == f"state {NASTY[3]}"
    assert (run("check", "m.npz", "optimal").status, run("check", "m.npz", "optimal").err) == (
        0,
        "",
    )
    assert "optimal in m: passed" in (nasty / "summary.md").read_text("utf-8")


def test_bad_input_is_annotated_and_summed_up(tmp_path: Path) -> None:
    summary, report = tmp_path / "s.md", tmp_path / "r.xml"
    words = ("check", "tea", "no``where.csv", "--junit", report)
    done = launch(*words, GITHUB_ACTIONS="true", GITHUB_STEP_SUMMARY=str(summary))
    assert done.status == 2
    (annotation,) = commands(done.err)
    assert annotation.startswith("::error title=exact-mdp check::ModelError")
    assert "no verdict" in summary.read_text("utf-8")
    assert "<error " in report.read_text("utf-8")


def test_a_summary_that_cannot_be_written_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    on_github(monkeypatch, tmp_path / "no" / "s.md")
    done = run("check", "tea", "optimal", "--html", tmp_path / "page.html")
    assert (done.status, done.out) == (2, "")
    assert "GITHUB_STEP_SUMMARY" in done.err
    assert not [*tmp_path.iterdir()]
