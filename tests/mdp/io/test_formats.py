"""A model that is written is read back whole: every field, every number, through every format."""

import warnings
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest
import umbi
from archives import foreign_umb, read_by_umbi, written
from hypothesis import given, settings
from hypothesis import strategies as st
from model_contents import assert_same
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
