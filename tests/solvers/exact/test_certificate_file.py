"""Certificates saved and read: nothing is lost, and no file does worse than raise ModelError."""

import json
import subprocess
import sys
from fractions import Fraction as F
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import pytest
from certificates import MODELS, certified
from strategies import model_of

import exact_mdp
from exact_mdp import MDP, BoundedCertificate, Certificate, ModelError, certify, fingerprint

NAMES = ["acyclic", "cycle", "waiting"]


def same(first: Any, second: Any) -> None:
    assert type(first) is type(second)
    with TemporaryDirectory() as folder:
        for name, each in (("first", first), ("second", second)):
            each.save(Path(folder) / name)
        texts = {path.read_text("utf-8") for path in Path(folder).iterdir()}
    assert len(texts) == 1


@pytest.mark.parametrize("name", MODELS)
def test_what_is_saved_is_read(name: str, tmp_path: Path) -> None:
    path, mdp = tmp_path / "proof.json", MODELS[name]
    certified(name).save(path)
    read = Certificate.load(path)
    same(read, certified(name))
    assert read.violations(mdp) == []
    with pytest.raises(ModelError, match="does not contain the model"):
        read.violations()
    bounded = certify(mdp, bounded=True)
    bounded.save(path)
    again = BoundedCertificate.load(path)
    same(again, bounded)
    assert again.violations(mdp) == []


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


def test_integers_of_more_digits_than_python_prints(tmp_path: Path) -> None:
    """Python neither reads nor writes more than 4,300 decimal digits."""
    reward = F(10**6000 + 1, 7**7000)
    mdp = model_of(2, [(0, 0, reward, {1: F(1)}), (1, 0, F(0), {1: F(1)})], F(1))
    optimum = certify(mdp)
    assert optimum.start_value == reward
    assert optimum.violations() == []
    with pytest.raises(ValueError, match=str(sys.get_int_max_str_digits())):
        str(optimum.h.top[0])
    path = tmp_path / "proof.json"
    optimum.save(path)
    read = Certificate.load(path)
    same(read, optimum)
    assert read.violations(mdp) == []
    assert read.value[0] == reward
    assert "start value" in repr(read)


def test_each_kind_is_read_as_such(tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    certified("cycle").save(path)
    with pytest.raises(ModelError, match="kind is 'total', not 'bounds'"):
        BoundedCertificate.load(path)
    with pytest.raises(ModelError, match="cannot read"):
        Certificate.load(tmp_path / "other.json")


LEVEL = {"top": ["0x0"] * 4, "below": ["0x1"], "group": [0] * 4}
BAD: dict[str, list[Any]] = {
    "format": ["other", None, 1],
    "version": [1, "2", None, True],
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


CHECKER = Path(exact_mdp.__file__).parent / "solvers" / "exact" / "checker.py"


def alone(model: Path, certificate: Path) -> tuple[int, str]:
    """Run the checker without the package; return its status and what it says."""
    words = [sys.executable, "-I", str(CHECKER), str(model), str(certificate)]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    return done.returncode, done.stdout + done.stderr


def test_a_start_that_mixes_both_infinities_has_no_value(tmp_path: Path) -> None:
    """The proof of one start is none of the other, whatever start value is written into it."""
    rows = [(0, 0, [(1, 0, 1)]), (1, 0, [(1, 1, -1)])]
    one = MDP.from_outcomes(rows)
    both = one.with_(start={0: "1/2", 1: "1/2"})
    with pytest.raises(ModelError, match="from one state of the start"):
        certify(both)
    one.save(tmp_path / "one.json")
    both.save(tmp_path / "both.json")
    certify(one).save(tmp_path / "proof.json")
    assert alone(tmp_path / "one.json", tmp_path / "proof.json") == (0, "holds\n")
    proof = json.loads((tmp_path / "proof.json").read_text("utf-8"))
    for value in ("0x0/0x1", "inf", "-inf"):
        forged = proof | {"model": fingerprint(both), "start_value": value}
        (tmp_path / "forged.json").write_text(json.dumps(forged), "utf-8")
        status, said = alone(tmp_path / "both.json", tmp_path / "forged.json")
        assert (status, "start value" in said) == (1, True)


def test_files_that_are_none_are_not_checked(tmp_path: Path) -> None:
    MDP.from_outcomes([(0, 0, [(1, 0, 0)])]).save(tmp_path / "model.json")
    for content in ('["exact-mdp certificate", 2]', "[]", "1", "{}", "no JSON"):
        (tmp_path / "proof.json").write_text(content, "utf-8")
        status, said = alone(tmp_path / "model.json", tmp_path / "proof.json")
        assert (status, said.startswith("not checked: ")) == (2, True)


def test_numbers_of_any_length_are_checked_alike_in_memory_and_in_files(tmp_path: Path) -> None:
    """Rewards of one pair differ, as fractions; a state comes twice; integers are beyond 2^53."""
    few = F(1, 2**60 + 1)
    mdp = MDP.from_outcomes(
        [
            (0, 0, [("1/3", 1, "1/7"), ("1/3", 0, f"{2**70}/3"), ("1/3", 0, "2/7")]),
            (1, 0, [(1 - few, 1, 0.1), (few, 0, "5/7")]),
        ],
        "1/2",
    )
    certificate, path = certify(mdp), tmp_path / "model.json"
    mdp.save(path)
    certificate.save(tmp_path / "proof.json")
    assert fingerprint(MDP.load(path)) == fingerprint(mdp)
    assert certificate.violations() == certificate.violations(MDP.load(path)) == []
    assert Certificate.load(tmp_path / "proof.json").violations(mdp) == []
