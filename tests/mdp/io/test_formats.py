"""A model that is written is read back whole: every field, every number, through every format."""

import json
import warnings
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import umbi
from archives import foreign_umb, is_refused, read_by_umbi, written
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import assert_same, meant
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
            "changed annotations",
        ),
    ):
        save(MODELS["care"], tmp_path / "m.umb")
        content = read_by_umbi(tmp_path / "m.umb")
        content.index.valuations = None
        change(content)
        umbi.umb.write(content, tmp_path / "m.umb")
        with pytest.raises(ModelError, match=message):
            load(tmp_path / "m.umb")


def test_another_reward_of_our_own_file(tmp_path: Path) -> None:
    mdp = MODELS["care"].with_(discount="9/10")
    save(mdp, tmp_path / "m.umb")
    again = load(f"{tmp_path}/m.umb#anger")
    assert (again.discount_exact, again.space, again.events) == (
        mdp.discount_exact, mdp.space, mdp.events,
    )  # fmt: skip
    number = mdp.component_names.index("anger")
    assert np.array_equal(again.reward, mdp.components[:, number])


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


def saved(mdp: MDP, folder: Path) -> dict[str, Any]:
    save(mdp, folder / "good.npz")
    with np.load(folder / "good.npz") as archive:
        return dict(archive)


SPOILED: dict[str, tuple[str, Any, str]] = {
    "no weights": ("weight", None, "the archive holds"),
    "another array": ("more", np.zeros(1), "the archive holds"),
    "float32": ("weight", lambda a: a.astype(np.float32), "an array of type float32"),
    "int32 states": ("pair_state", lambda a: a.astype(np.int32), "an array of type int32"),
    "structured": ("next", lambda a: a.view([("x", a.dtype)]), "an array of type ["),
    "matrix": ("weight", lambda a: a[:, None], "an array of type int64"),
    "flat bytes": ("weight", lambda a: a.astype(np.uint8), "an array of type uint8"),
    "narrow bytes": ("weight", lambda a: np.zeros((len(a), 3), np.uint8), "an array of type uint8"),
    "no width": ("weight", lambda a: np.zeros((10**12, 0), np.uint8), "an array of type uint8"),
    "empty": ("pair_state", lambda a: a[:0], "an array of type int64"),
    "short weights": ("weight", lambda a: a[:-1], "weight has shape"),
    "short offsets": ("offsets", lambda a: a[:-1], "offsets has shape"),
    "offsets backwards": ("offsets", lambda a: a[::-1].copy(), "offsets do not run"),
    "unsorted": ("pair_state", lambda a: a[::-1].copy(), "not sorted"),
    "state beyond": ("pair_state", lambda a: np.append(a[:-1], 2**40), "there is no"),
    "next beyond": ("next", lambda a: a + 10**6, "next state"),
    "next negative": ("next", lambda a: a - 10**6, "next state -"),
    "negative": ("weight", lambda a: -a, "a probability is"),
    "zero": ("weight", lambda a: a * 0, "a probability is 0"),
    "row sums": ("weight", lambda a: a + 1, "transition probabilities sum to"),
    "nan": ("weight", lambda a: np.full(len(a), np.nan), "a probability is nan"),
    "denominator 0": ("denominator", lambda a: a * 0, "not positive"),
    "gain denominator": ("gain_denominator", lambda a: -a, "not positive"),
    "components": ("components", lambda a: a + 1, "components sum to"),
    "components flat": ("components", lambda a: a[:, 0].copy(), "an array of type int64"),
    "event": ("event", lambda a: a.astype(np.int64), "an array of type int64"),
    "short event": ("event", lambda a: a[:-1], "event has shape"),
    "header words": ("header", np.frombuffer(b"\xff\xfe{}", np.uint8), "broken JSON"),
    "header deep": ("header", np.frombuffer(b"[" * 10**5, np.uint8), "nested more than 100 deep"),
    "header digits": ("header", np.frombuffer(b"9" * 10**4, np.uint8), "broken JSON"),
    "header list": ("header", np.frombuffer(b"[1]", np.uint8), "[1] is not an object"),
}


@pytest.mark.parametrize("name", SPOILED)
def test_arrays_that_are_no_model(tmp_path: Path, name: str) -> None:
    key, change, message = SPOILED[name]
    arrays = saved(MODELS["care"], tmp_path)
    if change is None:
        del arrays[key]
    else:
        arrays[key] = change(arrays[key]) if callable(change) else change
    np.savez(tmp_path / "bad.npz", **arrays)
    is_refused(tmp_path / "bad.npz", message)


def column(**changes: Any) -> list[dict[str, Any]]:
    return [{"name": "s", "size": 2, "bits": 0, "words": []} | changes]


HEADERS: list[tuple[str, Any, str]] = [
    ("format", "other model", "is not version 1 of format 'exact-mdp model'"),
    ("version", 2, "2 is not version 1 of format"),
    ("name", 3, "3 is not a text"),
    ("discount", 0.9, "0.9 is not an integer, or a text such as"),
    ("discount", "2", "outside [0, 1]"),
    ("discount", "1" * 5000, "is not an integer"),
    ("start", [[0]], "[0] is not a list of 2"),
    ("start", [[0.0, "1"]], "0.0 is not a whole number from 0 up"),
    ("start", [[False, "1"]], "False is not a whole number from 0 up"),
    ("start", [[10**6, "1"]], "the start names a state twice, or one"),
    ("start", [[0, "1/2"]], "start probabilities sum to 0.5"),
    ("actions", "go", "'go' is not a list"),
    ("actions", [1, 2, 3, 4], "1 is not a text"),
    ("actions", ["a"], "there is no action 1"),
    ("actions", ["a"] * 4, "the same name"),
    ("columns", [3], "3 is not an object"),
    ("columns", column(size=10**15), "state-action pairs"),
    ("columns", column(size=0), "is not a column with one word for each value"),
    ("columns", column(size=3, words=["a"]), "is not a column with one word for each value"),
    ("columns", column(size=3, bits=2), "or bits for 2^bits of them"),
    ("columns", column(bits=10**9), "or bits for 2^bits of them"),
    ("columns", column(size=-2), "-2 is not a whole number from 0 up"),
    ("columns", column(size=True), "True is not a whole number from 0 up"),
    ("columns", column(words=["a", "b"], objects=[1, 2]), "is not an object for each name"),
    ("columns", [], "there is no"),
    ("extra", ["a", "b"], "a state without action"),
    ("component_names", ["a"], "components have shape"),
    ("parameters", [["p", "1"]], "is not an object"),
    ("parameters", [{"name": "p", "value": 0.5}], "0.5 is not an integer, or a text"),
    ("parameters", [{"name": "p", "value": 2, "low": 0, "high": 1}], "outside [0, 1]"),
    ("arrays", [], "is not the list of the arrays"),
]


@pytest.mark.parametrize(("key", "value", "message"), HEADERS)
def test_headers_that_are_no_model(tmp_path: Path, key: str, value: Any, message: str) -> None:
    arrays = saved(MODELS["care"], tmp_path)
    header = json.loads(arrays["header"].tobytes()) | {key: value}
    arrays["header"] = np.frombuffer(json.dumps(header).encode(), np.uint8)
    np.savez(tmp_path / "bad.npz", **arrays)
    is_refused(tmp_path / "bad.npz", message)


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
