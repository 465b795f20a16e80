"""Certificates saved and read: nothing is lost, and no file does worse than raise ModelError."""

import json
import sys
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import pytest
from certified_models import MODELS, certified
from strategies import model_of

from exact_mdp import MDP, BoundedCertificate, Certificate, ModelError, certify, fingerprint

LONG, FEW = F(10**6000 + 1, 7**7000), F(1, 2**60 + 1)
KEPT: dict[str, MDP] = MODELS | {
    # Python neither reads nor writes more than 4,300 decimal digits
    "long": model_of(2, [(0, 0, LONG, {1: F(1)}), (1, 0, F(0), {1: F(1)})], F(1)),
    # rewards of one pair differ, as fractions; a state comes twice; integers are beyond 2^53
    "joint": MDP.from_outcomes(
        [
            (0, 0, [("1/3", 1, "1/7"), ("1/3", 0, f"{2**70}/3"), ("1/3", 0, "2/7")]),
            (1, 0, [(1 - FEW, 1, 0.1), (FEW, 0, "5/7")]),
        ],
        "1/2",
    ),
}


def same(first: Any, second: Any, folder: Path) -> None:
    assert type(first) is type(second)
    for name, each in (("first", first), ("second", second)):
        each.save(folder / name)
    assert (folder / "first").read_bytes() == (folder / "second").read_bytes()


@pytest.mark.parametrize("name", KEPT)
def test_what_is_saved_is_read(name: str, tmp_path: Path) -> None:
    path, mdp = tmp_path / "proof.json", KEPT[name]
    mdp.save(tmp_path / "model.json")
    again = MDP.load(tmp_path / "model.json")
    assert fingerprint(again) == fingerprint(mdp)
    for kind, made in ((Certificate, certify(mdp)), (BoundedCertificate, None)):
        if made is None and name == "long":  # its value is beyond the floats
            continue
        made = made or certify(mdp, bounded=True)
        made.save(path)
        read = kind.load(path)
        same(read, made, tmp_path)
        assert read.violations(mdp) == read.violations(again) == []
        with pytest.raises(ModelError, match="does not contain the model"):
            read.violations()


def test_a_value_of_more_digits_than_python_prints_is_shown() -> None:
    optimum = certify(KEPT["long"])
    assert optimum.start_value == LONG
    with pytest.raises(ValueError, match=str(sys.get_int_max_str_digits())):
        str(optimum.h.top[0])
    assert "start value" in repr(optimum)


def test_the_file_is_what_is_documented(tmp_path: Path) -> None:
    """Read as any program would, by the description of the format alone."""
    path = tmp_path / "proof.json"
    optimum, mdp = certified("cycle"), MODELS["cycle"]
    optimum.save(path)
    data = json.loads(path.read_text("utf-8"))
    assert data["model"] == fingerprint(mdp)
    level = data["h"]
    below = [int(level["below"][group], 16) for group in level["group"]]
    value = [F(int(a, 16), b) for a, b in zip(level["top"], below, strict=True)]
    assert value == list(optimum.value)
    assert F(*(int(part, 16) for part in data["start_value"].split("/"))) == optimum.start_value
    assert (data["policy"], data["unique"]) == (optimum.policy.tolist(), optimum.unique)
    assert [data[key] for key in ("g", "w", "infinite", "order")] == [None] * 4


LEVEL = {"top": ["0x0"] * 4, "below": ["0x1"], "group": [0] * 4}
BAD: dict[str, list[Any]] = {
    "format": ["other", None, 1],
    "version": [1, 2.0, "2", None, True],
    "kind": ["bounds", 0, None],
    "model": [5, None],
    "sense": [1, None],
    "policy": [[0, 0, 1.0], [0, True], "0000", 7, [10**30] * 4, None],
    "g": ["0x0", [0], LEVEL | {"top": "0x0"}, LEVEL | {"more": 1}],
    "h": [None, LEVEL | {"top": [1] * 4}, LEVEL | {"below": ["1"]}, LEVEL | {"top": ["0x01"] * 4}],
    "w": [LEVEL | {"top": ["+0x1"] * 4}, LEVEL | {"top": [" 0x1"] * 4}, LEVEL | {"group": ["0"]}],
    "rank": ["1", [0, 0, 0, None], {}],
    "infinite": [[0, 0.5], 1],
    "order": ["1", [True]],
    "start_value": ["0x1", "0x1/0x0", "0x1/-0x2", "1/2", 0.5, ["0x1", "0x1"], "nan", None, 1],
    "unique": [1, "true", None],
}


@pytest.mark.parametrize("key", BAD)
def test_damage_is_named(key: str, tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    certified("cycle").save(path)
    data = json.loads(path.read_text("utf-8"))
    assert set(BAD) == set(data)
    for value in (*BAD[key], ...):
        changed = {k: v for k, v in data.items() if k != key}
        if value is not ...:
            changed[key] = value
        path.write_text(json.dumps(changed), "utf-8")
        with pytest.raises(ModelError) as caught:
            Certificate.load(path)
        assert str(path) in caught.value.where
        assert caught.value.fix
    path.write_text(json.dumps(data)[:-1] + ', "unique": true}', "utf-8")
    with pytest.raises(ModelError, match="'unique' is written twice"):
        Certificate.load(path)
