"""The first table of the page, against the independent model."""

import itertools
import json
from fractions import Fraction

import pytest
from care_oracle import Oracle, default_parameters

from exact_mdp.paper_repro import run
from exact_mdp.paper_repro.advice import SITUATIONS, advise
from exact_mdp.paper_repro.paper import STATUSES
from exact_mdp.paper_repro.silent_points import build_default_reading, one_change

ADVICE = json.loads((run.HERE / "results.json").read_text("utf-8"))["advice"]


def best_throughout(statuses: list[str], parameters: dict[str, Fraction] | None = None) -> set[str]:
    """Return the actions that are optimal in all states with these statuses."""
    oracle = Oracle(tasks=[3], parameters=parameters)
    places = itertools.product(range(3), range(5), statuses)
    states = [(k, t, 1, tuple(map(int, status))) for k, t, status in places]
    return set.intersection(*(set(oracle.optimal_actions(state)) for state in states))


def test_every_status_is_in_one_situation() -> None:
    assert sorted(s for each in SITUATIONS for s in each.statuses) == sorted(STATUSES)


@pytest.mark.parametrize("row", ADVICE, ids=lambda row: row["person"])
def test_the_best_assistance_and_its_limit(row: dict) -> None:
    assert best_throughout(row["statuses"]) == {row["best"]}
    unit = Fraction(1, 100) if row["ends"] else Fraction(-1)
    limit = Fraction(str(row["limit"]))
    assert default_parameters()[row["parameter"]] == Fraction(str(row["today"]))
    assert row["best"] in best_throughout(row["statuses"], {row["parameter"]: limit})
    assert row["best"] not in best_throughout(row["statuses"], {row["parameter"]: limit + unit})


def test_the_committed_table_is_what_the_code_finds() -> None:
    reading = build_default_reading()
    found = run.round_numbers(advise(reading, one_change(reading)))
    for row, committed in zip(found, ADVICE, strict=True):
        others = {"versions", "agreeing"}  # the best-supported reading is one more
        assert {k: v for k, v in row.items() if k not in others} == {
            k: v for k, v in committed.items() if k not in others
        }
        assert row["versions"] == committed["versions"] - 1 == 17
        assert committed["agreeing"] - row["agreeing"] in (0, 1)
