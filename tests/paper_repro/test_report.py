"""The report, the ranking by exact convolution, and the main job from end to end."""

from __future__ import annotations

import base64
import itertools
import json
import re
import tomllib
import warnings
import xml.etree.ElementTree as ET
from dataclasses import replace
from fractions import Fraction
from html import escape
from html.parser import HTMLParser
from math import comb, sqrt
from pathlib import Path

import numpy as np
import pytest
import yaml
from browser import CHROMIUM, Browser
from click.testing import CliRunner, Result
from reading_cases import ENDS, small_search

from exact_mdp.analysis import check
from exact_mdp.mdp import ModelError, Policy
from exact_mdp.paper_repro.__main__ import main
from exact_mdp.paper_repro.claims import Judged, Verdict, all_claims, judge
from exact_mdp.paper_repro.reading import QUICK, Reading, changed, default
from exact_mdp.paper_repro.readings.evidence import evidence
from exact_mdp.paper_repro.readings.reported_policy import ranked, sums
from exact_mdp.paper_repro.readings.search import PAPER_READINGS, of_order
from exact_mdp.paper_repro.readings.wording import changes, options_of, said, title
from exact_mdp.paper_repro.report import agents, readings, tradeoffs
from exact_mdp.paper_repro.report.figures import PICTURES, draw_all
from exact_mdp.paper_repro.report.output import counted, counts, number
from exact_mdp.paper_repro.report.report import (
    WORDS,
    Part,
    anchor,
    bottom_line,
    perfect,
    plain,
    render,
    summary,
)
from exact_mdp.paper_repro.report.tables import all_tables
from exact_mdp.paper_repro.reported import ANGRY, FIGURES, FINAL, ORDERS, PAPER, PLACES, STATED
from exact_mdp.paper_repro.run import _done
from exact_mdp.solvers.values.returns import ReturnDistribution, return_distribution

DRAWN = ("three_policies", "trial_flow")  # the figures that are drawn here: the quickest ones
RECORD = {
    "seconds": 1.5, "quick": True, "reused": "from nothing", "seed": 7, "model": "yuan2025",
    "model_hash": "0", "training_runs": 2, "episodes": 3, "versions": {"python": "3"},
    "platform": "linux", "commit": None, "date": "today",
}  # fmt: skip


# ---- the report --------------------------------------------------------------------------------


class Page(HTMLParser):
    """What a page names: ids, links, sources, pictures without a description."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.ids: list[str] = []
        self.links: list[str] = []
        self.sources: list[str] = []
        self.silent: list[str] = []
        self.tags: set[str] = set()
        self.open: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.add(tag)
        if tag not in ("img", "meta", "br"):
            self.open.append(tag)
        self.ids += [found["id"]] if found.get("id") else []
        self.links += [found["href"]] if found.get("href") else []
        self.sources += [v for k, v in attrs if k in ("src", "srcset", "data", "poster") and v]
        if tag == "img" and not found.get("alt"):
            self.silent.append(found.get("src") or "")

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag


@pytest.fixture(scope="module")
def view() -> Reading:
    return replace(default(replace(QUICK, episodes=1000)), ends=ENDS)


@pytest.fixture(scope="module")
def judged(view: Reading) -> list[Judged]:
    return judge([c for c in all_claims() if not c.id.startswith("learning.")], view)


@pytest.fixture(scope="module")
def written(
    view: Reading, judged: list[Judged], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, str, str]:
    out = tmp_path_factory.mktemp("report")
    chosen = [picture for picture in PICTURES if picture.name in DRAWN]
    draw_all({p.name: (lambda p=p: p.draw(view)) for p in chosen}, out / "figures")
    tables = all_tables(view)
    part = Part(title="A part <b>", sentences=("a < b | c",), figures=())
    markdown, page = render(
        out, judged=judged, reading=view, tables=tables, figures=chosen, parts=[part],
        record=RECORD, pinned=["x: 1, pinned 2"], main=evidence(small_search()),
    )  # fmt: skip
    return out, markdown, page


def test_the_page_needs_nothing_else(written: tuple[Path, str, str]) -> None:
    page = Page(written[2])
    assert page.open == []
    assert "default-src 'none'" in written[2]
    assert "@import" not in written[2]
    assert "url(" not in written[2]
    assert not page.tags & {"link", "object", "embed"}
    assert page.sources
    assert all(source.startswith("data:image/svg+xml;base64,") for source in page.sources)


def test_the_page_leads_somewhere_and_describes_its_pictures(
    written: tuple[Path, str, str],
) -> None:
    page = Page(written[2])
    assert page.silent == []
    assert len(page.ids) == len(set(page.ids))
    inside = [link for link in page.links if link != PAPER["link"]]
    assert all(link.startswith("#") for link in inside)
    assert {link[1:] for link in inside} <= set(page.ids)


def test_claims_fold_and_say_their_verdict(
    written: tuple[Path, str, str], judged: list[Judged]
) -> None:
    page = written[2]
    told = re.findall(r'<details class="claim" id="([^"]+)" data-verdict="([^"]+)"', page)
    told += re.findall(r'<tr id="([^"]+)" data-verdict="([^"]+)"', page)
    assert dict(told) == {anchor(e.claim.id): str(e.verdict) for e in judged}
    assert len(told) == len(judged)
    assert re.findall(r'data-show="([^"]*)"', page) == ["", *map(str, Verdict)]
    assert "<details open" not in page
    body = page.partition('id="inputs"')[2].partition("</section>")[0]
    assert body.count("<details") == body.count("<table") > 5  # inputs are folded


def test_every_table_scrolls_within_itself(written: tuple[Path, str, str]) -> None:
    tables = written[2].split("<table>")[:-1]
    assert len(tables) > 10
    for before in tables:
        assert before.rstrip().endswith(">")
        assert 'class="scroll" tabindex="0" role="region"' in before.rstrip().splitlines()[-1]


def test_headings_are_words(written: tuple[Path, str, str]) -> None:
    shown = [*PICTURES, *readings.PICTURES, *tradeoffs.PICTURES, *agents.PICTURES]
    slugs = {p.name.removeprefix("agents_").replace("_", " ").capitalize() for p in shown}
    assert not slugs & {picture.title for picture in shown}
    heads = re.findall(r"<(?:h\d|summary)>([^<]+)", written[2])
    assert len(heads) > 15
    for text in (*heads, *(picture.title for picture in shown)):
        assert "_" not in text
        assert text[0].isupper() or text.startswith("python")


def test_every_reading_has_words() -> None:
    for name, options in PAPER_READINGS.options.items():
        assert title(name)[0].isupper()
        assert len({said(name, option) for option in options}) == len(options)
    number = PAPER_READINGS.number(skip_onset="base", tasks=(6,))
    told = "a skip may bring on statuses, one task of 6 subtasks"
    assert changes(PAPER_READINGS, number) == told
    for name, words in options_of(default(QUICK).scenario).items():
        assert "_" not in name + words


def test_no_number_is_a_negative_nothing(written: tuple[Path, str, str]) -> None:
    assert number(-0.0) == "0"
    for text in written[1:]:
        own = re.sub(r'srcdoc="[^"]*"|base64,[^"]*', "", text)
        assert re.findall(r"(?<=[\s>(])[-−]0(?:\.0+)?(?![\w./…])", own) == []


def test_one_page_for_those_who_read_no_more(view: Reading, judged: list[Judged]) -> None:
    page = summary(judged, view, evidence(small_search()), RECORD)
    parsed = Page(page)
    assert parsed.open == []
    assert "size: A4" in page
    assert "details" not in parsed.tags
    for each in plain(judged, view, small_search()):
        assert escape(each.text, quote=False).replace("'", "&#39;") in page
    assert 300 < len(plain_words(page)) < 800


def plain_words(page: str) -> list[str]:
    """Return the words of a page, without the date of its run."""
    main = page.partition("<main>")[2].partition("The whole report")[0]
    return re.sub(r"<[^>]+>", " ", main).split()


@pytest.mark.slow
@pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine")
def test_the_pages_in_a_browser(
    written: tuple[Path, str, str], view: Reading, judged: list[Judged], tmp_path: Path
) -> None:
    report, one = tmp_path / "report.html", tmp_path / "summary.html"
    report.write_text(written[2], encoding="utf-8")
    one.write_text(summary(judged, view, evidence(small_search()), RECORD), encoding="utf-8")
    with warnings.catch_warnings(), Browser(tmp_path / "browser") as browser:
        warnings.simplefilter("ignore", ResourceWarning)
        for wide, dark in ((320, False), (400, True), (1280, False), (1280, True)):
            browser.open(report, wide=wide, dark=dark)
            assert browser.js("document.documentElement.scrollWidth") <= wide
            assert browser.js("document.documentElement.scrollHeight") < 12 * 800 or wide < 1280
            top = "document.querySelector('{}').getBoundingClientRect().top"
            assert wide > 400 or browser.js(top.format("h1")) < browser.js(top.format("nav"))
            ground = browser.js("getComputedStyle(document.body).backgroundColor")
            assert (int(re.findall(r"\d+", ground)[0]) < 60) == dark
            use(browser, judged)
            browser.js("document.querySelectorAll('details').forEach((d) => { d.open = true })")
            assert browser.js("document.documentElement.scrollWidth") <= wide
            browser.open(one, wide=wide, dark=dark)
            assert browser.js("document.documentElement.scrollWidth") <= wide
        pdf = browser.send("Page.printToPDF", preferCSSPageSize=True)["data"]
        assert len(re.findall(rb"/Type /Page\b", base64.b64decode(pdf))) == 1
        assert browser.errors == []


def use(browser: Browser, judged: list[Judged]) -> None:
    """Filter the claims, open a figure at full size, follow a link to a folded claim."""
    seen = "[...document.querySelectorAll('[data-verdict]')].filter((e) => !e.hidden).length"
    for verdict in (*Verdict, ""):
        browser.js(f"document.querySelector('[data-show=\"{verdict}\"]').click()")
        assert browser.js(seen) == sum(verdict in ("", e.verdict) for e in judged)
    browser.js("document.querySelector('figure button').click()")
    assert browser.js("document.querySelector('dialog').open")
    natural = "document.querySelector('dialog img').naturalWidth"
    assert browser.js("document.querySelector('dialog img').clientWidth") >= browser.js(natural)
    browser.js("document.querySelector('dialog button').click()")
    assert not browser.js("document.querySelector('dialog').open")
    browser.js("location.hash = '#policy-0100'; reveal()")
    assert browser.js("document.getElementById('policy-0100').open")
    assert browser.js(
        "document.querySelector('iframe').contentDocument.querySelector('#best').textContent"
    )


def test_every_claim_is_in_both_reports_with_how_to_rerun_it(
    written: tuple[Path, str, str], judged: list[Judged]
) -> None:
    _, markdown, page = written
    for each in judged:
        assert f"--claim {each.claim.id}" in markdown, each.claim.id
        assert f"--claim {each.claim.id}" in page, each.claim.id
    assert "x: 1, pinned 2" in markdown
    assert "A part &lt;b&gt;" in page
    assert "a &lt; b | c" in page


def test_every_figure_that_the_report_names_is_there(written: tuple[Path, str, str]) -> None:
    out, markdown, _ = written
    named = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", markdown)
    assert len(named) == len(DRAWN)
    for name in named:
        assert (out / name).read_bytes()[:4] == b"\x89PNG"
        ET.parse((out / name).with_suffix(".svg"))


def test_tables_of_markdown_have_as_many_cells_as_headings(written: tuple[Path, str, str]) -> None:
    wide = None
    for line in written[1].splitlines():
        if not line.startswith("|"):
            wide = None
            continue
        cells = len(re.findall(r"(?<!\\)\|", line))
        wide = cells if wide is None else wide
        assert cells == wide, line


def test_tables_1_to_4_are_the_models(view: Reading) -> None:
    tables = {table.place: table for table in all_tables(view)}
    assert list(tables) == ["Table 1", "Table 2", "Table 3", "Table 4"]
    assert tables["Table 3"].rows[3] == ("disengagement", "20 %", "+7 %", "+10 %", "+20 %", "99 %")
    assert tables["Table 2"].rows[2][2] == "forgetfulness 40%, confusion 60%"
    assert ("subtask-complete", "50") in tables["Table 4"].rows
    for table in tables.values():
        assert {len(row) for row in table.rows} == {len(table.headings)}


def test_the_summary_turns_with_the_verdicts(view: Reading, judged: list[Judged]) -> None:
    found = {each.claim: each.text for each in plain(judged, view, small_search())}
    assert "costs 4.2 of 146.2" in found["policy.0100"]
    turned = [
        replace(each, finding=replace(each.finding, verdict=Verdict.REPRODUCED)) for each in judged
    ]
    # Both ends by one rule: each order with the open statuses filled in as well as can be.
    worth = view.averages.mean[:, 0]
    ends = [view.evaluations["optimal"].mean - worth[of_order(order)].max() for order in ORDERS]
    assert [f"{end:.1f}" for end in ends] == ["4.2", "1.8"]
    assert "1.8 to 4.2 points below the best possible 146.2" in found["policy.final-is-optimal"]
    assert "a chance of 1 %, and “agree” means 0.27 % or more" in found["return.together"]
    kindest = small_search().regret.min()
    told = f"under the kindest of all 96 readings of the model {kindest:.1f} points are missing."
    assert found["policy.final-is-optimal"].endswith(told)
    assert {each.verdict for each in plain(turned, view, small_search())} == {Verdict.REPRODUCED}
    assert (
        "as the paper says"
        in {e.claim: e.text for e in plain(turned, view, small_search())}["policy.0100"]
    )


def test_the_bottom_line_counts_the_statuses_where_the_advice_is_best(view: Reading) -> None:
    main = evidence(small_search())
    told = bottom_line(view, main)
    advice = {**dict.fromkeys(ANGRY, "supportive"), **STATED, "0000": FINAL}
    tried = [
        check(
            view.mdp,
            Policy.from_choices(
                view.mdp,
                np.where(
                    (view.mdp.space.values("status") == int(status, 2))
                    & ~view.mdp.forced
                    & ~view.mdp.terminal,
                    view.mdp.action(action),
                    view.optimum,
                ),
            ),
        ).passed
        for status, action in advice.items()
    ]
    assert f"to do in {len(tried)} of 16 statuses" in told
    assert f"in {sum(tried)} of these the advice is the best there is" in told
    assert "confused and nothing else, a hint is not" in told
    assert "a loss of 2.8%" in told
    assert "swapped 11 are the best; where the person is forgetful and nothing else" in told
    assert "earns 144.5, a loss of 1.2%" in told
    place = 1 + sum(main.marginal > main.marginal[0])
    assert "one of 96 ways to read the text" in told
    assert f"number {place}, with {100 * main.weights[0]:.2g} % of the weight" in told


def test_no_run_earns_more_than_a_perfect_one(view: Reading) -> None:
    law = return_distribution(view.mdp, "always:none")
    assert perfect(view) == max(law.values) == 164


def test_what_is_outside_names_its_places() -> None:
    for each in WORDS["outside"]:
        assert set(each["place"].split(", ")) <= set(PLACES), each
        assert each["says"].endswith(".")
        assert each["why"].endswith(".")


def test_the_paper_is_named_in_the_citation_as_in_the_report() -> None:
    root = Path(__file__).parents[2]
    cited = yaml.safe_load((root / "CITATION.cff").read_text("utf-8"))
    paper = cited["preferred-citation"]
    names = [f"{a['given-names']} {a['family-names']}" for a in paper["authors"]]
    assert (paper["title"], names, paper["url"]) == (
        PAPER["title"],
        PAPER["authors"],
        PAPER["link"],
    )
    assert paper["identifiers"][0]["value"] == PAPER["identifier"]
    assert str(paper["year"]) in PAPER["date"]
    project = tomllib.loads((root / "pyproject.toml").read_text("utf-8"))["project"]
    assert (cited["version"], cited["license"]) == (project["version"], project["license"])
    assert PAPER["link"] in (root / "README.md").read_text("utf-8")


def test_each_figure_says_where_it_is_drawn() -> None:
    root = Path(__file__).parents[2]
    for picture in PICTURES:
        module, _, function = picture.script.partition(", ")
        assert f"def {function}(" in (root / module).read_text("utf-8")


def test_figures_answer_to_figures_of_the_paper_and_say_what_they_show() -> None:
    assert len({picture.name for picture in PICTURES}) == len(PICTURES)
    for picture in PICTURES:
        assert picture.place in ("", *FIGURES)
        assert picture.alt
        assert picture.caption
    answered = {picture.place for picture in PICTURES}
    assert answered >= {"Figure 3", "Figure 4", "Figure 9", "Figure 10"}


def test_numbers_are_short() -> None:
    assert number(1e-15) == "1e−15"
    assert number(0.05, unit="%") == "5 %"
    assert number(-10.0) == "−10"


# ---- ranking by convolution --------------------------------------------------------------------


def coin(heads: float, values: tuple[int, int] = (0, 1)) -> ReturnDistribution:
    return ReturnDistribution(
        multiples=np.array(values), unit=Fraction(1), probabilities=np.array([1 - heads, heads]),
        relative_error=0.0, remaining=0.0,
    )  # fmt: skip


def test_sums_of_coins_are_binomial() -> None:
    found = sums(coin(0.3), 20)
    exact = [comb(20, k) * 0.3**k * 0.7 ** (20 - k) for k in range(21)]
    assert np.abs(found.probability - exact).sum() <= found.error < 1e-9


def test_ranking_against_every_outcome() -> None:
    laws = [coin(0.6, (0, 3)), coin(0.5, (1, 2)), coin(0.2, (-1, 2))]
    ways = list(itertools.product((0, 1), repeat=3))
    exact = 0.0
    for a, b, c in itertools.product(ways, repeat=3):
        totals, chance = [], 1.0
        for law, outcome in zip(laws, (a, b, c), strict=True):
            totals.append(sum(int(law.multiples[i]) for i in outcome))
            chance *= float(np.prod([law.probabilities[i] for i in outcome]))
        exact += chance * (totals[0] > totals[1] > totals[2])
    found = ranked(*(sums(law, 3) for law in laws))
    assert abs(found.value - exact) <= found.error


def test_ranking_of_the_reported_policies_is_near_the_normal_one(view: Reading) -> None:
    from scipy.integrate import quad
    from scipy.stats import norm

    names = ("non-directive", "directive", "supportive")
    laws = [return_distribution(view.mdp, view.policies[f"reported.{n}"]) for n in names]
    found = ranked(*(sums(law, 1000) for law in laws))
    (a, b, c) = ((law.mean, law.sd / sqrt(1000)) for law in laws)
    low, high = b[0] - 8 * b[1], b[0] + 8 * b[1]
    normal, _ = quad(lambda x: norm.pdf(x, *b) * norm.sf(x, *a) * norm.cdf(x, *c), low, high)
    assert found.value == pytest.approx(normal, abs=1e-5)
    assert found.error < 1e-6


def test_sums_too_many_are_refused() -> None:
    with pytest.raises(ModelError, match="possible sums"):
        sums(coin(0.5, (0, 10**6)), 1000)


# ---- the main job ------------------------------------------------------------------------------


def job(*words: object) -> Result:
    return CliRunner().invoke(main, [str(word) for word in words])


def test_one_claim_alone(tmp_path: Path) -> None:
    done = job("--quick", "--claim", "table3.base.anger", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    for part in ("Table 3", "paper:", "5 %", "certified", "reproduced"):
        assert part in done.output


def test_the_verdicts_that_another_reading_changes(tmp_path: Path) -> None:
    done = job(
        "--quick", "--set", "readings.influence_orientation=column-to-row", "--out", tmp_path
    )
    assert done.exit_code == 0, done.output
    name = "prose.anger-contributes-most "
    (line,) = (x for x in done.stdout.splitlines() if x.startswith(name))
    # As the page has it: another reading bears the claim out.
    assert line.split()[1:6] == ["depends", "on", "the", "reading", "reproduced"]
    assert "verdicts change under readings.influence_orientation=column-to-row" in done.output
    assert "prose.anger-contributes-most …" in done.stderr  # progress


def test_a_setting_of_the_learner_is_held_against_the_text(tmp_path: Path) -> None:
    done = job("--quick", "--set", "training.rate=0.001", "--out", tmp_path)
    assert done.exit_code == 0, done.output
    assert "so no claim about training is compared" in done.stdout.splitlines()[1]
    (line,) = (x for x in done.stdout.splitlines() if x.startswith("training.rate "))
    assert line.split()[1:4] == ["reproduced", "not", "reproduced"]


def test_settings_of_the_learner_are_changed_by_name() -> None:
    found = changed(default(replace(QUICK, runs=2)), ["training.epochs=20", "training.rate=1/4"])
    assert {len(run.snapshots) for run in found.learned("constant").runs} == {20}


@pytest.mark.parametrize(
    "words, message",
    [
        (("--set", "training.rat=1"), "unknown setting 'rat'"),
        (("--set", "training.epochs=many"), "'many' is no value of epochs"),
        (("--set", "base.angre=1"), "base.anger"),
        (("--set", "tasks=[2]", "--claim", "return.random"), "leave --claim out"),
        (("--quick", "--out", "file/results"), "cannot make the folder"),
        (("--claim", "table3.base.angre"), "table3.base.anger"),
        (("--claim", ""), "the name of the claim is empty"),
        (("--claim", "return.random", "--candidates"), "leave one of the two out"),
        (("--summary", "--candidates"), "leave --claim, --set and --candidates out"),
    ],
)
def test_what_cannot_be_done_is_bad_input(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, words: tuple[str, ...], message: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("in the way")
    done = job(*words)
    assert done.exit_code == 2
    assert message in done.output
    assert [path.name for path in tmp_path.iterdir()] == ["file"]


def test_inputs_are_counted_apart_from_findings(judged: list[Judged]) -> None:
    inputs, findings = counts(judged, "input"), counts(judged, "finding")
    assert sum(inputs.values()) + sum(findings.values()) == len(judged)
    assert counted(judged).startswith(f"{sum(inputs.values())} inputs")
    assert f"Of {sum(findings.values())} findings {findings['reproduced']} are" in counted(judged)


def screens(page: Path, folder: Path) -> float:
    """Return how many screens of 1,280 by 800 a page is long."""
    with warnings.catch_warnings(), Browser(folder / "browser") as browser:
        warnings.simplefilter("ignore", ResourceWarning)
        browser.open(page, wide=1280)
        return float(browser.js("document.documentElement.scrollHeight")) / 800


@pytest.mark.slow
def test_the_main_job_writes_everything_it_names(tmp_path: Path) -> None:
    out = tmp_path / "results"
    done = job("--quick", "--out", out)
    assert done.exit_code == 0, done.output
    assert "paper / exact / difference" in done.output
    assert str(out / "figures") in done.output.replace("\n", "")
    rows = json.loads((out / "numbers.json").read_text())
    for row in rows:
        assert {"name", "source", "paper", "exact", "difference", "claim"} <= set(row)
        assert row["claim"] in ("certified", "bounded", "estimated")
        if "simulated" in row:
            assert abs(row["simulated"] - row["exact"]) < 5 * row["simulated_standard_error"]
    assert len(json.loads((out / "claims.json").read_text())) == len(all_claims())
    assert json.loads((out / "run.json").read_text())["quick"] is True
    markdown = (out / "report.md").read_text()
    named = re.findall(r"!\[[^\]]+\]\(([^)]+)\)", markdown)
    assert len(named) > len(PICTURES)
    for name in named:
        assert (out / name).read_bytes()[:4] == b"\x89PNG"
        ET.parse((out / name).with_suffix(".svg"))
    page = Page((out / "report.html").read_text())
    assert all(source.startswith("data:") for source in page.sources)
    assert {link[1:] for link in page.links} <= set(page.ids)
    assert "Every published number agrees with the pinned ones." in markdown
    one = (out / "summary.html").read_text()
    assert job("--quick", "--summary", "--out", out).exit_code == 0
    assert plain_words((out / "summary.html").read_text()) == plain_words(one)
    if CHROMIUM is not None:
        assert screens(out / "report.html", tmp_path) <= 12
    again = job("--quick", "--out", out)
    assert again.exit_code == 0
    assert json.loads((out / "numbers.json").read_text()) == rows
    assert "earlier run" in json.loads((out / "run.json").read_text())["reused"]


def test_other_processes_tell_a_warning_in_one_line_and_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("always")
        for _ in range(2):
            _done(lambda: warnings.warn("a chance is cut off", stacklevel=1))
    assert capsys.readouterr().err == "warning: a chance is cut off\n"
