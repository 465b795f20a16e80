"""A model that is written is read back whole: every field, every number, through every format."""

import json
import warnings
from fractions import Fraction
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
import pytest
import umbi
from archives import foreign_umb, is_refused, read_by_umbi, written
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import assert_same, meant
from refusal_tables import table_of_refusals
from saved_models import MODELS, models

from exact_mdp import MDP, ModelError, load, save

FORMATS = ("npz", "umb")


@pytest.mark.parametrize("name", MODELS)
@pytest.mark.parametrize("ending", FORMATS)
def test_every_field_comes_back(tmp_path: Path, name: str, ending: str) -> None:
    path = tmp_path / f"m.{ending}"
    save(MODELS[name], path)
    assert [file.name for file in tmp_path.iterdir()] == [path.name]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        again = load(path)
    assert_same(MODELS[name], again, stored=ending == "npz")
    first = path.read_bytes()
    save(MODELS[name], path)
    assert path.read_bytes() == first


@settings(max_examples=40)
@given(mdp=models(), ending=st.sampled_from(FORMATS))
def test_any_model_comes_back(
    tmp_path_factory: pytest.TempPathFactory, mdp: MDP, ending: str
) -> None:
    path = tmp_path_factory.mktemp("formats") / f"m.{ending}"
    save(mdp, path)
    assert_same(mdp, load(path), stored=False)


def test_a_discount_that_nobody_gave_is_said(tmp_path: Path) -> None:
    content = foreign_umb([[[(0, 1.0)]]], {"reward": {"choices": [1.0]}})
    path = written(content, tmp_path)
    with pytest.warns(UserWarning, match="no discount, and 1 is used"):
        assert load(path).discount_exact == 1
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert load(path, discount="1/2").discount_exact == Fraction(1, 2)


def test_a_file_that_another_program_changed(tmp_path: Path) -> None:
    """A header that no longer fits the numbers is refused, not taken for some other model."""
    for change, message in (
        (lambda c: c.choice_action_to_string.__setitem__(0, "x"), "choice-action-to-string"),
        (lambda c: c.state_is_initial.__setitem__(0, False), "state-is-initial"),
        (
            lambda c: c.annotations["rewards"]["reward"]["choices"].__setitem__(0, Fraction(9)),
            "changed rewards/reward",
        ),
    ):
        save(MODELS["care"], tmp_path / "m.umb")
        content = read_by_umbi(tmp_path / "m.umb")
        change(content)
        umbi.umb.write(content, tmp_path / "m.umb")
        with pytest.raises(ModelError, match=message):
            load(tmp_path / "m.umb")


# ---- the format .npz -----------------------------------------------------------------------------


def ratio(text: int | str) -> Fraction:
    """A number of the header: an integer, or a text, which may be hexadecimal."""
    return Fraction(*(int(part, 0) for part in str(text).split("/")))


def test_any_program_can_read_it(tmp_path: Path) -> None:
    """The model once more, by the format's description alone."""
    for name in ("care", "care beyond 64 bits", "floats", "wide"):
        mdp, path = MODELS[name], tmp_path / "model.npz"
        save(mdp, path)
        with np.load(path, allow_pickle=False) as archive:
            arrays = dict(archive)
        header = json.loads(arrays["header"].tobytes())

        def number(key: str, index: int, arrays: dict[str, Any] = arrays) -> Fraction:
            value = arrays[key][index]
            if arrays[key].dtype == np.uint8:
                return Fraction(int.from_bytes(value.tobytes(), "little", signed=True))
            return Fraction(value.item())

        assert (header["format"], header["version"]) == ("exact-mdp model", 1)
        assert ratio(header["discount"]) == mdp.discount_exact
        assert [(s, ratio(p)) for s, p in header["start"]] == list(mdp.start)
        assert header["actions"] == list(mdp.actions)
        per_pair = len(arrays["gain"]) == len(arrays["pair_state"])
        for pair in range(0, mdp.n_pairs, 7):
            row = []
            for i in range(arrays["offsets"][pair], arrays["offsets"][pair + 1]):
                chance = number("weight", i) / number("denominator", pair)
                gain = number("gain", pair if per_pair else i) / number("gain_denominator", pair)
                row.append((chance, int(arrays["next"][i]), gain))
            if arrays["weight"].dtype == np.float64:
                exact = meant([float(chance) for chance, _, _ in row])
                row = [(p, *rest) for p, (_, *rest) in zip(exact, row, strict=True)]
            assert row == mdp.table.row(pair)


# ---- damage -----------------------------------------------------------------------------------


def spoiled(key: str, change: Any) -> object:
    """A saved model, one of whose arrays is changed."""
    with TemporaryDirectory() as folder:
        save(MODELS["care"], path := Path(folder) / "bad.npz")
        with np.load(path) as archive:
            arrays = dict(archive)
        arrays[key] = change(arrays.get(key)) if callable(change) else change
        np.savez(path, **{name: array for name, array in arrays.items() if array is not None})
        return load(path)


def headed(key: str, value: Any) -> object:
    """A saved model, one of the values of whose header is changed."""

    def changed(array: Any) -> Any:
        header = json.loads(array.tobytes()) | {key: value}
        return np.frombuffer(json.dumps(header).encode(), np.uint8)

    return spoiled("header", changed)


def said(key: str, value: Any) -> object:
    """A model.json, one of whose values is changed."""
    with TemporaryDirectory() as folder:
        save(MODELS["floats"], path := Path(folder) / "bad.json")
        path.write_text(json.dumps(json.loads(path.read_text("utf-8")) | {key: value}), "utf-8")
        return load(path)


def column(**changes: Any) -> list[dict[str, Any]]:
    return [{"name": "s", "size": 2, "bits": 0, "words": []} | changes]


test_arrays_and_headers_that_are_no_model = table_of_refusals(__file__, globals())


def test_flipped_bits_are_found_by_the_checksum(tmp_path: Path) -> None:
    """A single changed byte is refused, or is in a place that carries no meaning."""
    mdp, path = MODELS["floats"], tmp_path / "model.npz"
    save(mdp, path)
    content = path.read_bytes()
    refusals = 0
    directory = content.index(b"PK\x01\x02")
    places = [*range(0, directory, 7), *range(directory, len(content))]
    for place in places:
        path.write_bytes(content[:place] + bytes([content[place] ^ 0x10]) + content[place + 1 :])
        try:
            again = load(path)
        except ModelError:
            refusals += 1
        else:
            assert_same(mdp, again)
            assert again.floats == mdp.floats
    assert refusals > len(places) * 0.6


def test_files_that_are_no_model_or_cannot_be_written(tmp_path: Path) -> None:
    np.savez(tmp_path / "q.npz", np.zeros((16, 4)))
    is_refused(tmp_path / "q.npz", "a Q-table is a policy")
    (tmp_path / "r.npz").write_bytes((tmp_path / "q.npz").read_bytes()[:99])
    is_refused(tmp_path / "r.npz", "damaged")
    with pytest.raises(ModelError, match="cannot write the file"):
        save(MODELS["floats"], tmp_path / "nowhere" / "model.npz")


def test_numbers_of_any_length(tmp_path: Path) -> None:
    long = MODELS["floats"].with_(discount=1 - Fraction(1, 10**5000))
    for ending in ("npz", "json"):
        save(long, tmp_path / f"model.{ending}")
        assert load(tmp_path / f"model.{ending}").discount_exact == long.discount_exact
