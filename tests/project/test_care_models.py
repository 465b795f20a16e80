"""The page that compares the care models shows what its script makes."""

from __future__ import annotations

import pytest
from care_models import PAGE, TABLES, coach, rule, shown, those_who, words_and_done

from exact_mdp import check, solve
from exact_mdp.mdp.coach.numbers import NUMBERS, OURS

SLOW = [pytest.param(name, marks=pytest.mark.slow) for name in TABLES if name != "policies"]


@pytest.mark.parametrize("name", ["policies", *SLOW])
def test_a_table_is_what_the_script_makes(name: str) -> None:
    assert shown(name) == TABLES[name]()


def test_every_number_of_ours_is_varied() -> None:
    page = PAGE.read_text("utf-8")
    assert [
        name for name, n in NUMBERS.items() if n.source == OURS and f"`{name}`" not in page
    ] == []


def test_what_the_page_says_of_the_optimum() -> None:
    optimal = solve(coach()).policy
    prompted: dict[tuple[str, str], set[str]] = {}
    for state in range(coach().n_states):
        at, action = coach().space.as_dict(state), coach().actions[optimal[state]]
        if action != "nothing":
            prompted.setdefault((at["responsive"], at["aware"]), set()).add(at["step"])
            assert at["step"] != "k" or action == "wet_hands"
    assert prompted == {("yes", "no"): set("abcdeghjk"), ("yes", "yes"): set("dghjk")}
    words = check(coach(), rule(those_who("responsive", "not aware"))).regret
    mended = check(coach(), rule(words_and_done)).regret
    assert round(float(words.at_start.value / words.optimal.value), 2) == 0.30
    assert mended.at_start.value < words.at_start.value / 2

    def better(at: dict[str, str]) -> str:
        asked = words_and_done(at)
        return (
            asked
            if asked == "nothing"
            else {"b": "use_soap", "g": "dry_hands"}.get(at["step"], asked)
        )

    chosen = check(coach(), rule(better)).regret
    assert chosen.at_start.value < mended.at_start.value / 2
