"""The claims of the paper: pinned, held against the independent model, traceable to their place."""

from __future__ import annotations

import itertools
from dataclasses import replace
from fractions import Fraction
from math import sqrt
from pathlib import Path

import numpy as np
import pytest
from oracle import ACTIONS, CLEAR, Oracle, acting
from reading_cases import ENDS

from exact_mdp.mdp import ModelError, Scenario
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.agents.claims import once
from exact_mdp.paper_repro.claims import Judged, Verdict, all_claims, chosen, judge
from exact_mdp.paper_repro.claims.claim import RULES, event, usual
from exact_mdp.paper_repro.claims.judge import disagreements, expected
from exact_mdp.paper_repro.reading import QUICK, Reading, Store, alternatives, changed, default
from exact_mdp.paper_repro.readings.search import averages
from exact_mdp.paper_repro.report.figures import choice_losses, status_law, trial_flow
from exact_mdp.paper_repro.report.output import cells, print_table
from exact_mdp.paper_repro.reported import COMPLETIONS, PLACES, SECTIONS, STARTS, section_of
from exact_mdp.solvers import evaluate

ANGRY = [s for s in map("".join, itertools.product("01", repeat=4)) if s[2] == "1"]
# What training ends with is given: see `reading_cases.ENDS`.
EXACT = [claim for claim in all_claims() if not claim.id.startswith("learning.")]


@pytest.fixture(scope="module")
def view() -> Reading:
    return replace(default(replace(QUICK, episodes=1000)), ends=ENDS)


@pytest.fixture(scope="module")
def judged(view: Reading) -> dict[str, Judged]:
    return {each.claim.id: each for each in judge(EXACT, view)}


@pytest.fixture(scope="module")
def oracle() -> Oracle:
    return Oracle(tasks=[3])


# ---- every claim -------------------------------------------------------------------------------


def test_every_claim_has_a_place_in_the_paper_and_a_rule() -> None:
    claims = all_claims()
    assert len({claim.id for claim in claims}) == len(claims) > 100
    for claim in claims:
        assert claim.places, claim.id
        assert set(claim.places) <= set(PLACES), claim.id
        assert section_of(claim.places[0]) in SECTIONS, claim.id
        assert claim.rule in RULES, claim.id
        assert claim.rerun == f"python -m paper_repro --claim {claim.id}"


def test_every_claim_is_pinned_with_a_reason_and_nothing_else_is() -> None:
    pinned = expected()
    assert set(pinned) == {claim.id for claim in all_claims()}
    assert all(entry.reason for entry in pinned.values())
    for name, entry in pinned.items():
        assert (entry.value is None) == (entry.tolerance is None), name


def test_the_exact_claims_agree_with_the_pinned_ones(judged: dict[str, Judged]) -> None:
    assert disagreements(list(judged.values()), expected()) == []


@pytest.mark.parametrize(
    ("status", "action"), [("base.anger", "1/10"), ("reward.subtask-complete", "51")]
)
def test_a_change_of_the_model_fails_and_names_the_claims(status: str, action: str) -> None:
    scenario = Scenario.load("yuan2025").with_(parameters={status: action})
    changed = Reading(scenario=scenario, ends=ENDS)
    claims = [claim for claim in EXACT if not claim.id.startswith(("agents.", "return.ranking."))]
    off = disagreements(judge(claims, changed), expected())
    table = "table3" if status.startswith("base") else "table4"
    entry = status.replace("reward.", "")
    for name in (f"{table}.{entry}:", "return.optimal:", "return.reported.directive:"):
        assert any(line.startswith(name) for line in off), name


def test_a_changed_number_or_verdict_is_found(judged: dict[str, Judged]) -> None:
    pinned = expected()
    random = pinned["return.random"]
    moved = pinned | {"return.random": replace(random, value=random.value + 1e-6)}
    (line,) = disagreements(list(judged.values()), moved)
    assert line.startswith("return.random: 85.02")
    turned = pinned | {"return.random": replace(random, verdict="reproduced")}
    (line,) = disagreements(list(judged.values()), turned)
    assert line == "return.random: not reproduced, pinned reproduced"
    less = {name: entry for name, entry in pinned.items() if name != "policy.anger"}
    assert disagreements(list(judged.values()), less) == ["policy.anger is not pinned"]


def test_the_table_says_where_something_else_than_the_difference_decides(
    judged: dict[str, Judged], capsys: pytest.CaptureFixture[str]
) -> None:
    print_table([each for each in judged.values() if each.claim.kind == "finding"])
    numbers = capsys.readouterr().out.split("paper / exact / difference")[1]
    rows = {line.split()[0]: line.rstrip() for line in numbers.splitlines() if line.strip()}
    marked = [name for name, line in rows.items() if line.endswith("*")]
    assert marked == ["return.optimal"]
    assert "+6.236" in rows["return.optimal"]
    assert f"* return.optimal is judged by a sentence: {chosen('return.optimal').says}" in " ".join(
        numbers.split()
    )
    assert all(len(line) <= 100 for line in rows.values() if not line[0].isdigit())


def test_an_unknown_claim_is_refused_with_the_nearest_one() -> None:
    with pytest.raises(ModelError, match=r"return\.random"):
        chosen("return.randon")


@pytest.mark.slow
def test_the_learned_claims_agree_with_the_pinned_ones() -> None:
    learned = [claim for claim in all_claims() if claim.id.startswith("learning.")]
    assert disagreements(judge(learned, default(QUICK)), expected()) == []


# ---- against the independent model -------------------------------------------------------------


def test_the_tables_are_the_papers(judged: dict[str, Judged]) -> None:
    tables = [each for name, each in judged.items() if name.startswith(("table3", "table4"))]
    assert len(tables) == 20 + 13
    for each in tables:
        assert each.finding.difference == 0
        assert each.finding.claim == "certified"


def test_probabilities_against_the_independent_model(
    judged: dict[str, Judged], oracle: Oracle
) -> None:
    for name, value in oracle.parameters.items():
        short = name.replace("base.", "table3.base.").replace("influence.", "table3.influence.")
        short = f"table3.{name}" if name.startswith("persistence.") else short
        short = name.replace("reward.", "table4.") if name.startswith("reward.") else short
        assert judged[short].finding.number.value == value, name


@pytest.mark.parametrize("start", reported.AVERAGE_RETURN)
def test_reported_policies_against_the_independent_model(
    view: Reading, judged: dict[str, Judged], oracle: Oracle, start: str
) -> None:
    actions = reported.policy(start, view.completion)
    exact = oracle.evaluate(acting(actions), distribution=False)
    found = judged[f"return.reported.{start}"].finding
    assert abs(Fraction(found.exact) - exact["mean"]) <= Fraction(found.number.error)
    assert found.details["simulated_standard_error"] > 0
    assert found.standard_error == pytest.approx(sqrt(exact["variance"] / 1000), rel=1e-10)
    assert found.difference == found.exact - reported.AVERAGE_RETURN[start]


def test_optimum_random_and_regret_against_the_independent_model(
    view: Reading, judged: dict[str, Judged], oracle: Oracle
) -> None:
    best = oracle.value(oracle.start)
    quarter = dict.fromkeys(ACTIONS, Fraction(1, 4))
    random = oracle.evaluate(lambda state: quarter, distribution=False)["mean"]
    final = reported.policy("non-directive", view.completion)
    worth = oracle.evaluate(acting(final), distribution=False)["mean"]
    for name, exact in (("optimal", best), ("random", random)):
        found = judged[f"return.{name}"].finding
        assert abs(Fraction(found.exact) - exact) <= Fraction(found.number.error)
    assert judged["policy.final-is-optimal"].finding.number.value == best - worth


@pytest.mark.parametrize(
    "name, statuses, action",
    [
        ("policy.1100", ["1100"], "directive"),
        ("policy.1000", ["1000"], "directive"),
        ("policy.0100", ["0100"], "non-directive"),
        ("policy.0000", ["0000"], "non-directive"),
        ("policy.anger", ANGRY, "supportive"),
    ],
)
def test_best_actions_against_the_independent_model(
    judged: dict[str, Judged], oracle: Oracle, name: str, statuses: list[str], action: str
) -> None:
    places = itertools.product(range(3), range(5), statuses)
    states = [(k, t, 1, tuple(map(int, status))) for k, t, status in places]
    right = [action in oracle.optimal_actions(state) for state in states]
    assert judged[name].finding.number.value == Fraction(sum(right), len(right))
    assert (judged[name].verdict is Verdict.REPRODUCED) == all(right)


def test_the_range_holds_every_completion_and_is_reached(view: Reading) -> None:
    completions = view.averages
    for number, start in enumerate(STARTS):
        for place in (0, 77, 150, 255, 300, 511):
            policy = reported.policy(start, COMPLETIONS[place])
            found = evaluate(view.mdp, policy)
            assert completions.mean[place, number] == pytest.approx(found.mean, rel=1e-12)
            assert completions.variance[place, number] == pytest.approx(found.sd**2, rel=1e-9)
    assert len(COMPLETIONS) == len(completions.mean) == 512
    written, swapped = completions.best(), completions.best("swapped")
    final = completions.mean[:, 0]
    assert (final[:256].argmax(), final[256:].argmax() + 256) == (written, swapped)
    assert view.completion == COMPLETIONS[written]
    exact = view.evaluations["reported.non-directive"].mean
    assert exact == pytest.approx(final[written], rel=1e-12)


def test_the_averages_are_judged_by_the_learnable_completion_that_fits_all_three_best(
    view: Reading, judged: dict[str, Judged]
) -> None:
    far = {}
    for place, filled in enumerate(COMPLETIONS[320:390], start=320):
        far[place] = 0.0
        for start, paper in reported.AVERAGE_RETURN.items():
            found = evaluate(view.mdp, reported.policy(start, filled))
            far[place] += (found.mean - paper) ** 2 / (found.sd**2 / reported.EXPERIMENTS)
    completions = view.weighed
    best = min(far, key=far.__getitem__)  # the best ones are among these
    assert completions.fitting_of_all == best
    learned = [place for place in far if completions.learnable[place]]
    assert completions.fitting == min(learned, key=far.__getitem__)
    assert completions.chi_squared[best] == pytest.approx(far[best], rel=1e-9)
    assert completions.chi_squared.min() == pytest.approx(1.0082, abs=1e-4)
    assert reported.order(COMPLETIONS[best]) == "swapped"
    for start in reported.AVERAGE_RETURN:
        found = judged[f"return.reported.{start}"].finding
        near = abs(found.details["best_fit_in_standard_errors"]) <= 3
        assert (found.verdict is Verdict.REPRODUCED) == near
        assert found.details["as_written"] == pytest.approx(found.exact, rel=1e-12)
        # The number beside the verdict is the judged one, its distance by the rule too.
        policy = reported.policy(start, COMPLETIONS[int(completions.fitting)])
        worth, shown = evaluate(view.mdp, policy), cells(judged[f"return.reported.{start}"])
        apart = worth.mean - reported.AVERAGE_RETURN[start]
        assert shown["exact"] == f"{worth.mean:.3f}"
        assert float(shown["errors"].replace("−", "-")) == pytest.approx(
            apart / (worth.sd / sqrt(reported.EXPERIMENTS)), abs=0.05
        )
        assert f"{worth.mean:.1f}" in judged["return.ranking"].finding.shown
    together = judged["return.together"].finding
    assert together.details["probability_of_any"] == pytest.approx(0.799, abs=1e-3)
    assert together.details["probability"] == pytest.approx(0.0292, abs=1e-4)
    assert together.details["weight_of_any"] < 1e-9
    weights = np.exp(ENDS.log_weights)
    expected = sum(w * p for w, p in zip(weights, completions.probabilities, strict=True))
    assert together.shown == "p = 0.01"
    assert completions.expected_probability == pytest.approx(expected, rel=1e-9)
    assert together.details["expected_probability"] == pytest.approx(expected, rel=1e-9)
    # The line of what is learnable moves the best fit, and hardly the average.
    low, high = together.details["probability_interval"]
    assert low < 0.0292 < 0.0329 < 0.1338 < high
    low, high = together.details["expected_probability_interval"]
    assert 0.009 < low < expected < high < 0.011


@pytest.mark.parametrize(
    "change",
    [{}, {"influence_orientation": "column-to-row"}, {"tasks": (2,)}],
    ids=["default", "turned", "two subtasks"],
)
def test_a_reading_is_counted_as_it_is_judged(view: Reading, change: dict[str, object]) -> None:
    from exact_mdp.analysis.readings import ReadingSpace
    from exact_mdp.paper_repro.claims.judge import agreeing
    from exact_mdp.paper_repro.readings.evidence import evidence
    from exact_mdp.paper_repro.readings.search import PAPER_READINGS, search

    one = {name: options[:1] for name, options in PAPER_READINGS.options.items()}
    one |= {name: (option,) for name, option in change.items()}
    found = search(space=ReadingSpace(options=one), n_jobs=1)
    weights = ENDS.log_weights[None]
    counted = agreeing(evidence(found, log_weights=weights))
    same = view.other("another", found.reading(0)) if change else view
    listed = [claim for claim in EXACT if claim.id in counted]
    assert len(listed) == len(counted) == 8
    for each in judge(listed, same):
        agrees = counted[each.claim.id].reproduced == 1
        assert agrees == (each.verdict is Verdict.REPRODUCED), each.claim.id


def test_variances_hold_at_a_discount_too() -> None:
    scenario = Scenario.load("yuan2025").with_(discount="19/20")
    found, mdp = averages(scenario), scenario.compile()
    policy = reported.policy("directive", COMPLETIONS[9])
    assert found.variance[9, STARTS.index("directive")] == pytest.approx(
        evaluate(mdp, policy).sd ** 2, rel=1e-9
    )


def test_the_drawn_law_is_that_of_independent_statuses(view: Reading) -> None:
    law = status_law(view.mdp, view.mdp.action("directive"))
    assert law.sum(axis=1) == pytest.approx(1)
    # 1100 under a3: forgetfulness and confusion 1/20 each, anger 5+6+8 %, disengagement 20+2+2 %.
    assert law[0b1100, 0b0000] == pytest.approx(0.95 * 0.95 * 0.81 * 0.76)
    assert law[0b1100, 0b1011] == pytest.approx(0.05 * 0.95 * 0.19 * 0.24)


def test_the_flow_of_trials_against_the_independent_model(view: Reading, oracle: Oracle) -> None:
    made, ends = trial_flow(view.mdp, "always:directive", view.scenario.trials)
    reached = {CLEAR: Fraction(1)}
    for trial in range(5):
        total = sum(reached.values())
        following: dict[object, Fraction] = {}
        for status, weight in reached.items():
            for chance, state, _, skipped in oracle.outcomes((0, trial, 1, status), "directive"):
                if not skipped and state[0] == 0:
                    following[state[3]] = following.get(state[3], Fraction(0)) + weight * chance
        done = sum(
            weight * chance
            for status, weight in reached.items()
            for chance, state, rewards, _ in oracle.outcomes((0, trial, 1, status), "directive")
            if "subtask-complete" in rewards
        )
        assert made[trial] == pytest.approx(float(total))
        assert ends[trial] == pytest.approx(float(done / total))
        reached = following


def test_what_encouragement_costs_a_confused_person_against_the_independent_model(
    view: Reading, oracle: Oracle
) -> None:
    found = once(view.mdp, "0100", "supportive")
    places = itertools.product(range(3), range(5))
    states = [(k, t, 1, (0, 1, 0, 0)) for k, t in places]
    worth = [
        sum(p * (sum(rewards.values()) + oracle.value(after)) for p, after, rewards, _ in listed)
        for listed in (oracle.outcomes(state, "supportive") for state in states)
    ]
    exact = [oracle.value(state) - each for state, each in zip(states, worth, strict=True)]
    assert sorted(found) == sorted(exact)


def test_the_rows_are_products_and_the_skip_rule_knows_no_distress(
    judged: dict[str, Judged],
) -> None:
    assert "in 64 of 64 rows" in judged["states.independent"].finding.why
    assert judged["prose.stress-on-memory"].verdict is Verdict.NOT_REPRODUCED


# ---- readings ----------------------------------------------------------------------------------


def test_what_the_prose_says_of_anger_holds_the_other_way_round(view: Reading) -> None:
    names = ("prose.anger-weighs-most-on-forgetfulness", "prose.anger-contributes-most")
    (turned,) = (v for v in alternatives(view) if "column-to-row" in v.label)
    for name in names:
        (alone,) = judge([chosen(name)], view)
        assert alone.verdict is Verdict.NOT_REPRODUCED
        (each,) = judge([chosen(name)], view, others=[turned])
        assert each.verdict is Verdict.DEPENDS
        assert each.finding.verdict is Verdict.NOT_REPRODUCED
        assert each.others is not None
        assert (each.others.tried, each.others.reproduced) == (2, 1)
        assert each.others.example == "Table 3 from column to row"


def test_a_skip_with_a_timestep_of_its_own_breaks_table_1(view: Reading) -> None:
    others = [v for v in alternatives(view) if v.label == "skip_timestep = own"]
    (each,) = judge([chosen("table1.timesteps")], view, others=others)
    assert each.verdict is Verdict.REPRODUCED
    assert each.others is not None
    assert each.others.reproduced == 1


@pytest.mark.parametrize(
    "change, name, told",
    [
        ("readings.skip_timestep=own", "agents.confusion-supported", "optimal in"),
        ("readings.evaluation_discount=0.95", "return.ranking.by-experiments", "open, because"),
        ("reward.timestep=-1.001", "return.ranking.by-experiments", "open, because"),
    ],
)
def test_a_claim_that_a_reading_leaves_open_ends_no_run(
    view: Reading, change: str, name: str, told: str
) -> None:
    found = chosen(name).find(changed(view, [change]))
    assert told in found.why
    assert (found.verdict is Verdict.NOT_DETERMINED) == (told == "open, because")


def test_the_reason_is_that_of_the_reading(view: Reading) -> None:
    """What supportive assistance costs a person who is confused differs with the weights."""
    claim = chosen("agents.confusion-supported")
    other = changed(view, ["reward.assist.supportive=-40"])
    assert claim.find(other).why != claim.find(view).why
    lost = max(once(other.mdp, "0100", "supportive"))
    assert f"to {float(lost):.1f} points each time" in claim.find(other).why


@pytest.mark.slow
def test_every_claim_has_a_verdict_under_every_reading_with_one_change(view: Reading) -> None:
    for other in alternatives(view):
        assert {each.finding.verdict for each in judge(EXACT, other)} <= set(Verdict), other.label


def test_the_readings_tried_are_named_as_they_are_and_counted_once(view: Reading) -> None:
    others = [v for v in alternatives(view) if v.label == "tasks = [2]"]
    (each,) = judge([chosen("policy.1100")], view, others=[*others, *others])
    assert each.others is not None
    assert each.others.tried == 2
    assert "best supported" not in each.others.scope  # no search was made


def test_inputs_and_findings_are_told_apart(judged: dict[str, Judged]) -> None:
    inputs = {name for name, each in judged.items() if each.claim.kind == "input"}
    assert {each.claim.id for each in judged.values() if each.claim.rule == "entry"} <= inputs
    told = {name for name in judged if name.startswith("prose.")}
    assert told <= inputs
    others = {name for name in inputs - told if name.startswith(("policy.", "agents.", "return."))}
    assert others == {"policy.status-suffices", "agents.saved-as-text", "return.experiments"}


def test_a_policy_may_follow_either_order_of_the_sentence() -> None:
    for place in (0, 511):
        policy = reported.policies(COMPLETIONS[place : place + 1])[0]
        order = reported.order(COMPLETIONS[place])
        assert reported.states(policy)
        assert reported.states(policy, [order])
        assert not reported.states(policy, [other for other in reported.ORDERS if other != order])


def test_claims_that_no_reading_touches_try_none(view: Reading) -> None:
    others = [v for v in alternatives(view) if v.label == "tasks = [2]"]
    (each,) = judge([chosen("table3.base.anger")], view, others=others)
    assert each.others is None


# ---- rules and store ---------------------------------------------------------------------------


def test_a_rare_event_needs_enough_runs_to_be_refused() -> None:
    assert event(0, 20, "").verdict is Verdict.NOT_DETERMINED
    assert event(0, 200, "").verdict is Verdict.NOT_REPRODUCED
    assert event(20, 200, "").verdict is Verdict.REPRODUCED


def test_what_is_said_of_training_in_general_must_hold_in_most_runs() -> None:
    assert usual(20, 200, "").verdict is Verdict.NOT_REPRODUCED
    assert usual(100, 200, "").verdict is Verdict.NOT_DETERMINED
    assert usual(150, 200, "").verdict is Verdict.REPRODUCED


def test_finished_parts_are_read_again_and_a_damaged_one_is_named(tmp_path: Path) -> None:
    store, calls = Store.under(tmp_path), []

    def work() -> list[int]:
        calls.append(1)
        return [1, 2]

    assert not store.used
    assert store.json("part", work) == store.json("part", work) == [1, 2]
    assert len(calls) == 1
    assert store.used
    (store.root / "part.json").write_text("[1,")
    with pytest.raises(ModelError, match="damaged"):
        store.json("part", work)


def test_losses_of_choices_are_those_of_single_changes(view: Reading) -> None:
    losses = choice_losses(view)
    assert (losses >= 0).all()
    assert ((losses == 0).sum(axis=1) == 1).all()
    final = view.evaluations["reported.non-directive"].mean  # as written: 0100 alone errs
    best = view.evaluations["optimal"].mean
    assert losses[0b0100, 2] == pytest.approx(best - final)
    assert np.argmin(losses[0]) == 2
