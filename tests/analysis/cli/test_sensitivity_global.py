"""The kinds sobol, morris and structural of the command, their figures, and what they refuse."""

from __future__ import annotations

import io
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest
from cli_runner import run

from exact_mdp.analysis.cli import commands
from exact_mdp.analysis.cli.sensitivity import KINDS
from exact_mdp.analysis.plots.sensitivity import plot_morris, plot_sobol
from exact_mdp.analysis.plots.style import style
from exact_mdp.analysis.sensitivity.draws.global_ import morris, sobol
from exact_mdp.mdp import ModelError, Scenario

SET = ("--set", "tasks=[1]", "--set", "max_trial=2")
HELD = ("--policy", "always:directive")


@pytest.fixture(autouse=True)
def _no_display() -> Iterator[None]:
    with mpl.rc_context({"backend": "Agg"}):
        yield


def ask(kind: str, *words: object) -> dict[str, Any]:
    return run("sensitivity", "yuan2025", kind, *SET, "--json", *words).result


def test_sobol_tells_of_value_and_regret() -> None:
    found = ask("sobol", *HELD, "--samples", 16)
    names = set(found["first_order"])
    assert {"base.anger", "reward.subtask-complete"} <= names
    assert "assistance.supportive.anger.onset" in found["without_range"]
    assert names | set(found["without_range"]) == set(Scenario.load("yuan2025").names)
    assert (found["claim"], found["seed"], found["confidence"]) == ("estimated", 0, 0.95)
    assert found["draws"] == 16 * (len(names) + 2)
    for each in (found, found["regret"]):
        assert set(each["total"]) == names
        for kind in ("first_order", "total"):
            for name, (low, high) in each[f"{kind}_interval"].items():
                assert low <= each[kind][name] <= high
    expected = sobol(
        Scenario.load("yuan2025").with_(tasks=[1], max_trial=2),
        policy="always:directive",
        n=16,
        rng=0,
    )
    assert found["total"] == dict(zip(expected.names, expected.optimal.total.tolist(), strict=True))
    assert found["regret"]["mean"] == expected.regret.mean > 0


@pytest.mark.parametrize("kind, samples", [("sobol", 8), ("morris", 4)])
def test_the_discount_is_held_unless_it_is_named(kind: str, samples: int) -> None:
    words = ("sensitivity", "yuan2025", kind, *SET, "--samples", samples)
    default = run(*words, "--relative", "0.1")
    assert "held; vary it with --parameter discount" in default.out
    named = run(*words, "--parameter", "discount", "--parameter", "base.anger")
    assert "held; vary it" not in named.out
    shares = "total" if kind == "sobol" else "mu_star"
    stated = run(*words, "--range", "discount=0.9:1", "--json").result
    assert list(stated[shares]) == ["discount"]


def test_first_orders_above_the_total_are_called_noise() -> None:
    names = ("base.anger", "reward.anger", "reward.timestep", "base.forgetfulness")
    words = ("sensitivity", "yuan2025", "sobol", *SET, "--samples", 8)
    words = (*words, *(word for name in names for word in ("--parameter", name)))
    found, text = run(*words, "--json").result, run(*words).out
    assert any(found["first_order"][name] > found["total"][name] for name in names)
    assert "first order above total" in text


def test_the_same_seed_gives_the_same_words() -> None:
    words = ("--samples", 16, "--parameter", "base.anger", "--parameter", "reward.anger")
    first = ask("sobol", *words)
    assert ask("sobol", *words, "--seed", 0, "--n-jobs", 1) == first
    assert ask("sobol", *words, "--seed", 1)["total"] != first["total"]


def test_a_regret_of_nothing_has_no_indices() -> None:
    found = ask("sobol", "--samples", 4, "--parameter", "reward.subtask-complete")
    assert found["regret"]["total"] == {"reward.subtask-complete": None}
    text = run("sensitivity", "yuan2025", "sobol", *SET, "--samples", 4, "--parameter", "discount")
    assert text.status == 0
    assert "shares of the variance of the start value" in text.out


def test_morris_tells_of_value_and_regret(tmp_path: Path) -> None:
    words = (*HELD, "--samples", 6, "--out", tmp_path / "kept")
    found = ask("morris", *words)
    assert found["trajectories"] == 6
    assert found["draws"] == 6 * (len(found["mu_star"]) + 1)
    assert found["mu_star"]["reward.subtask-complete"] == pytest.approx(
        found["mu"]["reward.subtask-complete"]
    )
    low, high = found["sigma_interval"]["base.anger"]
    assert low < found["sigma"]["base.anger"] < high
    assert found["regret"]["mu_star"]["base.anger"] > 0
    assert [Path(path).name for path in found["written"]] == ["morris.json", "run.json"]
    assert json.loads((tmp_path / "kept" / "morris.json").read_text()) == found
    assert json.loads((tmp_path / "kept" / "run.json").read_text())["seed"] == 0
    assert ask("morris", *words) == found
    other = run("sensitivity", "yuan2025", "morris", *SET, *words, "--seed", 1)
    assert other.status == 2
    assert "differs in" in other.err
    text = run("sensitivity", "yuan2025", "morris", *SET, *HELD, "--samples", 4)
    assert "elementary effects on the regret" in text.out


def test_structural_sets_readings_side_by_side() -> None:
    found = ask("structural", *HELD, "--set", "readings.skip_onset=base", "--n-jobs", 1)
    labels = [each["reading"] for each in found["readings"]]
    assert labels[0] == "as it is"
    assert {"skip_onset = none", "max_trial_rule = after", "tasks = [3, 1]"} <= set(labels)
    for each in found["readings"]:
        held = each["policies"]["always:directive"]
        assert each["start_value"] - held["value"] == pytest.approx(held["regret"], abs=1e-9)
        lost = each["policies"]["optimum as it is"]["regret"]
        assert each["optimum_changes"] == (lost > 0) >= bool(each["changed_at_subtask_0_trial_0"])
        assert len(each["actions"]) == 16
        assert each["top_parameter"]
    again = run("solve", "yuan2025", *SET, "--set", "readings.skip_onset=base", "--json").result
    assert found["start_value"] == pytest.approx(again["start_value"])


def test_the_regret_of_a_policy_has_a_tornado() -> None:
    names = ("--parameter", "base.anger", "--parameter", "discount")
    words = ("sensitivity", "yuan2025", "tornado", *SET, *HELD, *names)
    found = run(*words, "--json").result
    assert found["regret"] == pytest.approx(found["start_value"] - found["policy_value"])
    for bar in found["bars"]:
        for end in ("low", "high"):
            lost = bar[f"value_{end}"] - bar[f"fixed_value_{end}"]
            assert bar[f"regret_{end}"] == pytest.approx(lost, abs=1e-9)
    assert "regret of the policy held fixed at both ends" in run(*words).out


def test_a_saved_model_has_a_discount_to_vary(tmp_path: Path) -> None:
    file = tmp_path / "lake.npz"
    words = ("convert", "gymnasium:FrozenLake-v1", file, "--discount", "0.9")
    pytest.importorskip("gymnasium")
    assert run(*words).status == 0
    found = run(
        "sensitivity",
        file,
        "sobol",
        "--samples",
        32,
        "--n-jobs",
        1,
        "--relative",
        "0.05",
        "--json",
        "--parameter",
        "discount",
    ).result
    assert found["total"]["discount"] == pytest.approx(1, abs=0.2)
    refused = run("sensitivity", file, "structural")
    assert refused.status == 2
    assert "readings belong to care scenarios" in refused.err


def test_a_cluster_changes_nothing() -> None:
    words = ("--samples", 16, "--parameter", "base.anger", "--parameter", "discount")
    alone = ask("sobol", *words)
    import distributed

    with distributed.LocalCluster(
        n_workers=1,
        processes=False,  # those are tried where the clusters are
        protocol="tcp",
        host="127.0.0.1",
        dashboard_address="127.0.0.1:0",
        silence_logs=50,
    ) as cluster:
        assert ask("sobol", *words, "--scheduler", cluster.scheduler_address) == alone


@pytest.mark.parametrize(
    "words, message",
    [
        (("sobol", "--samples", "0"), "'0' is not a whole number from 2"),
        (("sobol", "--samples", "1"), "'1' is not a whole number from 2"),
        (("sobol", "--samples", "1000"), "not a power of 2"),
        (("sobol", "--samples", "many"), "'many' is not a whole number"),
        (("psa", "--samples", "0"), "0"),
        (("robust", "--samples", "5"), "--samples does not apply to robust"),
        (("morris", "--samples", "0"), "'0' is not a whole number from 2"),
        (("sobol", "--seed", "-1"), "--seed"),
        (("sobol", "--n-jobs", "0"), "--n-jobs"),
        (("sobol", "--parameter", "base.angre"), "did you mean base.anger?"),
        (("morris", "--range", "base.anger=0.2:0.1"), "empty"),
        (("morris", "--range", "base.anger=0.2:0.2"), "empty"),
        (("sobol", "--range", "base.anger=0.2:1.2"), "outside [0, 1]"),
        (("sobol", "--range", "base.anger"), "is not a range"),
        (("sobol", "--parameter", "assistance.supportive.anger.onset"), "gives no range"),
        (("sobol", "--policy", "always:nothing"), "nothing"),
        (("sobol", "--out", " "), "--out is empty"),
        (("sobol", "--combined"), "--combined does not apply to sobol"),
        (("tornado", "--samples", "5"), "--samples does not apply to tornado"),
        (("gradient", "--seed", "1"), "--seed does not apply to gradient"),
        (("sobol", "--radius", "1"), "it applies to robust"),
        (("morris", "--effective-sample-size", "1"), "it applies to psa"),
        (("structural", "--set-kind", "l1"), "it applies to robust"),
        (("structural", "--relative", "0.1"), "it changes readings, which have no ranges"),
        (("structural", "--parameter", "base.anger"), "it changes readings, which have no ranges"),
        (("structural", "--policy", "missing.json"), "missing.json"),
    ],
)
def test_what_cannot_be_done_is_refused_with_the_reason(
    words: tuple[str, ...], message: str
) -> None:
    done = run("sensitivity", "yuan2025", *words, *SET)
    assert done.status == 2
    assert done.out == ""
    assert message in done.err


def test_every_option_that_a_kind_does_not_use_is_refused() -> None:
    """All kinds and all options; a new kind or option is in the loop without being named here."""
    shared = {"model", "kind", "sets", "discount", "as_json"}
    options = [each for each in commands.sensitivity.params if each.name not in shared]
    assert {each.name for each in options} >= set().union(*(k.uses for k in KINDS.values()))
    refused = 0
    for kind, used in KINDS.items():
        for option in options:
            assert any(option.name in each.uses for each in KINDS.values())
            if option.name in used.uses:
                continue
            name = max(option.opts, key=len)
            value = [] if option.is_flag else ["l1" if name == "--set-kind" else "1"]
            done = run("sensitivity", "tea", kind, name, *value)
            assert (done.status, done.out) == (2, "")
            assert done.err.startswith(f"ModelError: {name} does not apply to {kind}")
            assert "leave it out; it applies to " in done.err
            refused += 1
    assert refused > 50


def test_a_scheduler_that_does_not_answer_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exact_mdp.solvers.parallel.cluster.ANSWER_WITHIN", 0.5)
    words = ("--samples", "4", "--parameter", "discount", "--scheduler", "tcp://127.0.0.1:1")
    done = run("sensitivity", "yuan2025", "sobol", *SET, *words)
    assert done.status == 2
    assert "no scheduler answers" in done.err


# ---- figures -------------------------------------------------------------------------------------


def test_figures() -> None:
    import matplotlib.pyplot as plt

    scenario = Scenario.load("yuan2025").with_(tasks=[1], max_trial=2)
    names = ["base.anger", "discount", "reward.anger"]
    indices = sobol(scenario, policy="always:directive", names=names, n=16, rng=0)
    effects = morris(scenario, policy="always:directive", names=names, n=4, rng=0)
    with style():
        for output in ("optimal", "fixed", "regret"):
            for found, draw in ((indices, plot_sobol), (effects, plot_morris)):
                figure, ax = plt.subplots()
                assert draw(found, output=output, ax=ax) is ax
                assert "(reward per range)" in ax.get_xlabel() or ax.get_xlabel().startswith(
                    "share"
                )
                figure.savefig(io.BytesIO())
                plt.close(figure)
    ax = plot_sobol(indices, most=2)
    total = dict(zip(indices.names, indices.optimal.total, strict=True))
    widths = [patch.get_width() for patch in ax.patches]
    assert widths[2:] == sorted(total.values(), reverse=True)[:2]
    assert ax.get_yticklabels()[0].get_text().startswith(max(total, key=total.__getitem__))
    plt.close(ax.figure)
    nothing = sobol(scenario, names=["reward.subtask-complete"], n=4, rng=0)
    with pytest.raises(ModelError, match="the same at every draw"):
        plot_sobol(nothing, output="regret")
    plt.close("all")
