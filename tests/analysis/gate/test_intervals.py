"""Intervals for the regret in the process behind records: they hold, and are what they say."""

from collections.abc import Callable
from contextlib import nullcontext
from fractions import Fraction as F
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import joblib
import numpy as np
import pandas as pd
import pytest
from cli_runner import run
from records import (
    CHANCES,
    LEVEL,
    NAMES,
    POLICY,
    RATE,
    ROWS,
    STAGES,
    by_stage,
    estimated,
    patients,
    recorded,
    staged_policy,
)
from refusal_tables import refused
from scipy import stats

from exact_mdp import MDP, ModelError, OffPolicy, PolicyLike, Posterior, Robust, check

Kind = Robust | Posterior | OffPolicy


TREAT = [*NAMES, "truncated"]


@cache
def truth(horizon: int | None = None) -> float:
    """Return the regret of POLICY, or of STAGES within a horizon, by this file's own equations."""
    rows = np.concatenate([ROWS, np.eye(4)[[3]][:, None].repeat(2, axis=1)])
    reward = np.concatenate([CHANCES, np.zeros((1, 2))])
    stages = STAGES if horizon else np.tile(POLICY, (1000, 1))
    best, own = by_stage(rows, reward, RATE, stages)[:, 0]
    return float(best - own)


def interval_of(
    by: Kind, mdp: MDP, policy: PolicyLike = POLICY, level: F = LEVEL, **how: Any
) -> Any:
    interval = check(mdp, policy, confidence=level, by=by, exact_values=False, **how).interval
    assert interval is not None
    return interval


def records_of(rows: list[Any], discount: Any = "1/2", **how: Any) -> tuple[pd.DataFrame, MDP]:
    """Return records, as NAMES or TREAT name their columns, and the model that they make."""
    frame = pd.DataFrame(rows, columns=TREAT[: len(rows[0])])
    return frame, MDP.from_transitions(frame, discount, **how)


def wilson(count: int, total: int) -> tuple[float, float]:
    interval = stats.binomtest(count, total).proportion_ci(0.95, "wilson")
    return interval.low, interval.high


# ---- coverage ----------------------------------------------------------------------------------

KINDS: dict[str, Callable[[pd.DataFrame, int], Kind]] = {
    "robust": lambda frame, seed: Robust(rewards=(0, 1)),
    "posterior": lambda frame, seed: Posterior(n=400, rng=seed),
    "off-policy": lambda frame, seed: OffPolicy(records=frame, behaviour="random", rewards=(0, 1)),
}


def covering(kind: str, episodes: int, sets: int, case: str = "") -> int:
    """Return how many of `sets` data sets give an interval that holds the true regret."""
    count = 0
    for seed in range(sets):
        frame = recorded(np.random.default_rng([episodes, seed]), episodes)
        if case == "start":  # rows and rewards are certain; that half are severe is not
            frame = patients(seed, 3000)
            mdp = MDP.from_transitions(frame, discount="1/2")
            ends, lost = interval_of(KINDS[kind](frame, seed), mdp, "always:0"), 0.5
            assert ends.high < 0.7 or kind == "off-policy"
        elif case == "horizon":
            mdp, by = MDP.from_transitions(frame, "9/10"), KINDS[kind](frame, seed)
            ends, lost = interval_of(by, mdp, staged_policy(mdp), horizon=3), truth(3)
        else:
            ends, lost = interval_of(KINDS[kind](frame, seed), estimated(frame)), truth()
        count += ends.low <= lost <= ends.high
    return count


SETS = [(300, 25, case) for case in ("", "start", "horizon")]
MANY = [pytest.param(episodes, 400, "", marks=pytest.mark.slow) for episodes in (100, 400, 1600)]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize(("episodes", "sets", "case"), [*SETS, *MANY])
def test_intervals_hold_the_truth(kind: str, episodes: int, sets: int, case: str) -> None:
    """The stated share is not above the Wilson interval of the share that hold it."""
    assert wilson(covering(kind, episodes, sets, case), sets)[1] >= float(LEVEL)


@pytest.mark.parametrize("episodes", [12, 40])
def test_the_posterior_holds_with_few_records(episodes: int) -> None:
    assert wilson(covering("posterior", episodes, 60), 60)[1] >= float(LEVEL)


def test_where_actions_tie_every_kind_holds_0() -> None:
    """Twelve choices without a difference: the regret is 0, which nearly no draw shows."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        rows = [(n, f"s{n % 12}", "ab"[n // 12 % 2], rng.integers(2), None) for n in range(600)]
        frame, mdp = records_of(rows)
        for kind, make in KINDS.items():
            interval = interval_of(make(frame, seed), mdp, "always:a")
            assert interval.low == 0, kind
            if kind == "posterior":
                assert interval.found["equal_tails"][0] > 0  # which is why it has no lower end
                assert interval.keeps_limit(F(1, 1000)) is None
    audit = check(mdp, "always:a", max_regret="1/1000", confidence=0.95, by=Posterior(n=400))
    assert audit.undecided
    assert "kept with probability 0 by the posterior" in audit.message()


@pytest.mark.parametrize("kind", ["robust", "posterior"])
def test_a_start_that_is_from_the_records_is_not_known(kind: str) -> None:
    frame = patients(0, 3000)
    mdp, by = MDP.from_transitions(frame, discount="1/2"), KINDS[kind](frame, 0)
    free, given = (interval_of(by, model, "always:0") for model in (
        mdp, mdp.with_(start={0: "1/2", 1: "1/2"})))  # fmt: skip
    assert given.high - 0.5 < (free.high - 0.5) / 2
    assert "episodes begin as the model says" in given.assumptions
    assert "episodes begin as the model says" not in free.assumptions


# ---- states that no record leaves ---------------------------------------------------------------


def test_states_that_were_only_entered_are_named() -> None:
    rows = [(n, "s", ("risky", "safe")[n % 2], n % 2 / 2, ("trap", None)[n % 2]) for n in range(80)]
    frame, mdp = records_of(rows)
    known = Robust(rewards="known"), OffPolicy(records=frame, rewards="known")
    for by in (Posterior(n=80), *known):
        interval = interval_of(by, mdp, "always:risky")
        named = [each for each in interval.assumptions if "state trap" in each]
        assert len(named) == 1, by
        assert "end" not in named[0].split("(")[1].split(")")[0]
    assert interval.found["taken_for_ended"] == 40
    assert interval.found["cut_off"] == 0


def test_where_episodes_were_cut_off_anything_may_follow() -> None:
    """The regret of every process that goes on there as it likes lies inside, by brute force."""
    each = [("risky", 0, "trap", True), ("safe", 0.5, None, False)]
    frame, mdp = records_of([(n, "s", *each[n % 2]) for n in range(200)])
    assert mdp.labels["cut off"].tolist() == [mdp.space.label(s) == "state trap" for s in range(3)]
    for action in ("risky", "safe"):
        policy = f"always:{action}"
        for by in (Robust(rewards="known"), KINDS["off-policy"](frame, 0)):
            interval = interval_of(by, mdp, policy)
            assert any("(state trap)" in each for each in interval.assumptions)
            assert not any("taken for ends" in each for each in interval.assumptions)
            # In the trap rewards of 0 to 1/2 follow for ever: worth 0 to 1, and 0 to 1/2 today.
            for later in (0.0, 0.3, 1.0):
                value = {"risky": 0.5 * later, "safe": 0.5}
                regret = max(value.values()) - value[action]
                assert interval.low <= regret <= interval.high
        with pytest.raises(ModelError, match="cut off in"):
            interval_of(Posterior(), mdp, policy)
    ended = MDP.from_transitions(frame.drop(columns="truncated"), discount="1/2")
    assert interval_of(Robust(rewards="known"), ended, "always:risky").low > 0.1  # an end, worth 0


# ---- robust: regret ----------------------------------------------------------------------------


def test_at_discount_1_a_range_of_returns_is_needed() -> None:
    mdp = MDP.from_transitions(recorded(np.random.default_rng(1), 4000))
    interval = interval_of(Robust(rewards=(0, 1), returns=(0, 20)), mdp)
    assert interval.low <= float(check(mdp, POLICY).value.value) <= interval.high < 20
    for returns, words in ((None, "how long an episode"), ((0, 0.5), "a reward of 1 was seen")):
        with pytest.raises(ModelError, match=words):
            interval_of(Robust(rewards=(0, 1), returns=returns), mdp)


@pytest.mark.parametrize("kind", ["robust", "off-policy"])
@pytest.mark.parametrize("end", ["well", None])
def test_at_discount_1_ends_are_worth_nothing(kind: str, end: str | None) -> None:
    """Who waits is ill for 5 days, who is treated for 2: 5 less 2 times 1.25 is lost."""
    rng, rows = np.random.default_rng(0), []
    for n in range(3000):
        state: str | None = "ill"
        while state == "ill":
            action = ("wait", "treat")[rng.integers(2)]
            cured = rng.random() < (0.5 if action == "treat" else 0.2)
            state = end if cured else "ill"
            rows.append((n, "ill", action, -1 if action == "wait" else -1.25, state))
    frame, mdp = records_of(rows, 1)
    how: dict[str, Any] = {"rewards": "known", "returns": (-60, 0)}
    by: Kind = Robust(**how)
    if kind == "off-policy":
        by = OffPolicy(records=frame, behaviour="random", **how)
    interval = interval_of(by, mdp, "always:wait")
    assert interval.low <= 2.5 <= interval.high
    assert interval.high < (4 if kind == "robust" else 58)
    least, most = interval.found["optimal_value"]
    assert -2.8 < least <= -2.5 <= most < -2.2
    best = interval_of(by, mdp, "always:treat")
    assert best.low == 0
    assert kind != "robust" or best.high < 1e-6


@pytest.mark.parametrize(
    ("returns", "last", "refused"),
    [((2, 10), None, 1), ((2, 10), "u", None), ((1, 10), None, None), ((0, 3), "u", 4)],
)
def test_a_range_of_totals_has_room_for_what_was_seen(
    returns: tuple[int, int], last: str | None, refused: int | None
) -> None:
    """1 is all that is earned where the episode is over, not where it was cut off."""
    rows = [(n, "s", "ab"[n % 2], (4, 1)[n % 2], last if n % 2 else None) for n in range(40)]
    _, mdp = records_of([(*row, row[-1] == "u") for row in rows], 1)
    error = pytest.raises(ModelError, match=f"a reward of {refused} was seen, after which no total")
    with error if refused else nullcontext():
        interval_of(Robust(rewards=(1, 4), returns=returns), mdp, "always:a")


# ---- episodes that stop --------------------------------------------------------------------------


def test_trajectories_count_up_to_the_horizon() -> None:
    rows = [(1, "a", "x", 1, "b"), (1, "b", "y", 2, "a"), (1, "a", "y", 4, None)]
    rows += [(2, "a", "x", 8, "b"), (2, "b", "x", 16, None), (3, "a", "y", 32, "b")]
    frame, mdp = records_of(rows)
    by = OffPolicy(records=frame, behaviour="random", rewards=(0, 32))
    one, two = (interval_of(by, mdp, "always:x", horizon=n).found for n in (1, 2))
    # One step: x has weight 2 in the first two episodes, which earn 1 and 8; none was cut off.
    assert one["ordinary"] == pytest.approx((2 * 1 + 2 * 8) / 3)
    assert (one["cut_off"], one["effective_sample_size"]) == (0, 2.0)
    assert two["ordinary"] == pytest.approx(4 * (8 + 16 / 2) / 3)
    assert two["cut_off"] == 1  # the third, after one step


# ---- posterior ---------------------------------------------------------------------------------


@pytest.mark.parametrize("backend", ["threading", pytest.param("loky", marks=pytest.mark.slow)])
def test_the_same_seed_gives_the_same_bytes_wherever(backend: str) -> None:
    frame = recorded(np.random.default_rng(2), 60)
    mdp = estimated(frame)

    def draws(seed: int = 3, **how: Any) -> bytes:
        models = interval_of(Posterior(n=600, rng=seed, **how), mdp).draws
        return bytes(models.tobytes())

    here = draws()
    with joblib.parallel_config(backend):
        assert draws(n_jobs=2) == here
    assert draws(4) != here
    with joblib.parallel_config("multiprocessing"):
        refused(lambda: draws(n_jobs=2), "", "joblib.parallel_config", '"loky", "threading" or')


@pytest.mark.parametrize(("level", "least"), [("1/2", 6), (0.95, 72), (0.99, 368), (0.999, 3688)])
def test_too_few_draws_show_no_upper_end(level: Any, least: int) -> None:
    """As many as are needed for the greatest to be above the quantile in 97.5 % of samples."""
    assert 1 - float(F(str(level))) ** least >= 0.975 > 1 - float(F(str(level))) ** (least - 1)
    mdp = estimated(recorded(np.random.default_rng(4), 100))
    with pytest.raises(ModelError, match=f"{least - 1:,} draws are too few") as caught:
        interval_of(Posterior(n=least - 1), mdp, level=F(str(level)))
    assert f"n={least})" in str(caught.value)
    interval = interval_of(Posterior(n=least), mdp, level=F(str(level)))
    assert interval.high == interval.draws.max()


def test_the_probability_is_a_share_of_the_draws() -> None:
    mdp = estimated(recorded(np.random.default_rng(2), 60))
    interval = interval_of(Posterior(n=600), mdp)
    share = interval.within(F(1, 2))
    assert share.value == np.mean(interval.draws <= 0.5)
    assert share.interval == pytest.approx(wilson(round(share.value * 600), 600), rel=1e-12)
    assert interval.within(F(1000)).interval[0] < 1  # all draws agree, and some doubt is left
    assert np.quantile(interval.draws, 0.95) <= interval.high <= np.quantile(interval.draws, 0.98)
    low, high = interval.found["equal_tails"]
    assert low <= np.quantile(interval.draws, 0.025) < np.quantile(interval.draws, 0.975) <= high


# ---- off-policy --------------------------------------------------------------------------------


def test_weights_and_returns_are_those_of_the_episodes() -> None:
    rows = [
        (1, "a", "x", 1, "b"), (1, "b", "y", 2, None),
        (2, "a", "y", 4, "a"), (2, "a", "x", 8, "b"), (2, "b", "x", 16, "b"),
        (3, "a", "x", 3, None),
    ]  # fmt: skip
    frame, mdp = records_of(rows)
    policy = {"a": "x", "b": "x"}
    weights = np.array([0.0, 0.0, 2.0])  # π/b is 2, or 0; the second episode takes y first
    returns = np.array([2.0, 12.0, 3.0])
    for records in (frame, [frame.iloc[n : n + 1] for n in range(6)]):
        by = OffPolicy(records=records, behaviour="random", rewards=(0, 16))
        evidence = interval_of(by, mdp, policy).found
        assert evidence["ordinary"] == pytest.approx(float((weights * returns).mean()))
        assert evidence["weighted"] == pytest.approx(float(weights @ returns / weights.sum()))
        assert (evidence["effective_sample_size"], evidence["cut_off"]) == (1.0, 1)
    # Estimated, the behaviour takes x in a with 3/4 and in b with 1/2.
    evidence = interval_of(OffPolicy(records=frame, rewards=(0, 16)), mdp, policy).found
    assert evidence["ordinary"] == pytest.approx(float(4 / 3 * 3 / 3))


# ---- the gate ----------------------------------------------------------------------------------


def test_the_gate_passes_on_the_bound_and_never_on_the_estimate() -> None:
    frame = recorded(np.random.default_rng(4), 200)
    mdp = estimated(frame)
    point = check(mdp, POLICY).value.value
    limit = point + F(1, 100)
    assert check(mdp, POLICY, max_regret=limit).passed
    for kind, make in KINDS.items():
        audit = check(mdp, POLICY, max_regret=limit, confidence=0.95, by=make(frame, 0))
        assert audit.regret_interval is not None
        low, high = audit.regret_interval
        assert low <= limit < high, kind
        assert not audit.passed
        assert audit.undecided
        assert "not known to be at most" in audit.message()
        assert kind in audit.message()
        assert check(mdp, POLICY, max_regret=high, confidence=0.95, by=make(frame, 0)).passed
        if low > 0:
            failed = check(mdp, POLICY, max_regret=low / 2, confidence=0.95, by=make(frame, 0))
            assert not failed.undecided
            assert not failed.passed


# ---- the command ---------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Return a folder with records of two treatments, and the model that they make."""
    place, rng = tmp_path_factory.mktemp("records"), np.random.default_rng(0)
    rows = [
        (n, "ill", ("a", "b")[n % 2], int(rng.random() < 0.3 + n % 2 / 2), None) for n in range(800)
    ]
    pd.DataFrame(rows, columns=NAMES).to_csv(place / "records.csv", index=False)
    MDP.from_transitions(place / "records.csv", "1/2").save(place / "model.npz")
    return place


def asked(kind: str, folder: Path, draws: int) -> list[str]:
    """Return the words that ask for a kind of interval."""
    words = ["check", str(folder / "model.npz"), "always:a", "--confidence=0.95", f"--by={kind}"]
    if kind == "posterior":
        return [*words, f"--evidence=n={draws}", "--evidence=rng=2"]
    records = [f"--evidence=records={folder / 'records.csv'}", "--evidence=behaviour=random"]
    return [*words, "--evidence=rewards=0,1", *records * (kind == "off-policy")]


@pytest.mark.parametrize("kind", ["robust", "posterior", "off-policy"])
def test_the_keys_and_the_reports(kind: str, folder: Path, tmp_path: Path) -> None:
    words = asked(kind, folder, 200)
    result = run(*words, "--max-regret=0.9", "--json").result
    assert (result["passed"], result["confidence"], result["by"]) == (True, 0.95, kind)
    claim = "bounded" if kind == "robust" else "estimated"
    assert (result["claim"], result["regret_claim"]) == (claim, "certified")
    low, high = result["regret_interval"]
    assert low <= result["regret"] <= high <= 0.9
    assert result["assumptions"]
    page, report = tmp_path / "page.html", tmp_path / "report.xml"
    limit = result["regret"] + 0.001  # the estimate keeps it, the interval does not
    done = run(*words, f"--max-regret={limit}", "--markdown", f"--html={page}", f"--junit={report}")
    assert done.status == 1
    shown = f"at 95 % confidence, {kind}"
    tree = ElementTree.parse(report)
    listed = {each.get("name"): each.get("value", "") for each in tree.iter("property")}
    assert (shown in listed["regret_interval"], listed["claim"]) == (True, claim)
    assert "no medical advice" in listed["notice"]
    texts = [done.out, page.read_text("utf-8"), report.read_text("utf-8")]
    assert f"{shown} ({claim})" in texts[1]
    for text in texts:
        assert shown in text
        assert "leaves the limit open" in text
        assert "no: it is in" not in text
    assert [text.count("no medical advice") for text in texts[:2]] == [1, 1]
