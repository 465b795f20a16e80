"""Generated models: the same from the same seed, of the shape they promise, with known answers."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction as F

import numpy as np
import pytest

from exact_mdp.mdp import MDP, ModelError
from exact_mdp.mdp.chain import is_acyclic
from exact_mdp.mdp.exact import fingerprint
from exact_mdp.mdp.forms.generators import dense, garnet, grid, layered, queue
from exact_mdp.solvers import certify, evaluate

MAKERS: dict[str, Callable[..., MDP]] = {
    "garnet": lambda **more: garnet(30, **more),
    "dense": lambda **more: dense(8, **more),
    "layered": lambda **more: layered(4, 5, **more),
    "queue": lambda **more: queue(9, **more),
    "grid": lambda **more: grid(5, 6, **more),
}


@pytest.mark.parametrize("name", MAKERS)
def test_a_seed_is_a_model(name: str) -> None:
    one, two = MAKERS[name](rng=1), MAKERS[name](rng=2)
    assert fingerprint(one) == fingerprint(MAKERS[name](rng=1)) != fingerprint(two)
    assert one.table.sums_to_one
    assert one.name == name
    assert certify(one).violations() == []


def test_each_has_its_shape() -> None:
    model = garnet(30, rng=3, branches=6)
    assert (np.diff(model.transition.indptr) == 6).all()
    assert ((model.reward >= 0) & (model.reward < 1)).all()
    assert (dense(8, rng=3).transition.toarray() > 0).all()
    model = layered(4, 5, rng=3)
    assert is_acyclic(model)
    layer = np.append(model.space.values("layer")[:-1], 4)
    rows = np.repeat(layer[model.pair_state], np.diff(model.transition.indptr))
    assert (layer[model.transition.indices] == np.minimum(rows + 1, 4)).all()


@pytest.mark.parametrize("shape", [(1, 2), (3, 4), (6, 2)])
def test_a_grid_without_slips_is_a_shortest_path(shape: tuple[int, int]) -> None:
    rows, columns = shape
    mdp = grid(rows, columns, rng=0, slip=0, mud=0, discount="9/10")
    steps = rows + columns - 2
    assert certify(mdp).start_value == -(1 - F(9, 10) ** steps) * 10
    assert grid(rows, columns, rng=0, slip=0, mud=1, discount="9/10").reward.min() == -10
    slippery = grid(3, 3, rng=0, slip="1/4")
    middle = slippery.table.row(slippery.pair(4, "UP"))
    assert [(p, n) for p, n, _ in middle] == [(F(3, 4), 1), (F(1, 8), 3), (F(1, 8), 5)]


def test_a_queue_with_one_rate_has_the_stationary_law_of_its_chain() -> None:
    """Detailed balance: p(n + 1) / p(n) is the chance to go up from n over that to come down."""
    mdp = queue(6, rng=4, actions=1, discount="999999/1000000")
    rate = F(mdp.actions[0].removeprefix("rate "))
    up, first, down = (1 - rate) / 2, F(1, 2), rate / 2
    law = [F(1), first / down]
    for _ in range(5):
        law.append(law[-1] * up / down)
    mean = sum(n * p for n, p in enumerate(law)) / sum(law)
    found = evaluate(mdp, "random").occupancy / 10**6
    assert found @ np.arange(7) == pytest.approx(float(mean), rel=1e-3)
    cost = [-(F(n, 6) + rate**2 / 2) for n in range(7)]
    top, bottom = mdp.table.expected_gain_exact()
    assert [F(int(a), int(b)) for a, b in zip(top, bottom, strict=True)] == cost


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: garnet(0, rng=1), "states is 0"),
        (lambda: garnet(3, rng=1, branches=4), "4 branches among 3 states"),
        (lambda: dense(3, rng=-1), "-1 is not a source"),
        (lambda: layered(2, 2.5, rng=1), "width is 2.5"),  # type: ignore[arg-type]
        (lambda: grid(2, 2, rng=1, slip=2), "slip is 2"),
        (lambda: queue(2, rng=1, discount=2), "discount is 2"),
    ],
)
def test_what_cannot_be_drawn(make: Callable[[], MDP], message: str) -> None:
    with pytest.raises(ModelError, match=message):
        make()
