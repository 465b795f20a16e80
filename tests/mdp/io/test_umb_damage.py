"""UMB files that are damaged, or lie about their size: each is refused in so many words."""

from __future__ import annotations

import gzip
import sys
from pathlib import Path

import pytest
from laws import laws
from umb_files import MODELS, archive_of, members_of

from exact_mdp.mdp import ModelError
from exact_mdp.mdp.io import umb, umb_read
from exact_mdp.mdp.lazy import later


def test_files_cut_short_or_left_out(tmp_path: Path) -> None:
    umb.save(MODELS["care"], tmp_path / "good.umb")
    members, path = members_of(tmp_path / "good.umb"), tmp_path / "bad.umb"
    path.write_bytes(archive_of(members))
    assert laws(umb.load(path)) == laws(MODELS["care"])
    optional = ("valuations/", "annotations/aps", "annotations/rewards/component", "strings")
    for name in members:
        if any(part in name for part in optional) or "string-mapping" in name:
            continue
        for data in (members[name][:-8], b""):
            path.write_bytes(archive_of(members | {name: data}))
            with pytest.raises(ModelError) as caught:
                umb.load(path)
            assert str(path) in caught.value.where
            assert caught.value.fix
    content = (tmp_path / "good.umb").read_bytes()
    for length in range(0, len(content), len(content) // 40):
        path.write_bytes(content[:length])
        with pytest.raises(ModelError):
            umb.load(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('"#states": 33', '"#states": 34', "values"),
        ('"#states": 33', '"#states": 18446744073709551615', "the index claims"),
        ('"#choices": 129', '"#choices": 99999999999', "the index claims"),
        ('"#choices": 129', '"#choices": 128', "values"),
        ('"#states": 33', '"#states": -1', "damaged"),
        ('"#states": 33', '"#states": "many"', "damaged"),
        ('"#states": 33,', "", "damaged"),
        ('"type": "rational"', '"type": "complex"', "damaged"),
        ('"#choice-actions": 4', '"#choice-actions": 3', "actions"),
        ("{", "[" * 50000, "damaged"),
    ],
)
def test_indices_that_lie(tmp_path: Path, old: str, new: str, message: str) -> None:
    umb.save(MODELS["care"], tmp_path / "good.umb")
    members, path = members_of(tmp_path / "good.umb"), tmp_path / "bad.umb"
    index = members["index.json"].decode()
    assert old in index
    members["index.json"] = index.replace(old, new, 1).encode()
    path.write_bytes(archive_of(members))
    with pytest.raises(ModelError) as caught:
        umb.load(path)
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("name", "place", "value", "message"),
    [
        ("branch-to-target.bin", 0, 33, "leads to state 33 of 33"),
        ("branch-to-target.bin", 0, 2**63, "leads to state"),
        ("branch-to-probability.bin", 0, 2**62, "sum to"),
        ("branch-to-probability.bin", 0, 2**64 - 1, "a probability is"),
        ("branch-to-probability.bin", 8, 0, "damaged"),
        ("state-to-choices.bin", 8, 2**40, "offsets that do not run"),
        ("choice-to-branches.bin", 8, 2**40, "offsets that do not run"),
        ("choice-to-branches.bin", 8, 0, "sum to 0, not 1"),
        ("actions/choices/values.bin", 0, 9, "an action beyond"),
    ],
)
def test_numbers_that_make_no_model(
    tmp_path: Path, name: str, place: int, value: int, message: str
) -> None:
    umb.save(MODELS["care"], tmp_path / "good.umb")
    members, path = members_of(tmp_path / "good.umb"), tmp_path / "bad.umb"
    data = members[name]
    members[name] = data[:place] + value.to_bytes(8, "little") + data[place + 8 :]
    path.write_bytes(archive_of(members))
    with pytest.raises(ModelError) as caught:
        umb.load(path)
    assert message in str(caught.value)


def test_archives_that_unpack_to_much_more(tmp_path: Path) -> None:
    path = tmp_path / "bomb.umb"
    path.write_bytes(gzip.compress(archive_of({"index.json": bytes(300_000_000)}), 1))
    assert path.stat().st_size < 2_000_000
    with pytest.raises(ModelError, match="unpacks to over"):
        umb.load(path)


def test_files_that_cannot_be_read_or_written(tmp_path: Path) -> None:
    with pytest.raises(ModelError, match="cannot read the file"):
        umb.load(tmp_path / "missing.umb")
    (tmp_path / "folder.umb").mkdir()
    with pytest.raises(ModelError, match="cannot read the file"):
        umb.load(tmp_path / "folder.umb")
    (tmp_path / "text.umb").write_text("mdp module", encoding="utf-8")
    with pytest.raises(ModelError, match="damaged"):
        umb.load(tmp_path / "text.umb")
    with pytest.raises(ModelError, match="cannot write"):
        umb.save(MODELS["floats"], tmp_path / "nowhere" / "model.umb")


def test_without_umbi_the_error_names_the_extra(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in sys.modules if name.partition(".")[0] == "umbi"]:
        monkeypatch.setitem(sys.modules, name, None)
    for module in (umb, umb_read):
        monkeypatch.setattr(module, "encoding", later("umbi.umb.umb_to_tar"))
    with pytest.raises(ModelError, match=r"exact-mdp\[umb\]"):
        umb.save(MODELS["floats"], tmp_path / "model.umb")
    with pytest.raises(ModelError, match=r"exact-mdp\[umb\]"):
        umb.load(tmp_path / "model.umb")
