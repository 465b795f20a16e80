"""Records as JSON and back: each type of field, what is none of it, and whole files."""

import json
from collections.abc import Callable
from dataclasses import dataclass, field
from fractions import Fraction as F
from math import inf, nan
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pytest

from exact_mdp import ModelError
from exact_mdp.mdp.io.parts import write_object
from exact_mdp.mdp.table import Integers
from exact_mdp.solvers.exact import codec
from exact_mdp.solvers.exact.checker import Unreadable
from exact_mdp.solvers.exact.codec import (
    build_file_content,
    decode_record,
    encode_record,
    rebuild_proof,
)


@dataclass(frozen=True, kw_only=True, eq=False)
class Part:
    """Two fields that files have, and two that they have not."""

    name: str
    many: list[int]
    kept: dict[str, int] = field(default_factory=dict)
    none: int | None = None


@dataclass(frozen=True, kw_only=True, eq=False)
class Proof:
    """A field of each type."""

    kind: str
    right: bool
    count: int
    share: F
    end: F | float
    numbers: Integers
    pair: tuple[int, ...]
    parts: list[Part]
    one: Part | None
    own: object = None

    kinds: ClassVar[tuple[str, ...]] = ("test", "other")


LONG = 10**5000 + 1


def proof(**changes: Any) -> Proof:
    parts: dict[str, Any] = {
        "kind": "test", "right": True, "count": -31, "share": F(-2, 3), "end": inf,
        "numbers": np.array([3, -1, 0]), "pair": (1, LONG),
        "parts": [Part(name="a", many=[0, 16]), Part(name="b", many=[])], "one": None,
    }  # fmt: skip
    return Proof(**parts | changes)


WRITTEN: dict[str, Any] = {
    "kind": "test", "right": True, "count": "-0x1f", "share": "-0x2/0x3", "end": "inf",
    "numbers": [3, -1, 0], "pair": ["0x1", hex(LONG)],
    "parts": [{"name": "a", "many": ["0x0", "0x10"]}, {"name": "b", "many": []}], "one": None,
}  # fmt: skip


def same(made: Any, other: Any) -> bool:
    return bool(encode_record(made) == encode_record(other))


def test_each_type_is_written_as_the_format_says() -> None:
    assert encode_record(proof()) == WRITTEN
    assert encode_record(proof(end=-inf, one=Part(name="c", many=[1]))) == WRITTEN | {
        "end": "-inf", "one": {"name": "c", "many": ["0x1"]}
    }  # fmt: skip
    assert encode_record(proof(), int) == WRITTEN | {
        "count": -31, "pair": [1, LONG],
        "parts": [{"name": "a", "many": [0, 16]}, {"name": "b", "many": []}],
    }  # fmt: skip
    with pytest.raises(TypeError, match=r"\{1\} is of type set, which no file holds"):
        encode_record({1})
    head = {"format": "exact-mdp certificate", "version": 2}
    assert build_file_content(proof()) == head | WRITTEN
    assert build_file_content(proof(), int)["count"] == -31


def test_what_is_written_is_read() -> None:
    for made in (proof(), proof(end=-inf), proof(end=F(1, 2)), proof(one=Part(name="", many=[7]))):
        again = decode_record(Proof, json.loads(json.dumps(encode_record(made))))
        assert same(again, made)
        assert type(again) is Proof
        assert type(again.numbers) is np.ndarray
        assert again.numbers.dtype == np.int64
        assert type(again.pair) is tuple
        assert type(again.parts) is list
        assert type(again.end) is type(made.end)
        assert same(rebuild_proof(made), made)
    assert type(decode_record(F | float, "0x2/0x1")) is F
    assert decode_record(int | None, None) is None
    assert decode_record(str | int, "0x1") == "0x1"  # the first that fits


REFUSED: list[tuple[Any, list[Any]]] = [
    (int, [1, 1.0, True, "1", "0x", "0x01", "0X1", "+0x1", " 0x1", "0x1 ", "0x1F", None]),
    (F, [1, 0.5, "1/2", "0x1", "0x1/0x0", "0x1/-0x2", "0x1/0x2/0x3", "/", ["0x1", "0x2"], None]),
    (float, ["nan", "1.5", 1.5, "Infinity", None]),
    (bool, [1, 0, "true", None]),
    (str, [1, None, ["a"]]),
    (type(None), [0, False, "", []]),
    (Integers, [[1.0], [True], ["0x1"], "01", 1, None, [None], [[1]]]),
    (list[int], ["0x1", None, [1], ["0x1", 1], {"0x1": 1}]),
    (tuple[int, ...], ["0x1", None, [1]]),
    (Part, [None, [], "a", {}, {"name": "a"}, {"name": "a", "many": [], "none": None},
            {"name": 1, "many": []}, {"name": "a", "many": None}]),
    (F | float, [1, "nan", None]),
    (int | None, [1, "", False]),
]  # fmt: skip


@pytest.mark.parametrize("kind, values", REFUSED, ids=str)
def test_what_is_no_value_of_a_type_is_refused(kind: Any, values: list[Any]) -> None:
    for value in values:
        with pytest.raises((ValueError, AttributeError, TypeError)):
            decode_record(kind, value)
    assert decode_record(Integers, []).tolist() == []


@pytest.mark.parametrize(
    "changes",
    [{"kind": "third"}, {"count": 0.5}, {"share": 1}, {"end": nan}, {"numbers": [0.5]},
     {"right": 1}, {"one": 3}, {"pair": [{1}]}, {"numbers": np.array([2.0**70])}],
)  # fmt: skip
def test_a_proof_of_other_types_is_not_checked(changes: dict[str, Any]) -> None:
    with pytest.raises(Unreadable, match="no file holds such a proof of test or other"):
        rebuild_proof(proof(**changes))


# ---- files ---------------------------------------------------------------------------------------

KINDS: dict[str, type[Proof]] = {"test": Proof, "other": Proof}


def test_a_file_has_a_line_for_each_field(tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    write_object(path, codec.build_file_content(proof()))
    text = path.read_text("utf-8")
    assert json.loads(text) == build_file_content(proof())
    lines = text.splitlines()
    assert lines[0] == '{"format": "exact-mdp certificate",'
    assert lines[1] == ' "version": 2,'
    assert len(lines) == 2 + len(WRITTEN)
    assert text.endswith("}\n")
    assert same(codec.load_proof(KINDS, path), proof())
    path.write_text(json.dumps(build_file_content(proof(kind="other"))), "utf-8")
    assert codec.load_proof(KINDS, path).kind == "other"


def test_the_size_of_a_file_is_limited(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "proof.json"
    write_object(path, codec.build_file_content(proof()))
    size = path.stat().st_size
    monkeypatch.setattr(codec, "LARGEST", size)
    assert codec.load_proof(KINDS, path).kind == "test"
    monkeypatch.setattr(codec, "LARGEST", size - 1)
    with pytest.raises(ModelError, match="bytes that are read"):
        codec.load_proof(KINDS, path)


Change = dict[str, Any]
DAMAGED: list[tuple[Change | Callable[[Change], Any], str]] = [
    *[({"version": x}, f"version is {str(x)!r}, not 2") for x in (2.0, True, 1, "2", None)],
    *[({"format": x}, f"format is {str(x)!r}, not 'exact-mdp certificate'") for x in (2, "other")],
    *[({"kind": x}, f"kind is {str(x)!r}, not 'test' or 'other'") for x in ("third", None, 1)],
    ({"kind": ["test"]}, "kind is"),
    ({"more": 1}, "the certificate: keys missing, or too many: more"),
    (lambda c: {k: v for k, v in c.items() if k != "share"}, "keys missing, or too many: share"),
    *[({key: x}, f"{key} is damaged") for key, x in (
        ("count", 1), ("share", "1/2"), ("end", None), ("numbers", [1.0]), ("numbers", [10**30]),
        ("parts", [{}]), ("one", 1), ("right", 1),
    )],
    (lambda _: [], "format is 'None', not 'exact-mdp certificate'"),
]  # fmt: skip


@pytest.mark.parametrize("number", range(len(DAMAGED)))
def test_a_damaged_file_says_where(number: int, tmp_path: Path) -> None:
    change, said = DAMAGED[number]
    given = build_file_content(proof())
    path = tmp_path / "proof.json"
    changed = given | change if isinstance(change, dict) else change(given)
    path.write_text(json.dumps(changed), "utf-8")
    with pytest.raises(ModelError) as caught:
        codec.load_proof(KINDS, path)
    assert said in caught.value.what
    assert caught.value.where == str(path)


@pytest.mark.parametrize("text", ["", "{", "[" * 100_000, '{"a": 1, "a": 2}', "\ud7ff", "9" * 5000])
def test_what_is_no_json_is_no_certificate(text: str, tmp_path: Path) -> None:
    path = tmp_path / "proof.json"
    path.write_text(text, "utf-8")
    with pytest.raises(ModelError) as caught:
        codec.load_proof(KINDS, path)
    assert caught.value.what in (
        "not a certificate, which is JSON text", "'a' is written twice",
    )  # fmt: skip
