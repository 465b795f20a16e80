"""The registries of files: every function that they name is there and takes what they say."""

import inspect
from pathlib import Path

import pytest

from exact_mdp import ModelError
from exact_mdp.mdp.io import formats
from exact_mdp.mdp.io.formats import (
    ENVIRONMENT,
    FORMATS,
    PERCEPTIONS,
    POLICIES,
    PROGRAMS,
    RECORDS,
    WRITTEN_MODELS,
    Format,
    describe_formats,
    find_format,
    find_written_format,
    import_function,
    join_endings,
)

GROUPS = {"models": FORMATS, "policies": POLICIES, "perceptions": PERCEPTIONS, "records": RECORDS}
EVERY = [(name, ending) for name, group in GROUPS.items() for ending in group]


@pytest.mark.parametrize(("name", "ending"), EVERY)
def test_the_functions_are_there_and_take_the_options(name: str, ending: str) -> None:
    form = GROUPS[name][ending]
    assert ending == ending.lower()
    assert Path(f"x{ending}").suffix == ending
    taken = inspect.signature(import_function(form.reader)).parameters
    options = {each for each in taken if taken[each].kind is inspect.Parameter.KEYWORD_ONLY}
    assert options == {*form.options}
    if form.writer:
        assert len(inspect.signature(import_function(form.writer)).parameters) >= 2
    assert form.holds
    assert form.writer or not form.loses


def test_an_environment_takes_a_discount_and_a_start() -> None:
    assert import_function(ENVIRONMENT.reader).__name__ == "from_gymnasium"
    assert set(ENVIRONMENT.options) == {"discount", "start"}


def test_an_ending_tells_the_format() -> None:
    assert find_format("a.b.NPZ", FORMATS) is FORMATS[".npz"]
    assert find_format(Path("a") / "b.umb", FORMATS) is FORMATS[".umb"]
    assert find_format(".npz", FORMATS) is None
    assert find_format("npz", FORMATS) is None
    assert {*PROGRAMS} == {".prism", ".nm", ".pm", ".jani"}
    assert find_written_format("a.Json", WRITTEN_MODELS, "a model") is FORMATS[".json"]
    with pytest.raises(ModelError, match=r"cannot write a model as \.jani\n.*a\.jani\n.*\.npz"):
        find_written_format("a.jani", WRITTEN_MODELS, "a model")
    with pytest.raises(ModelError, match="as a file without extension"):
        find_written_format("a", WRITTEN_MODELS, "a model")


def test_formats_in_words() -> None:
    assert join_endings([".npz"]) == ".npz"
    assert join_endings(WRITTEN_MODELS) == ".npz, .umb or .json"
    one, other = (Format(holds=holds, reader="") for holds in ("one", "other"))
    assert describe_formats({".a": one, ".b": other, ".c": one}) == ".a, .c (one); .b (other)"


def test_one_more_entry_is_one_more_format(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """A model is saved and loaded by functions that an entry names."""
    from exact_mdp import MDP, load, save

    more = Format(holds="a test", reader="io.npz:read_npz", writer="io.npz:write_npz")
    for group in (formats.FORMATS, formats.WRITTEN_MODELS):
        monkeypatch.setitem(group, ".more", more)
    mdp = MDP.from_arrays([[[1]]], ["1/2"], discount="1/2")
    save(mdp, tmp_path / "m.more")
    again = load(tmp_path / "m.more", discount="1/3")
    assert again.table.row(0) == mdp.table.row(0)
    assert str(again.discount_exact) == "1/3"
