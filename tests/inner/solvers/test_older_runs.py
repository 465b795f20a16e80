"""Files of finished runs that older versions wrote: action numbers of 16 bits."""

from pathlib import Path

import numpy as np
import pytest

from exact_mdp import MDP, ModelError, QLearning, train
from exact_mdp.solvers.parallel import read_piece, write_piece

SMALL = QLearning(epochs=5)


def model(actions: int) -> MDP:
    """Return a choice between the last two of so many actions."""
    names = tuple(f"a{number}" for number in range(actions))
    rows = [(0, actions - 2, [(1, 1, -1)]), (0, actions - 1, [(1, 1, 1)]), (1, 0, [(1, 1, 0)])]
    return MDP.from_outcomes(rows, "1/2", actions=names)


def shorten(folder: Path) -> None:
    """Write the policies of the first run in 16 bits."""
    path = folder / "runs-000000.npz"
    arrays = read_piece(path)
    assert arrays is not None
    write_piece(path, arrays | {"policies": arrays["policies"].astype(np.int16)})


def test_they_are_read(tmp_path: Path) -> None:
    (fresh,) = train(model(2**15), SMALL, 1, rng=1, out=tmp_path)
    shorten(tmp_path)
    (again,) = train(model(2**15), SMALL, 1, rng=1, out=tmp_path)
    assert again.policies.dtype == fresh.policies.dtype
    assert np.array_equal(again.policies, fresh.policies)


def test_they_are_refused_where_a_number_may_have_been_cut(tmp_path: Path) -> None:
    train(model(2**15 + 1), SMALL, 1, rng=1, out=tmp_path)
    shorten(tmp_path)
    with pytest.raises(ModelError, match="damaged"):
        train(model(2**15 + 1), SMALL, 1, rng=1, out=tmp_path)
