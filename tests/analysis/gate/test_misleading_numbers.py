"""No message shows a number that looks as if it were within the limits that it breaks."""

from fractions import Fraction

import numpy as np
import pytest
from cli_runner import run

from exact_mdp.mdp import MDP, ModelError
from exact_mdp.mdp.table import beside
from exact_mdp.solvers.parallel.pieces import write_piece


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (("--set", "max_trial=1000000000"), "max_trial is over 200,000,000"),
        (("--set", f"max_trial={'9' * 5000}"), "max_trial is over 200,000,000"),
        (("--discount", "1.0000000000000000000001"), "discount is 1 + 1e-22, outside [0, 1]"),
        (("--set", "base.anger=1.0000000000000000000001"), "base.anger is 1 + 1e-22, outside [0,"),
        (("--set", "base.anger=-1e-400"), "base.anger is -1e-400, outside [0, 1]"),
    ],
)
def test_a_refused_number_is_shown_outside_its_limits(words: tuple[str, ...], said: str) -> None:
    """1000000000 is a positive whole number, and 1 is not outside [0, 1]."""
    done = run("info", "yuan2025", *words)
    assert done.status == 2
    assert done.err.startswith(f"ModelError: {said}")


@pytest.mark.parametrize("off", [Fraction(1, 10**22), -Fraction(1, 10**22), Fraction(1, 3)])
def test_every_number_stands_on_its_own_side(off: Fraction) -> None:
    text = beside(1 + off, Fraction(0), Fraction(1))
    assert text not in ("1", "0")
    top, _, rest = text.replace(" - ", " + -").partition(" + ")
    assert (Fraction(top) + Fraction(rest or "0") > 1) == (off > 0)


def test_sums_are_shown_apart_from_1() -> None:
    with pytest.raises(ModelError, match="start probabilities sum to 1 \\+ 1e-08, not 1"):
        MDP.from_arrays([[[1, 0], [0, 1]]], [1, 0], 0.5, start={0: "1/2", 1: "0.50000001"})


def test_a_piece_whose_numbers_were_changed_is_damaged(tmp_path) -> None:
    """A changed policy was read from beyond an array; others were taken as they were."""
    words = ("train", "tea", "--seeds", "1", "--epochs", "3", "--jobs", "1", "--out", tmp_path)
    assert run(*words).status == 0
    path = tmp_path / "runs-000000.npz"
    good = path.read_bytes()
    with np.load(path) as archive:
        arrays = {name: archive[name] for name in archive.files}
    changes = {"policies": 32767, "last": 32767, "snapshots": -1, "q": 3}
    for name, value in changes.items():
        np.savez(path, **arrays | {name: np.full_like(arrays[name], value)})
        done = run(*words)
        assert (done.status, done.out) == (2, "")
        assert done.err.startswith("ModelError: the file is damaged\n")
    arrays.pop("sha256")
    for name in ("policies", "last"):  # with a digest that agrees
        write_piece(path, arrays | {name: np.full_like(arrays[name], 32767)})
        assert run(*words).status == 2
    path.write_bytes(good)
    assert run(*words).status == 0
