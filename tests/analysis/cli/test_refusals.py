"""What commands refuse, in the table beside this file: status 2, and a sentence with its fix."""

import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from cli_runner import ROOT, run
from made_models import forest
from refusal_tables import entries

from exact_mdp import MDP, save

SMALL = "yuan2025 --set tasks=[1] --set max_trial=2"
LAND = MDP.from_outcomes(
    [(0, 0, [("1/2", 1, 1), ("1/2", 2, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])],
    states=["here", "home", "sea"],
    labels={"home": [False, True, False], "dry": [True, True, False], "sea": [False, False, True]},
)
SHORT = {
    "NINES": "9" * 5000,
    " models/": f" {ROOT}/tests/golden/models/",
    " lake ": " gymnasium:FrozenLake-v1 --discount 0.9 ",
    " small": f" {SMALL}",
    " by ": " --confidence=.9 --by=off-policy --evidence=rewards=0,1 ",
    " records ": " --evidence=records=records.csv ",
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    place = tmp_path_factory.mktemp("refusals")
    rows = [(n, "ill", ("a", "b")[n % 2], n // 2 % 2, None) for n in range(80)]
    names = ["episode", "state", "action", "reward", "next_state"]
    pd.DataFrame(rows, columns=names).to_csv(place / "records.csv", index=False)
    text = (place / "records.csv").read_text("utf-8")
    (place / "bars.csv").write_text(text.replace(",", "|"), "utf-8")
    (place / "ward.csv").write_text(text.replace("state", "ward", 1), "utf-8")
    (place / "uncertain.toml").write_text('["base.angre"]\neffective_sample_size = 10\n')
    labels = [f"{s:04b}" for s in range(16)]
    lines = [f"{s}," + ",".join("1" if s == t else "0" for t in labels) for s in labels]
    (place / "seen.csv").write_text("\n".join(["status," + ",".join(labels), *lines]) + "\n")
    two = MDP.from_arrays([[[0, 1], [0, 1]], [[0, 1], [0, 1]]], [[1, 3], [0, 0]], layout="ass")
    models = {"land": LAND, "forest": forest("9/10"), "two": two}
    models["ill"] = MDP.from_transitions(place / "records.csv", "1/2")
    for name, mdp in models.items():
        save(mdp, place / f"{name}.npz")
    rows = [f"{label},none" for label in labels]
    for name, text in {
        "broken.toml": 'name = "broken',
        "missing.csv": "\n".join(["status,action", *rows[1:]]),
        "doubled.csv": "\n".join(["status,action", rows[0], *rows]),
        "action.json": json.dumps(dict.fromkeys(labels, "hug")),
        "broken.json": '{"0000": ',
        "truncated.json": '{"format": "exact-mdp certificate",',
        "unknown.xyz": "",
    }.items():
        (place / name).write_text(text, "utf-8")
    (place / "binary.toml").write_bytes(b"\xff\xfe\x00")
    (place / "broken.npz").write_bytes(b"PK\x03\x04 not an archive")
    np.save(place / "shape.npy", np.zeros((3, 3)))
    np.save(place / "zeros.npy", np.zeros((16, 4)))
    np.save(place / "nan.npy", np.full((16, 4), np.nan))
    for whole, part in (("forest.npz", "truncated.npz"), ("zeros.npy", "truncated.npy")):
        content = (place / whole).read_bytes()
        (place / part).write_bytes(content[: len(content) // 2])
    for name in ("folder.toml", "folder.npz"):
        (place / name).mkdir()
    return place


@pytest.mark.parametrize(("line", "said"), entries(__file__, BEYOND="<nan|1e400|1e999|NINES>"))
def test_a_command_of_the_table_is_refused(
    line: str, said: str, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = sorted(folder.iterdir())
    monkeypatch.chdir(folder)
    for short, whole in SHORT.items():
        line = line.replace(short, whole)
    assert said in run(line).refusal()
    assert sorted(folder.iterdir()) == before
