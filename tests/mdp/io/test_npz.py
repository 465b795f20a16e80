"""Saved models: nothing is lost, and any program can read them."""

from __future__ import annotations

import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_equality import assert_same
from saved_models import MODELS

from exact_mdp.mdp import MDP
from exact_mdp.mdp.io import npz


@pytest.mark.parametrize("name", MODELS)
def test_nothing_is_lost(tmp_path: Path, name: str) -> None:
    mdp, path = MODELS[name], tmp_path / "model.npz"
    npz.save(mdp, path)
    again = npz.load(path)
    assert_same(mdp, again)
    first = path.read_bytes()
    npz.save(again, path)
    assert path.read_bytes() == first
    assert [file.name for file in tmp_path.iterdir()] == ["model.npz"]


@settings(max_examples=40, deadline=None)
@given(data=st.data())
def test_any_rationals_survive(
    tmp_path_factory: pytest.TempPathFactory, data: st.DataObject
) -> None:
    numbers = st.one_of(
        st.fractions(), st.integers(), st.integers(-(10**60), 10**60), st.floats(-1e9, 1e9)
    )
    chances = st.one_of(st.fractions(0, 1), st.fractions(0, 1, max_denominator=2**200))
    listed = []
    for state in range(data.draw(st.integers(1, 4))):
        p = data.draw(chances)
        listed.append((state, 0, [(p, 0, data.draw(numbers)), (1 - p, state, data.draw(numbers))]))
    mdp = MDP.from_outcomes(listed, data.draw(st.fractions(0, 1)))
    path = tmp_path_factory.mktemp("npz") / "model.npz"
    npz.save(mdp, path)
    assert_same(mdp, npz.load(path))


def test_any_program_can_read_it(tmp_path: Path) -> None:
    """The model once more, by the format's description alone."""
    for name in ("care", "care beyond 64 bits", "floats", "wide"):
        mdp, path = MODELS[name], tmp_path / "model.npz"
        npz.save(mdp, path)
        with np.load(path, allow_pickle=False) as archive:
            arrays = dict(archive)
        header = json.loads(arrays["header"].tobytes())

        def number(key: str, index: int, arrays: dict[str, Any] = arrays) -> Fraction:
            value = arrays[key][index]
            if arrays[key].dtype == np.uint8:
                return Fraction(int.from_bytes(value.tobytes(), "little", signed=True))
            return Fraction(value.item())

        assert (header["format"], header["version"]) == ("exact-mdp model", 1)
        assert Fraction(header["discount"]) == mdp.discount_exact
        assert [(s, Fraction(p)) for s, p in header["start"]] == list(mdp.start)
        assert header["actions"] == list(mdp.actions)
        per_pair = len(arrays["gain"]) == len(arrays["pair_state"])
        for pair in range(0, mdp.n_pairs, 7):
            row = []
            for i in range(arrays["offsets"][pair], arrays["offsets"][pair + 1]):
                chance = number("weight", i) / number("denominator", pair)
                gain = number("gain", pair if per_pair else i) / number("gain_denominator", pair)
                row.append((chance, int(arrays["next"][i]), gain))
            assert row == mdp.table.row(pair)


def test_a_compressed_archive_is_read_too(tmp_path: Path) -> None:
    mdp, path = MODELS["care"], tmp_path / "model.npz"
    npz.save(mdp, path)
    with np.load(path) as archive:
        np.savez_compressed(tmp_path / "small.npz", **dict(archive))
    assert (tmp_path / "small.npz").stat().st_size < path.stat().st_size / 3
    assert_same(mdp, npz.load(tmp_path / "small.npz"))
