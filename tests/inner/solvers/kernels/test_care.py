"""A stage of the care model, against sums over matrices."""

from itertools import product

import numpy as np
import pytest

from exact_mdp.solvers.kernels.care import maximise_actions, write_distributions, write_policy_rows

VECTORS, ACTIONS = 4, 3


def drawn(seed: int) -> tuple[np.ndarray, np.ndarray, np.random.Generator]:
    """The law K(s', (a, s)) of the next vector, and what each action earns besides."""
    rng = np.random.default_rng(seed)
    law = rng.dirichlet(np.ones(VECTORS), (ACTIONS + 1) * VECTORS).T.copy()
    return law, rng.normal(size=ACTIONS), rng


def test_a_law_is_the_product_of_the_chances_of_its_statuses() -> None:
    chance = np.random.default_rng(0).random(7)
    which = np.array([[0, 1, 2, 6], [3, 3, 4, 5]])
    one, none, law = np.empty((2, 4)), np.empty((2, 4)), np.empty((4, 4))
    write_distributions(which, chance, one, none, law)
    found = {tuple(column.round(12)) for column in law.T}
    wanted = [[np.prod([p if bit else 1 - p for p, bit in zip(chance[column], bits, strict=True)])
               for bits in product((0, 1), repeat=2)] for column in which.T]  # fmt: skip
    assert {tuple(sorted(column)) for column in found} == {
        tuple(sorted(np.round(c, 12))) for c in wanted
    }
    assert law[0] == pytest.approx((1 - chance[which]).prod(axis=0))


@pytest.mark.parametrize("seed", range(5))
def test_a_stage_is_what_its_sums_say(seed: int) -> None:
    law, assist, rng = drawn(seed)
    done, u = 1.5, rng.normal(size=VECTORS)
    q, most = np.empty(ACTIONS * VECTORS), np.empty(VECTORS)
    maximise_actions(assist, law, done, u, q, most)
    laws = law[:, : ACTIONS * VECTORS].reshape(VECTORS, ACTIONS, VECTORS)
    wanted = laws[0] * (done + assist)[:, None] + np.einsum("zas,z->as", laws[1:], u[1:])
    assert q.reshape(ACTIONS, VECTORS) == pytest.approx(wanted)
    assert most == pytest.approx(wanted.max(axis=0))
    shares = rng.dirichlet(np.ones(ACTIONS), VECTORS)
    policy, extra = np.empty((VECTORS, VECTORS)), np.empty(VECTORS)
    write_policy_rows(assist, law, shares, policy, extra)
    assert policy == pytest.approx(np.einsum("zas,sa->zs", laws, shares))
    assert extra == pytest.approx(np.einsum("as,sa,a->s", laws[0], shares, assist))
