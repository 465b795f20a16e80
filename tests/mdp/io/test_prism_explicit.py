"""Explicit files of PRISM become the model that they list."""

from pathlib import Path

import pytest

from exact_mdp import ModelError, certify, load

TRA = "3 4 6\n0 0 1 0.5 go\n0 0 2 0.5 go\n0 1 0 0.1 stay\n0 1 1 0.9 stay\n1 0 1 1\n2 0 0 1\n"
LAB = '0="init" 1="deadlock" 2="goal"\n0: 0\n1: 2\n'
STA = "(x,done)\n0:(0,false)\n1:(7,true)\n2:(-1,false)\n"


def write(folder: Path, **files: str) -> Path:
    for name, text in files.items():
        stem, _, ending = name.rpartition("_")
        (folder / f"{stem or 'walk'}.{ending}").write_text(text, "utf-8")
    return folder / "walk.tra"


def test_all_files_together(tmp_path: Path) -> None:
    path = write(
        tmp_path, tra=TRA, lab=LAB, sta=STA, walk1_srew="3 1\n2 4\n",
        walk2_trew="3 4 1\n0 0 2 3\n", other_srew="3 1\n0 100\n",
    )  # fmt: skip
    with pytest.warns(UserWarning, match="reward1, reward2 are added up"):
        mdp = load(path)
    assert (mdp.name, mdp.n_states, mdp.n_pairs, mdp.start) == ("walk", 3, 4, ((0, 1),))
    assert mdp.actions == ("go", "stay", "unnamed")
    assert mdp.space.labels(range(3)) == [
        "state x=0, done=false", "state x=7, done=true", "state x=-1, done=false",
    ]  # fmt: skip
    assert mdp.labels["goal"].tolist() == [False, True, False]
    # Going earns 3 half of the time, and then 4 on the way back: 7/2 for each half, or 7 in all.
    assert certify(mdp.until("goal")).start_value == 7
    assert certify(mdp.earning("reward1").until("goal")).start_value == 4
    assert certify(mdp.earning("reward2").until("goal")).start_value == 3
    assert certify(mdp.reaching("done & x>5")).start_value == 1


def test_transitions_alone_and_a_chain(tmp_path: Path) -> None:
    chain = load(write(tmp_path, tra="2 3\n0 0 0.25\n0 1 0.75\n1 1 1\n"), discount="1/2", start=1)
    assert (chain.n_pairs, chain.start, chain.discount) == (2, ((1, 1),), 0.5)
    assert chain.labels.keys() == {"init"}
    assert not chain.reward.any()
    write(tmp_path, trew="2 1\n0 1 8\n")
    assert load(tmp_path / "walk.tra").reward.tolist() == [6, 0]
    # walk1.srew belongs to walk1.tra, if there is such a model.
    write(tmp_path, walk1_srew="2 1\n0 100\n", walk1_tra="1 1\n0 0 1\n")
    assert load(tmp_path / "walk.tra").reward.tolist() == [6, 0]


@pytest.mark.parametrize(
    ("files", "place", "said"),
    [
        ({"tra": "3\n"}, "walk.tra, line 1", "other than 2 or 3 numbers"),
        ({"tra": ""}, "walk.tra, line 1", "other than 2 or 3 numbers"),
        ({"tra": "2 1\n0 5 1\n"}, "walk.tra, line 2", "'5' is not a number below 2"),
        ({"tra": "2 1\n0 1\n"}, "walk.tra, line 2", "3 values"),
        ({"tra": "2 1\n0 1 much\n"}, "walk.tra, line 2", "'much' is not a number"),
        ({"tra": "20000000 2\n0 0 1\n"}, "walk.tra, line 1", "2 transitions are announced, and 1"),
        ({"tra": TRA.replace("3 4 6", "3 5 6")}, "walk.tra, line 1", "5 choices are announced"),
        ({"tra": TRA, "srew": ""}, "walk.srew, line 1", "begin with 3 states"),
        ({"tra": TRA, "rew": "0 1"}, "walk.rew", "no reward file of PRISM"),
        ({"tra": TRA, "srew": "9 1\n0 1\n"}, "walk.srew, line 1", "begin with 3 states"),
        ({"tra": TRA, "srew": "3 1\n1\n"}, "walk.srew, line 2", "1 values, not 2"),
        ({"tra": TRA, "trew": "3 4 1\n0\n"}, "walk.trew, line 2", "1 values, not 4"),
        ({"tra": TRA, "lab": '0="init"\n0: 1\n'}, "walk.lab, line 2", "label 1 has no name"),
        ({"tra": TRA, "sta": "(x)\n0:(1,2)\n"}, "walk.sta, line 2", "2 values of 1 variables"),
        ({"tra": TRA, "srew": "3 1\n9 1\n"}, "walk.srew, line 2", "'9' is not a number below 3"),
        ({"tra": TRA, "trew": "3 4 1\n1 0 2 3\n"}, "walk.trew, line 2", "no such transition"),
    ],
)
def test_broken_files_are_refused(
    tmp_path: Path, files: dict[str, str], place: str, said: str
) -> None:
    with pytest.raises(ModelError, match=said) as refusal:
        load(write(tmp_path, **files))
    assert refusal.value.where.endswith(place)
