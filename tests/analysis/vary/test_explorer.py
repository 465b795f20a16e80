"""The explorer's page: its numbers against certificates, in Python and as a browser shows them."""

import itertools
import json
import re
from collections.abc import Iterator
from fractions import Fraction
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browser import CHROMIUM, Browser
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import (
    MDP,
    Family,
    ModelError,
    Parameter,
    Policy,
    Scenario,
    certify,
    check,
    explore,
    parametric,
    save,
)

pytestmark = pytest.mark.filterwarnings("ignore::ResourceWarning")  # pipes of the browser
F = Fraction
TEA = Scenario.load("tea").with_(tasks=[2], max_trial=2)
BOTH = ("base.anxiety", "reward.assist.prompt")
RANGES = {"base.anxiety": (0, "1/2"), "reward.assist.prompt": (-4, 0)}
NASTY = ["</script><b>", "$x & 'y'", '"z" <img src=x>']


def data_of(page: str) -> dict[str, Any]:
    """What the script of a page reads."""
    match = re.search(r'<script type="application/json" id="data">(.*?)</script>', page, re.DOTALL)
    assert match is not None
    data: dict[str, Any] = json.loads(match[1])
    return data


def number(text: str) -> Fraction:
    top, below = text.split("/")
    return F(int(top, 16), int(below, 16))


def ratio_at(ratio: list[list[str]], at: Fraction) -> Fraction:
    top, below = (sum(int(c, 16) * at**k for k, c in enumerate(part)) for part in ratio)
    return F(top) / below


def check_at(data: dict[str, Any], row: int, at: Fraction, mdp: MDP, policy: str) -> None:
    """What the page holds at a value of its parameter, against a proof and linear equations."""
    curve, certificate = data["curves"][row], certify(mdp)
    sets, around = [], []
    for piece in curve["pieces"]:
        sets = list(piece.get("sets", sets))
        for state, to in piece.get("turns", ()):
            sets[state] = to
        low, high = (number(piece[end][k]) for k, end in enumerate(("low", "high")))
        if low <= at <= high:
            around.append((piece, list(sets)))
    assert max(ratio_at(piece["value"], at) for piece, _ in around) == certificate.start_value
    value = check(mdp, policy, exact_values=True).regret.learned.value
    taken = [data["sets"][number] for number in data["taken"]]
    weights = Policy.of(mdp, policy).weights(mdp)
    chosen = [
        [mdp.actions[mdp.pair_action[p]] for p in mdp.pairs_of(s) if weights[p]]
        for s in range(mdp.n_states)
    ]
    assert taken == chosen
    assert ratio_at(curve["fixed"][around[0][0]["fixed"]], at) == value
    if len(around) == 1:
        for state in np.flatnonzero(~mdp.terminal).tolist():
            best = [p for p in mdp.pairs_of(state) if certificate.optimal_pairs[p]]
            shown = data["sets"][around[0][1][state]]
            assert shown == [mdp.actions[mdp.pair_action[p]] for p in best]


@settings(max_examples=15)
@given(k=st.integers(0, 60), row=st.integers(0, 2))
def test_the_page_holds_what_is_true_at_any_value(k: int, row: int) -> None:
    data = data_of(tea().page())
    low, high, grid = number(data["low"]), number(data["high"]), list(map(number, data["grid"]))
    assert (low, high, grid) == (0, F(1, 2), [-4, -2, 0])
    certified = [number(each) for each in data["curves"][row]["certified"]]
    for at in (low + (high - low) * F(k, 60), *certified[:: max(1, len(certified) // 3)]):
        mdp = parametric(TEA).at(dict(zip(BOTH, (at, grid[row]), strict=True)))
        check_at(data, row, at, mdp, "random")


@cache
def tea() -> Any:
    return explore(TEA, *BOTH, ranges=RANGES, policy="random", n=3)


def cliff(names: list[str]) -> MDP:
    rows = [(0, 0, [("1/2", 0, 1), ("1/2", 1, 0)]), (0, 1, [(1, 2, 3)]), (1, 0, [(1, 2, 5)])]
    return MDP.from_outcomes(
        [*rows, (2, 0, [(1, 2, 0)])], discount="1/2", states=names, actions=names[:2], name=names[0]
    )


def test_names_are_text(tmp_path: Path) -> None:
    model, html = tmp_path / "m.npz", tmp_path / "p.html"
    save(cliff(NASTY), model)
    done = run("explore", model, "--parameter", "discount", "--html", html, "--json")
    assert done.result["written"] == str(html)
    page = html.read_text(encoding="utf-8")
    assert page.count("<script") == 2
    assert "✗ and a frame: the action of the policy held fixed is not optimal here." in page
    assert "The optimal policy shown stays optimal from" in page
    assert "<img" not in page
    assert "<b>" not in page
    assert set(data_of(page)["labels"].values()) == {f"state {name}" for name in NASTY}
    assert not re.search(r"https?://(?!www\.w3\.org/2000/svg)", page)


def test_a_kink_and_back_that_no_point_of_the_curve_shows_is_refused() -> None:
    """The chance is p but between 4/5 and 9/10, where today's value is."""

    def build(at: Any) -> MDP:
        q = at["p"] + max(F(0), F(1, 20) - abs(at["p"] - F(17, 20)))
        rows = [(0, 0, [(1 - q, 0, 1), (q, 1, 1)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, "9/10")

    family = Family(parameters=(Parameter(name="p", value="17/20", low=0, high=1),), build=build)
    with pytest.raises(ModelError) as error:
        explore(family, "p", ranges={"p": (0, 1)})
    assert error.value.where == "explorer of p, parameter p = 0.85"
    assert 'breaks={"p": [value, …]}' in error.value.fix


# ---- in a browser ------------------------------------------------------------------------------


LISTED = MDP.from_arrays(
    [[[0, 1, 0], [0, 0, 1], [0, 0, 1]]], [1, 2, 0], "9/10", states=["young", "old", "gone"]
)


def test_the_page_knows_ends_and_names() -> None:
    data = data_of(explore(LISTED, "discount").page())
    assert (data["ends"], data["map"]["listed"], data["labels"]["2"]) == ([2], True, "state gone")
    assert not data_of(tea().page())["map"]["listed"]


@pytest.fixture
def browser(tmp_path: Path) -> Iterator[Browser]:
    if CHROMIUM is None:
        pytest.skip("no Chromium on this machine")
    with Browser(tmp_path / "browser") as browser:
        yield browser
        assert browser.errors == []


@pytest.mark.slow
def test_the_page_in_a_browser(browser: Browser, tmp_path: Path) -> None:
    page = tmp_path / "page.html"
    page.write_text(tea().page(rerun="exact-mdp explore …"), encoding="utf-8")
    for wide, dark in itertools.product((400, 1280), (False, True)):
        browser.open(page, wide=wide, dark=dark)
        assert browser.js("document.documentElement.scrollWidth") <= wide
        ground = browser.js("getComputedStyle(document.body).backgroundColor")
        assert (int(re.findall(r"\d+", ground)[0]) < 60) == dark
        assert browser.asked == [page.as_uri()]
        use_by_keyboard(browser)


def use_by_keyboard(browser: Browser) -> None:
    """Move both parameters without a mouse, and compare what is shown with proofs."""

    def text(name: str) -> str:
        return str(browser.js(f"document.getElementById('{name}').textContent"))

    def focused() -> str:
        return str(browser.js("document.activeElement.id"))

    def holds(second: Fraction) -> None:
        at = F(text("exact_at"))
        mdp = parametric(TEA).at(dict(zip(BOTH, (at, second), strict=True)))
        best = certify(mdp).start_value
        assert F(text("exact_best")) == best
        value = check(mdp, "random", exact_values=True).regret.learned.value
        assert F(text("exact_held")) == value
        assert float(text("best")) == pytest.approx(float(best), rel=1e-9)
        assert float(text("regret")) == pytest.approx(float(best - value), rel=1e-9)

    holds(F(-2))
    browser.press("Tab")
    assert focused() == "first"
    for key, times in (("ArrowRight", 7), ("ArrowLeft", 2), ("End", 1), ("Home", 1)):
        browser.press(key, times)
        holds(F(-2))
    assert F(text("exact_at")) == 0
    browser.press("Tab")
    assert focused() == "typed"
    browser.js("document.activeElement.select()")
    browser.press("1/7")
    holds(F(-2))
    assert F(text("exact_at")) == F(1, 7)
    browser.js("document.activeElement.select()")
    browser.press("3")
    assert "from 0 to 0.5" in text("wrong")


def test_the_page_is_called_what_the_user_named(tmp_path: Path) -> None:
    path = tmp_path / "names.npz"
    LISTED.save(path)
    page = tmp_path / "page.html"
    assert run("explore", path, "--parameter", "discount", "--html", page).status == 0
    assert "<title>names: discount</title>" in page.read_text("utf-8")
