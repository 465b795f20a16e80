"""Numbers of a report carry a claim, or the report has one for all of them."""

from fractions import Fraction
from typing import Any

import pytest
from bare_numbers import bare_numbers

from exact_mdp import Bounded, Certified, Estimated
from exact_mdp.mdp.report import Report, Table, format_cell, format_fact, list_claim_facts
from exact_mdp.mdp.result import data_frame, frame_to_table

SURE = {
    "nothing": {"states": 3, "share": Fraction(1, 3), "name": "x"},
    "each": {"value": Bounded(value=1.5, error=1e-9), "by": [Certified(value=Fraction(1, 2))]},
    "one for all": {
        **list_claim_facts("value", Bounded(value=1.5, error=0.0)),
        "others": {"a": 0.5},
    },
}
BARE: dict[str, dict[str, Any]] = {
    "a fact": {"value": 1.5},
    "one below": {"by_state": {"a": {"value": 0.5}}},
    "in rows": {"points": [{"at": 1}, {"at": 0.5}]},
}


@pytest.mark.parametrize("facts", SURE.values(), ids=SURE)
def test_what_carries_a_claim_may_stand(facts: dict[str, Any]) -> None:
    assert bare_numbers(Report(title="a result", facts=facts)) == []


@pytest.mark.parametrize("form", ["json", "lines"])
@pytest.mark.parametrize("facts", BARE.values(), ids=BARE)
def test_a_bare_number_fails_wherever_it_is_shown(facts: dict[str, Any], form: str) -> None:
    with pytest.raises(AssertionError, match="give it a claim"):
        getattr(Report(title="a new command", facts=facts), form)()


@pytest.mark.parametrize("table", [
    frame_to_table(data_frame({"state": ["a"], "value": [0.5]})),
    Table(title="states", columns={"value": "value"}, rows=[{"value": 0.5}]),
])  # fmt: skip
def test_a_bare_number_in_a_table_fails(table: Table) -> None:
    assert bare_numbers(Report(title="a new command", facts={}, tables={"states": table}))
    assert not bare_numbers(Report(title="a result (bounded)", facts={}, tables={"states": table}))


def test_a_standard_error_has_two_digits_everywhere() -> None:
    """In a cell, in a fact and as text; an estimate has as many places as its error."""
    for error, digits, mean in ((121.04, "120", "1710"), (0.0163, "0.016", "1711.827")):
        number = Estimated(value=1711.8273, standard_error=error)
        assert format_cell(number) == f"{mean} ± {digits}"
        assert format_fact(number) == f"{mean} (estimated, standard error {digits})"
        assert str(number) == f"1711.83 ± {digits} s.e. (estimated)"
