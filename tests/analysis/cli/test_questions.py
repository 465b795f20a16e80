"""The questions that every command takes: one model by hand, each answer worked out by hand."""

from pathlib import Path
from typing import Any

import pytest
from cli_runner import run

from exact_mdp import MDP, certify, check, solve

# From `here`, walk gets home with chance 1/2 and else stays, at cost 1; fly is home at once, at
# cost 3; swim costs 5 and drowns with chance 1/4. Home and the sea end it.
LAND = MDP.from_outcomes(
    [
        (0, 0, [("1/2", 1, 1), ("1/2", 0, 1)]),
        (0, 1, [(1, 1, 3)]),
        (0, 2, [("3/4", 1, 5), ("1/4", 2, 5)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
        (3, 0, [("1/5", 0, 0), ("4/5", 2, 0)]),
    ],
    actions=["walk", "fly", "swim"],
    states=["here", "home", "sea", "beach"],
    labels={
        "home": [False, True, False, False],
        "over": [False, True, True, False],
        "dry": [True, True, False, True],
        "beach": [False, False, False, True],
    },
)
HOME, OVER = ("--until", "home", "--minimize"), ("--until", "over", "--minimize")


@pytest.fixture
def land(tmp_path: Path) -> str:
    LAND.save(tmp_path / "land.npz")
    return str(tmp_path / "land.npz")


@pytest.mark.parametrize(
    ("words", "mean", "never"),
    [
        (["--reach", "home"], 0.75, 0),
        (["--until", "home", "--start", "sea"], "inf", 1),
        (["--until", "home", "--minimize"], "inf", 0.25),
        (["--until", "over", "--minimize"], 5, 0),
        (["--reach", "home", "--allowed", "dry", "--start", "beach"], 0.15, 0),
        (["--start", "beach", "--minimize", "--horizon", "1"], 0, 0),
    ],
)
def test_simulations_and_returns_of_questions(
    land: str, words: list[str], mean: float | str, never: float
) -> None:
    result = run("simulate", land, "always:swim", "--episodes", "400", "--json", *words).result
    assert result["mean"] == (mean if isinstance(mean, str) else pytest.approx(mean, abs=0.1))
    assert result["never_ends"] == pytest.approx(never, abs=0.1)
    exact = run("returns", land, "always:swim", "--json", *words).result
    assert exact["mean"] == (mean if isinstance(mean, str) else pytest.approx(mean))
    assert exact["never_ends"] == exact["distribution"].get("inf", 0) == never
    assert exact["question"] == result["question"]


@pytest.mark.parametrize(
    ("words", "exact", "policy"),
    [
        (["--reach", "home"], "1", "walk"),
        (["--reach", "home", "--minimize"], "3/4", "swim"),
        (["--reach", "home", "--start", "beach"], "1/5", "walk"),
        (["--reach", "home", "--allowed", "dry", "--start", "3", "--minimize"], "3/20", "swim"),
        (HOME, "2", "walk"),
        (["--until", "home"], "inf", "swim"),  # those who drown never arrive
        ([*HOME, "--start", "beach"], "inf", None),
        (OVER, "2", "walk"),
        (["--until", "over"], "5", "swim"),
        ([*HOME, "--discount", "1/2"], "4/3", "walk"),
        (["--minimize", "--horizon", "3"], "7/4", None),
        (["--reach", "home", "--minimize", "--horizon", "1"], "1/2", None),
        (["--reach", "home", "--start", "beach", "--horizon", "1"], "0", None),
        (["--reach", "home", "--start", "beach", "--horizon", "2"], "1/5", None),
        ([*HOME, "--horizon", "1"], "3", None),
        ([*HOME, "--horizon", "2"], "5/2", None),  # walk, and fly where that fails
        (["--until", "home", "--horizon", "2"], "inf", None),
    ],
)
def test_every_question_has_the_answer_worked_out_by_hand(
    land: str, words: list[str], exact: str, policy: str | None
) -> None:
    result = run("solve", land, *words, "--certify", "--json").result
    assert result["exact_start_value"] == exact
    assert result["sense"] == ("min" if "--minimize" in words else "max")
    if policy:
        assert result["policy_by_state"]["here"] == policy


# ---- costs ---------------------------------------------------------------------------------------

# To wait costs 1 and stays; to walk costs 3 and arrives with chance 1/2.
COSTS = MDP.from_outcomes(
    [(0, 0, [(1, 0, 1)]), (0, 1, [("1/2", 1, 3), ("1/2", 0, 3)]), (1, 0, [(1, 1, 0)])],
    sense="min",
    labels={"goal": [1]},
    actions=["wait", "walk"],
)


@pytest.mark.parametrize(
    ("words", "question", "sense", "value"),
    [
        (["--reach", "goal"], "greatest probability of reaching goal", "max", 1),
        (["--reach", "goal", "--maximize"], "greatest probability of reaching goal", "max", 1),
        (["--reach", "goal", "--minimize"], "least probability of reaching goal", "min", 0),
        (["--until", "goal"], "least expected cost until goal", "min", 6),
        (["--until", "goal", "--maximize"], "greatest expected cost until goal", "max", "inf"),
        (["--discount", "1/2"], None, "min", 2),
        (["--discount", "1/2", "--maximize"], "greatest expected costs", "max", 4),
        (["--criterion", "average", "--minimize"], "least cost per step in the long run", "min", 0),
    ],
)
def test_the_question_says_what_is_computed_of_costs(
    words: list[str], question: str | None, sense: str, value: float | str, tmp_path: Path
) -> None:
    """The direction of a probability never follows the sense of the rewards."""
    model = str(tmp_path / "costs.npz")
    COSTS.save(model)
    result = run("solve", model, "--json", *words).result
    assert (result["question"], result["sense"]) == (question, sense)
    assert result["start_value"] == pytest.approx(value)
    for form in ([], ["--markdown"]):
        said = run("solve", model, *words, *form).out
        assert question is None or question in said
        assert ("costs are minimised" in said) is (sense == "min" and "--reach" not in words)


def test_a_check_of_costs_passes_who_arrives(tmp_path: Path) -> None:
    """The page and the JUnit report say what was asked, too."""
    model, page, junit = (str(tmp_path / name) for name in ("c.npz", "c.html", "c.xml"))
    COSTS.save(model)
    reach = ("--reach", "goal", "--html", page, "--junit", junit)
    assert run("check", model, "always:wait", *reach).status == 1
    assert run("check", model, "always:walk", *reach).status == 0
    for path in (page, junit):
        assert "greatest probability of reaching goal" in Path(path).read_text("utf-8")
    for command in ("evaluate {} always:walk", "returns {} always:walk", "tornado {}"):
        result = run(command.format(model), "--json", *reach[:2]).result
        assert result["question"] == "greatest probability of reaching goal"
    both = run("solve", model, "--minimize", "--maximize").refusal()
    assert "contradict" in both


def test_in_python_the_text_says_which_probability() -> None:
    least, greatest = COSTS.reaching("goal"), COSTS.with_(sense="max").reaching("goal")
    for result in (least, solve(least), check(least, "always:wait").question):
        assert "least probability of reaching" in str(result)
    for result in (greatest, solve(greatest), check(greatest, "always:walk").question):
        assert "greatest probability of reaching" in str(result)
    assert "least start value" in str(certify(least))
    assert "costs to minimise" in check(COSTS.with_(discount="1/2"), "always:walk").question


# ---- sensitivity ---------------------------------------------------------------------------------


def test_sensitivity_of_what_is_asked() -> None:
    """The least probability of home falls by 1/4 · d/dp as the chance of drowning rises."""
    small = "yuan2025 --set tasks=[1] --set max_trial=1 --reach anger --json"
    low, high = (
        run(f"solve {small} --set base.anger={value}").result["start_value"]
        for value in ("499/10000", "501/10000")
    )
    most = run(f"gradient {small} --parameter base.anger").result
    assert most["derivatives"]["base.anger"] == pytest.approx((high - low) * 5000, rel=1e-4)
    least = run(f"gradient {small} --parameter base.anger --minimize").result
    assert least["sense"] == "min"
    assert least["start_value"] <= most["start_value"]


def test_where_some_policy_never_ends(tmp_path: Path) -> None:
    """What is not answered says so; what is proved exactly is called certified."""
    rows = [(0, 0, [(1, 0, 0)]), (0, 1, [(1, 1, 5)]), (1, 0, [(1, 1, 0)])]
    model, proof, page = (str(tmp_path / name) for name in ("m.npz", "m.json", "m.html"))
    MDP.from_outcomes(rows, labels={"home": [False, True]}).save(model)
    assert "add --certify" in run("solve", model, "--certificate", proof).refusal()
    assert run("solve", model, "--certify", "--certificate", proof).status == 0
    assert "5 (certified)" in run("verify", proof, model).out
    assert run("gradient", model, "--until", "home").refusal()  # without minimising: +∞
    for command in ("evaluate", "returns"):
        waits = run(command, "gymnasium:CliffWalking-v1", "always:0")
        assert (waits.status, waits.err) == (0, "")
        assert "mean is infinite" in waits.out
    for words in (
        ["gradient", model],
        ["threshold", model],
        ["curve", model, "--parameter", "reward.5"],
        ["explore", model, "--parameter", "reward.5", "--html", page],
    ):
        refused = run(*words).refusal()
        assert "some policy never ends" in refused
        assert "--discount 0.95" in refused
        assert run(*words, "--discount", "0.95").status == 0, words
    assert run("curve", model, "--parameter", "discount").status == 0


def test_fronts_weights_and_risks_take_questions(tmp_path: Path) -> None:
    """Time and energy until a goal: slow takes (3, 1), fast (1, 4); half of fast leaps ahead."""
    half, sure = "1/2", 1
    rows = [
        (0, 0, [(sure, 1, {"time": 3, "energy": 1})]),
        (0, 1, [(half, 1, {"time": 1, "energy": 4}), (half, 2, {"time": 1, "energy": 4})]),
        (1, 0, [(sure, 2, {"time": 3, "energy": 1})]),
        (2, 0, [(sure, 2, {"time": 9, "energy": 9})]),
    ]
    model = str(tmp_path / "way.npz")
    MDP.from_outcomes(rows, labels={"goal": {2}}, actions=["slow", "fast"]).save(model)
    words = ("--until", "goal", "--minimize")
    front = run("tradeoff", model, "time", "energy", *words, "--json").result
    assert [[*each["values"].values()] for each in front["vertices"]] == [
        ["5/2", "9/2"],
        ["6", "2"],
    ]
    assert run("tradeoff", model, "time", "energy", "--minimize").refusal()  # it goes on forever
    weights = run("rationalize", model, "always:slow", *words, "--json").result
    assert weights["change"] == "1/6"  # 7/2 times more time against 5/2 more energy
    risk = run("risk", model, "--cvar", "1/4", *words, "--json").result
    assert risk["value"] == "8"


def test_infinite_values_cause_no_warnings_of_other_packages(tmp_path: Path) -> None:
    done = run("solve yuan2025 --set tasks=[1] --set max_trial=2 --until skipped")
    assert "inf" in done.out
    assert "warning" not in done.err
    model = str(tmp_path / "stay.npz")
    rows = [(0, 0, [(1, 0, 1)]), (0, 1, [("1/2", 0, 1), ("1/2", 1, 1)]), (1, 0, [(1, 1, 0)])]
    MDP.from_outcomes(rows).save(model)
    words = ("train", model, "--seeds", "2", "--learner", "epochs=2")
    assert "the optimum is infinite" in run(*words).refusal()
    assert run(*words, "--discount", "0.95").status == 0


@pytest.mark.parametrize(
    ("rows", "start", "words", "message"),
    [
        ([(0, 0, [(1, 0, 1)]), (1, 0, [(1, 1, -1)])], {0: "1/2", 1: "1/2"}, [], "from another"),
        ([(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])], 0, HOME,
         "costs fall without end"),
    ],
)  # fmt: skip
@pytest.mark.parametrize("command", ["solve", "solve --certify", "check"])
def test_totals_that_nobody_has_are_refused_by_name(
    command: str, rows: list[Any], start: object, words: list[str], message: str, tmp_path: Path
) -> None:
    model = tmp_path / "m.npz"
    MDP.from_outcomes(rows, start=start, labels={"home": [False, True]}).save(model)
    policy = ["always:0"] * (command == "check")
    assert message in run(command, model, *policy, *words).refusal()


@pytest.fixture
def years(tmp_path: Path) -> str:
    """A model of which one row repeats each year."""
    path = str(tmp_path / "years.npz")
    rows = [[["9/10", "1/10"], [0, 1]]]
    MDP.from_arrays(rows, [1, 0], layout="ass", labels={"end": [1]}).save(path)
    return path


def test_the_kinds_of_sensitivity_take_a_horizon(years: str, tmp_path: Path) -> None:
    value, gained = 2.71, ["--horizon", "3"]
    for kind in ("tornado", "threshold", "robust", "gradient", "sobol --samples 2"):
        content = run(*kind.split(), years, *gained, "--json").result
        assert content["start_value"] == pytest.approx(value)
        assert content["horizon"] == 3
    name = ["--parameter", "reward.1"]
    for kind in ("curve", "one-way"):
        content = run(kind, years, *name, *gained, "--json").result
        assert content["start_value"] == pytest.approx(value)
    two = run("two-way", years, *name, "--parameter", "discount", *gained, "--json").result
    assert two["start_value"] == pytest.approx(value)
    drawn = run("psa", years, *gained, "--samples", "4", "--json").result
    assert len(drawn["drawn"]) == 1
    page = str(tmp_path / "page.html")
    assert run("explore", years, *name, *gained, "--html", page).status == 0
    scenario = run("gradient yuan2025 --set tasks=[1] --set max_trial=2 --horizon 1 --json").result
    assert scenario["horizon"] == 1


def test_psa_takes_a_horizon_where_it_refuses_an_unrolled_model(years: str, tmp_path: Path) -> None:
    unrolled = str(tmp_path / "unrolled.npz")
    MDP.load(years).within(3).save(unrolled)
    said = run("psa", unrolled, "--samples", "4").refusal()
    assert "alike at every time" in said
    assert "--horizon 20" in said
    assert run("psa", years, "--horizon", "20", "--samples", "4").status == 0


@pytest.mark.parametrize(
    "line",
    [
        "info {}", "tradeoff {} steps reward", "rationalize {} optimal", "train {} --seeds 1",
        "risk {} --cvar 1/2 --horizon 3", "convert {} moved.npz",
    ],
)  # fmt: skip
def test_whatever_reads_a_model_takes_a_start(
    line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Messages about a start name --start in each of these commands."""
    monkeypatch.chdir(tmp_path)
    MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0]).save("model.npz")
    assert run(line.format("model.npz"), "--start", 2).error().where == "--start"
    result = run(line.format("model.npz"), "--start", 1, "--json").result
    if "convert" in line:
        assert MDP.load("moved.npz").start == ((1, 1),)
    elif "info" in line:
        assert result["reachable"] == 1
    else:
        assert result["start"] == "1"


def test_no_policy_is_shown_where_all_are_infinitely_bad(tmp_path: Path) -> None:
    """Who may drown before a choice cannot do well; who drowns by choice does better or worse."""
    rows = [(0, a, [("1/2", 1, 1), ("1/2", 2, 1)]) for a in (0, 1)]
    rows += [(1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
    home = {"home": [False, True, False]}
    MDP.from_outcomes(rows, labels=home).save(tmp_path / "hopeless.npz")
    shown = run("solve", tmp_path / "hopeless.npz", *HOME)
    assert "policies cannot be compared" in shown.err
    assert "inf" in shown.out
    assert "optimal action" not in shown.out
    LAND.save(tmp_path / "land.npz")
    for words in (HOME, ("--until", "home")):  # 3 at best, +∞ at worst
        assert "optimal action" in run("solve", tmp_path / "land.npz", *words).out
