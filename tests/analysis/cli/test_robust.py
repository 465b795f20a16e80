"""`exact-mdp sensitivity MODEL robust`, from outside."""

from fractions import Fraction

import pytest
from cli_runner import run

ONE = ("--set", "tasks=[1]")


def test_the_default_is_intervals_of_a_fifth() -> None:
    found = run("sensitivity", "yuan2025", "robust", *ONE, "--json").result
    assert (found["set_kind"], found["radius"], found["claim"]) == ("interval", 0.2, "bounded")
    assert found["worst_case"]["value"] < found["start_value"] < found["best_case"]["value"]
    assert found["worst_case"]["error_bound"] < 1e-6


@pytest.mark.parametrize(("kind", "radius"), [("l1", "0.1"), ("kl", "1/100"), ("box", "1/10")])
def test_the_other_sets(kind: str, radius: str) -> None:
    words = ("--set-kind", kind, "--radius", radius, "--policy", "always:supportive")
    done = run("sensitivity", "yuan2025", "robust", *ONE, "--set", "max_trial=2", *words)
    assert done.status == 0, done.err
    assert "worst case" in done.out


def test_a_box_tells_the_same_parts() -> None:
    small = (*ONE, "--set", "max_trial=2", "--json")
    box = run("sensitivity", "yuan2025", "robust", "--set-kind", "box", *small).result
    other = run("sensitivity", "yuan2025", "robust", *small).result
    assert set(other) - {"policy_changes", "seconds"} <= set(box)
    assert (box["claim"], box["error_bound"] < 1e-12, box["radius"]) == ("certified", True, 0.2)
    assert box["start_value"] == pytest.approx(other["start_value"], abs=1e-9)
    for case in ("worst_case", "best_case"):
        assert set(other[case]) <= set(box[case])
        held = box[case]["nominal_policy"]
        assert set(other[case]["nominal_policy"]) <= set(held)
        assert held["low"] <= held["value"] <= held["high"]
        if held["claim"] == "certified":
            assert abs(Fraction(held["exact"]) - Fraction(held["value"])) <= held["error_bound"]
    worst = box["worst_case"]
    assert worst["low"] <= worst["value"] <= worst["high"] < box["start_value"]
    assert box["worst_case_gain"]["value"] >= -box["worst_case_gain"]["error_bound"]
    assert box["best_case"]["value"] is None  # a policy reaches `low`; none is known to be best
    assert box["best_case"]["low"] > box["start_value"]


@pytest.mark.parametrize("kind", ["interval", "l1", "kl", "box"])
def test_a_radius_of_0_is_the_tables_as_they_are(kind: str) -> None:
    words = (*ONE, "--set", "max_trial=2", "--set-kind", kind, "--radius", "0", "--json")
    found = run("sensitivity", "yuan2025", "robust", *words).result
    for case in ("worst_case", "best_case"):
        held = found[case]["nominal_policy"]["value"]
        assert held == pytest.approx(found["start_value"], abs=1e-6)


@pytest.mark.parametrize(
    "words, message",
    [
        (("--radius", "abc"), "where: --radius"),
        (("--radius", "-1"), "where: --radius"),
        (("--set-kind", "box", "--radius", "abc"), "where: --radius"),
        (("--set-kind", "box", "--radius", "-1"), "where: --radius"),
        (("--set-kind", "l1", "--radius", "2.1"), "no two laws are more than 2 apart"),
    ],
)
def test_a_radius_that_is_none_is_named(words: tuple[str, ...], message: str) -> None:
    done = run("sensitivity", "yuan2025", "robust", *ONE, *words)
    assert (done.status, done.out) == (2, "")
    assert message in done.err
    assert "where: --radius" in done.err


@pytest.mark.parametrize(
    "words",
    [
        ("--set-kind", "ball"),
        ("--set-kind", "box", "--parameter", "base.angr"),
        ("--set-kind", "kl", "--range", "base.anger=0:1"),
        ("--set-kind", "box", "--range", "base.anger=1:0"),
    ],
)
def test_nonsense_exits_with_2(words: tuple[str, ...]) -> None:
    done = run("sensitivity", "yuan2025", "robust", *words)
    assert (done.status, done.out) == (2, "")
    assert done.err


def test_a_model_that_need_not_end_is_refused_at_discount_1() -> None:
    done = run("sensitivity", "gymnasium:FrozenLake-v1", "robust", "--discount", "1")
    assert done.status == 2
    assert "every policy to end" in done.err
    found = run(
        "sensitivity", "gymnasium:FrozenLake-v1", "robust", "--discount", "0.9", "--json"
    ).result
    assert found["worst_case"]["value"] < found["start_value"]
