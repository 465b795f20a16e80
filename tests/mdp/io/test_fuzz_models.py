"""Whatever bytes a reader of models is given, it returns a model or raises ModelError.

Valid archives are spoiled at random bytes; and their arrays are spoiled and packed anew, since a
checksum would find any change of theirs.
"""

from __future__ import annotations

import io
import json
import tarfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from fuzzing import CARE, TOY, fuzz, json_values, spoiled, survives
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp.mdp import MDP
from exact_mdp.mdp.io import npz, umb


def saved(save: Callable[[MDP, Path], None], name: str, folder: Path, mdp: MDP = TOY) -> bytes:
    save(mdp, folder / name)
    return (folder / name).read_bytes()


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("fuzz")


@fuzz
@given(data=st.data())
def test_model_bytes(folder: Path, data: st.DataObject) -> None:
    content = saved(npz.save, "good.npz", folder)
    path = folder / "bad.npz"
    path.write_bytes(data.draw(st.one_of(spoiled(content), st.binary(max_size=60))))
    survives(lambda: npz.load(path))


numbers = st.one_of(
    st.integers(-3, 5), st.sampled_from([2**31, 2**62, 2**63 - 1, -(2**63)]), st.just(10**6)
)


@fuzz
@given(data=st.data())
def test_model_arrays(folder: Path, data: st.DataObject) -> None:
    mdp = data.draw(st.sampled_from([TOY, CARE]))
    saved(npz.save, "good.npz", folder, mdp)
    with np.load(folder / "good.npz") as archive:
        members = {name: array.copy() for name, array in archive.items()}
    for _ in range(data.draw(st.integers(1, 2))):
        name = data.draw(st.sampled_from([key for key in members if key != "header"]))
        array = members[name]
        match data.draw(st.sampled_from(["value", "value", "kind", "shape", "copy", "scale"])):
            case "value":
                limits = np.iinfo(array.dtype) if array.dtype.kind in "iu" else None
                value = data.draw(numbers if limits else st.floats(width=16))
                place = data.draw(st.integers(0, max(array.size - 1, 0)))
                if limits is not None:
                    value = min(max(value, limits.min), limits.max)
                if array.size and array.dtype.kind in "iuf":
                    array.flat[place] = value
            case "kind":
                kind = data.draw(st.sampled_from(["f8", "i8", "i4", "u1", "f4", "?", "U2"]))
                with np.errstate(all="ignore"):
                    members[name] = array.astype(kind)
            case "shape":
                members[name] = data.draw(
                    st.sampled_from([array[:-1], array[None], array.ravel(), array[::2], array[:0]])
                )
            case "copy":
                members[name] = members[data.draw(st.sampled_from(sorted(members)))]
            case "scale" if array.dtype.kind in "iuf":
                with np.errstate(all="ignore"):
                    factor = np.array(data.draw(st.integers(-2, 3))).astype(array.dtype)
                    members[name] = array * factor
    path = folder / "bad.npz"
    np.savez(path, **members)
    survives(lambda: npz.load(path))


@fuzz
@given(data=st.data())
def test_model_headers(folder: Path, data: st.DataObject) -> None:
    saved(npz.save, "good.npz", folder)
    with np.load(folder / "good.npz") as archive:
        members = dict(archive)
    header = json.loads(members["header"].tobytes())
    spots: list[tuple[Any, Any]] = []

    def visit(node: Any) -> None:
        for key in node if isinstance(node, dict) else range(len(node)):
            spots.append((node, key))
            if isinstance(node[key], dict | list):
                visit(node[key])

    visit(header)
    awkward = st.one_of(json_values, numbers, st.sampled_from(["1/3", "-1", "2"]))
    for node, key in data.draw(st.lists(st.sampled_from(spots), min_size=1, max_size=2)):
        node[key] = data.draw(awkward)
    members["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    path = folder / "bad.npz"
    np.savez(path, **members)
    survives(lambda: npz.load(path))


@settings(fuzz, max_examples=80)
@given(data=st.data())
def test_umb_files(folder: Path, data: st.DataObject) -> None:
    content = saved(umb.save, "good.umb", folder)
    with tarfile.open(fileobj=io.BytesIO(content)) as archive:
        members = {m.name: archive.extractfile(m).read() for m in archive}
    for name in data.draw(st.lists(st.sampled_from(sorted(members)), min_size=1, max_size=2)):
        members[name] = data.draw(spoiled(members[name]))
    stream = io.BytesIO()
    with tarfile.open(fileobj=stream, mode="w") as archive:
        for name, value in members.items():
            member = tarfile.TarInfo(name)
            member.size = len(value)
            archive.addfile(member, io.BytesIO(value))
    path = folder / "bad.umb"
    path.write_bytes(data.draw(st.one_of(st.just(stream.getvalue()), spoiled(content))))
    survives(lambda: umb.load(path))
