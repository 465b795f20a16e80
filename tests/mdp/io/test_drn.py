"""DRN files: Storm's are read, ours come back, and what is damaged is refused by its line."""

from __future__ import annotations

import re
import sys
import warnings
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
from cli_runner import run
from hypothesis import given, settings
from hypothesis import strategies as st
from named_models import models
from saved_models import MODELS

from exact_mdp import certify
from exact_mdp.mdp import MDP, ModelError
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.io import drn, storm
from exact_mdp.mdp.io.load import load, load_model, save_model
from exact_mdp.mdp.lazy import later

F = Fraction
# As Storm 2.0 writes it: tabs, comments with the variables, rewards of states and of choices.
WALK = """// Exported by storm
// Original model type: MDP
@type: MDP
@value_type: rational
@parameters

@reward_models
steps cost
@nr_states
3
@nr_choices
5
@model
state 0 [1/3, 0] init
//[!up\t& place=0]
\taction run [0, 1]
\t\t1 : 1/3
\t\t0 : 2/3
\taction jump [0, 5/2]
\t\t2 : 1/4
\t\t0 : 3/4
state 1 [1/3, 7] "half way"
//[!up\t& place=1]
\taction run [0, 1]
\t\t0 : 2/3
\t\t2 : 1/3
\taction jump [0, 5/2]
\t\t1 : 3/4
\t\t2 : 1/4
state 2 [0, 0] goal "half way"
//[ up\t& place=2]
\taction rest [0, 0]
\t\t2 : 1
"""
CHAIN = """@type: DTMC
@value_type: double
@placeholders
$half : 0.5
@nr_states
2
@model
state 0 init
 0 : $half
 1 : 0.5
state 1
 1 : 1
"""


def read(folder: Path, text: str, **options: object) -> MDP:
    (folder / "theirs.drn").write_text(text, encoding="utf-8")
    return drn.load(folder / "theirs.drn", **{"discount": 1, **options})


def test_a_file_of_storm(tmp_path: Path) -> None:
    mdp = read(tmp_path, WALK, reward="cost")
    assert (mdp.actions, mdp.name, mdp.n_pairs) == (("run", "jump", "rest"), "theirs", 5)
    assert mdp.table.row(0) == [(F(2, 3), 0, F(1)), (F(1, 3), 1, F(1))]
    assert mdp.reward.tolist() == [1, 2.5, 8, 9.5, 0]
    assert {name: on.tolist() for name, on in mdp.labels.items()} == {
        "half way": [False, True, True],
        "goal": [False, False, True],
    }
    assert mdp.space.label(1) == "state !up & place=1"
    with pytest.warns(UserWarning, match="steps, cost are added up"):
        both = read(tmp_path, WALK)
    costs = both.with_(sense="min")
    assert certify(costs.until("half way", "steps")).value[0] == 1  # 1/3 a step, a third get there
    with pytest.warns(UserWarning, match="states no discount"):
        read(tmp_path, WALK, discount=None, reward="cost")


def test_a_chain_with_placeholders(tmp_path: Path) -> None:
    chain = read(tmp_path, CHAIN)
    assert (chain.n_pairs, chain.reward.tolist()) == (2, [0, 0])
    assert chain.table.weight.dtype == np.float64
    exact = read(tmp_path, CHAIN.replace("@value_type: double\n", "").replace("0.5", "1/2"))
    assert exact.table.row(0) == [(F(1, 2), 0, 0), (F(1, 2), 1, 0)]


@pytest.mark.parametrize("name", MODELS)
def test_models_come_back(tmp_path: Path, name: str) -> None:
    """What is optimal is the same exactly, and so are discount, sense, names, labels, goal."""
    mdp, path = MODELS[name], tmp_path / "m.drn"
    save_model(mdp, path)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = load_model(path)
    assert fingerprint(again) == fingerprint(mdp)
    for part in ("space", "actions", "name", "start", "sense", "parameters", "component_names"):
        assert getattr(again, part) == getattr(mdp, part), part
    assert again.component_table == mdp.component_table
    assert {k: v.tolist() for k, v in again.labels.items()} == {
        k: v.tolist() for k, v in mdp.labels.items()
    }


@settings(max_examples=40, deadline=None)
@given(mdp=models(), ending=st.sampled_from(["npz", "umb"]))
def test_there_and_back(tmp_path_factory: pytest.TempPathFactory, mdp: MDP, ending: str) -> None:
    """Through text and an archive, every expected number is the same."""
    folder = tmp_path_factory.mktemp("drn")
    save_model(mdp, folder / "a.drn")
    save_model(load_model(folder / "a.drn"), folder / f"b.{ending}")
    again = load_model(folder / f"b.{ending}")
    assert fingerprint(again) == fingerprint(mdp)
    assert list(again.labels) == list(mdp.labels)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("@type: MDP", "@type: CTMC", r"@type is 'CTMC'(.|\n)*DTMC or MDP"),
        ("rational", "parametric", r"@value_type is 'parametric'(.|\n)*no parameters"),
        ("@nr_choices\n5", "@nr_choices\n6", "@nr_choices is 6, the model has 5"),
        ("@model\n", "", "there is no line @model"),
        ("@parameters\n", "@type: MDP\n", "@type comes twice"),
        ("state 1 ", "state 2 ", r"state 2 is out of order(.|\n)*line 22(.|\n)*number it 1"),
        ("2 : 1\n", "7 : 1\n", "leads to state 7 of 3"),
        ("1 : 1/3", "1 : 1/x", r"1/x(.|\n)*line 17"),
        ("1 : 1/3", "1 1/3", r"'1 1/3' is no part of a model(.|\n)*line 17"),
        ("1 : 1/3", "1 : $third", r"unknown placeholder \$third(.|\n)*line 17"),
        ("1 : 1/3", "1 : 1/4", r"sum to 0\.916666666667, not 1"),
        ("[0, 1]", "[0, 1", r"a bracket is not closed(.|\n)*line 16"),
    ],
)
def test_files_that_are_no_model(tmp_path: Path, old: str, new: str, message: str) -> None:
    assert old in WALK
    with pytest.raises(ModelError, match=message):
        read(tmp_path, WALK.replace(old, new, 1), reward="cost")


def test_a_file_of_ours_that_another_program_changed(tmp_path: Path) -> None:
    save_model(MODELS["floats"], tmp_path / "m.drn")
    text = (tmp_path / "m.drn").read_text(encoding="utf-8")
    with pytest.raises(ModelError, match="changed the names of the actions"):
        read(tmp_path, text.replace("action stay", "action leave"))
    with pytest.raises(ModelError, match="changed the initial states"):
        read(tmp_path, text.replace("state 1 init", "state 1"))
    without = re.sub("// exact-mdp .*\n", "", text).replace("state 1 init", "state 1")
    assert read(tmp_path, without).discount == 1  # its own rule: what the format holds


def test_convert_on_the_command_line(tmp_path: Path) -> None:
    (tmp_path / "walk.drn").write_text(WALK, encoding="utf-8")
    source, names = str(tmp_path / "walk.drn"), [str(tmp_path / f"m.{e}") for e in ("npz", "umb")]
    for target in (*names, str(tmp_path / "again.drn")):
        words = ("convert", source + "#cost", target, "--discount", "1", "--json")
        assert run(*words).result["written"] == target
    hashes = [run("info", name, "--json").result for name in names]
    assert {each["model_hash"] for each in hashes} == {hashes[0]["model_hash"]}
    assert hashes[0]["labels"] == {"half way": 2, "goal": 1}
    failed = run("convert", source, str(tmp_path / "m.txt"))
    assert (failed.status, failed.out) == (2, "")


def test_without_storm_the_error_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "stormpy", None)
    monkeypatch.setattr(storm, "stormpy", later("stormpy"))
    (tmp_path / "m.prism").write_text("mdp", encoding="utf-8")
    with pytest.raises(ModelError, match=r"exact-mdp\[storm\]"):
        load_model(tmp_path / "m.prism")
    failed = run(
        "convert", str(tmp_path / "m.prism"), str(tmp_path / "m.umb"), "--constants", "N=4"
    )
    assert (failed.status, failed.out) == (2, "")
    assert "exact-mdp[storm]" in failed.err
    with pytest.raises(ModelError, match="has no constants"):
        load("yuan2025", constants="N=4")
