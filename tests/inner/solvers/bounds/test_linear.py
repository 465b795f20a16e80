"""Linear equations in floats, held to NumPy's elimination and, with their errors, to fractions."""

from collections.abc import Callable
from fractions import Fraction as F
from functools import partial
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from oracle import fixed_point

from exact_mdp import MDP, SolverError
from exact_mdp.solvers.bounds import linear
from exact_mdp.solvers.bounds.linear import (
    LinearSystem,
    policy_chain,
    select_rows,
    sweep_system,
    transpose_system,
)
from exact_mdp.solvers.claims import Status

Array = np.ndarray[Any, Any]
UNIT = 2.0**-53


def chain(rng: np.random.Generator, states: int, *, leak: float = 0.2, terms: int = 3) -> Any:
    """A random chain whose rows sum to 1, less up to `leak`, with different numbers of terms."""
    dense = np.zeros((states, states))
    for row in dense:
        count = rng.integers(1, min(states, terms) + 1)
        share = rng.dirichlet(np.ones(count)) * (1 - leak * rng.random())
        row[rng.choice(states, count, replace=False)] = share
    return sp.csr_array(dense)


def mixing(rng: np.random.Generator, states: int) -> Any:
    """A chain that forgets half of where it was in each step."""
    return sp.csr_array((chain(rng, states, leak=0.0).toarray() + 1 / states) / 2)


def backwards(rng: np.random.Generator, states: int) -> Any:
    """A chain each of whose states leads to states of smaller number alone."""
    return sp.csr_array(np.tril(rng.random((states, states)) / states, -1))


def plain(system: LinearSystem, constant: Array) -> Array:
    matrix = np.eye(len(constant)) - system.discount * system.transition.toarray()
    return np.linalg.solve(matrix, constant)


def exactly(system: LinearSystem, constant: Array) -> list[F]:
    rate, moves = F(float(system.discount)), system.transition.toarray().tolist()
    rows = [{t: rate * F(p) for t, p in enumerate(row) if p} for row in moves]
    return fixed_point([F(float(c)) for c in constant], rows)


def limits(patch: pytest.MonkeyPatch, **values: float) -> None:
    """Move the sizes from which another way of solution is taken."""
    for name, value in values.items():
        patch.setattr(linear, name, value)


FAR = {"FEW": 0, "SPARSE": 0, "CHEAP": 0, "NARROW": 0}  # no elimination at first


# ---- ways of solution ----------------------------------------------------------------------------


@pytest.mark.parametrize("states", [1, 2, 7, 12])
def test_each_elimination_agrees_with_numpy(states: int) -> None:
    rng = np.random.default_rng(states)
    for _ in range(5):
        rate, constant = float(rng.uniform(0.1, 1)), rng.normal(size=states)
        moves = chain(rng, states)
        system = LinearSystem(moves, rate)
        order = rng.permutation(states)
        ways: list[Callable[[Array], Array]] = [
            linear._factor_dense(rate, moves),
            linear._factor_banded(rate, *system._reach, moves),
            system._factor_sparse(moves),
            system._within_band,
            system._factor_in_order(partial(linear._factor_dense, rate), order),
            system._factor_in_order(partial(linear._factor_dense, rate), None),
        ]
        for solve in ways:
            np.testing.assert_allclose(solve(constant), plain(system, constant), rtol=1e-11)
        onward = LinearSystem(backwards(rng, states), rate)
        for onward_solve in (onward._make_substitution(onward.transition), onward._direct):
            assert onward_solve
            np.testing.assert_allclose(onward_solve(constant), plain(onward, constant), rtol=1e-12)


@pytest.mark.parametrize("sizes", [FAR, FAR | {"SWEEPS": 0}, FAR | {"SWEEPS": 1, "STEPS": 1}, {},
                                   {"FEW": 0}, {"FEW": 0, "SPARSE": 0}])  # fmt: skip
@pytest.mark.parametrize("rate", [0.0, 0.5, 0.99])
def test_all_ways_lead_to_the_same_values(
    sizes: dict[str, float], rate: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits(monkeypatch, **sizes)
    rng = np.random.default_rng(1)
    for states in (1, 3, 30):
        for leak in (0.0, 0.3):
            system = LinearSystem(chain(rng, states, leak=leak), rate)
            for size in (1e-200, 1e-30, 1.0, 1e30, 1e200):
                constant = size * rng.normal(size=states)
                wanted = plain(system, constant)
                near = np.abs(wanted).max() * 1e-12
                np.testing.assert_allclose(system.approximate(constant), wanted, atol=near)
                found = system.solve(constant)
                np.testing.assert_allclose(found.value, wanted, atol=near)
                assert (found.error < 1e3 * near).all()
                rough = system.solve_roughly(constant)
                left = constant + rate * (system.transition @ rough) - rough
                assert np.linalg.norm(left / size) <= 1.01e-2 * np.linalg.norm(constant / size)
                np.testing.assert_allclose(
                    system.solve_roughly(constant, closely=True), wanted, atol=near
                )


def test_chains_in_order_are_substituted_in_their_order(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(2)
    for few in (0, 10**9):
        limits(monkeypatch, FEW=0, COMPILED=few)
        place = rng.permutation(9)
        moves = sp.csr_array(backwards(rng, 9).toarray()[place][:, place])
        system, constant = LinearSystem(moves, 1.0, order=place), rng.normal(size=9)
        for each in (system, transpose_system(system)):
            assert each._direct
            np.testing.assert_allclose(each._direct(constant), plain(each, constant), rtol=1e-12)


def test_the_equation_of_visits_has_rows_for_columns() -> None:
    rng = np.random.default_rng(3)
    system = LinearSystem(chain(rng, 6), 0.9, roundings=5)
    turned, constant = transpose_system(system), rng.random(6)
    assert (turned.roundings, turned.order) == (5, None)
    wanted = np.linalg.solve(np.eye(6) - 0.9 * system.transition.toarray().T, constant)
    np.testing.assert_allclose(turned.approximate(constant), wanted, rtol=1e-12)


def test_a_chain_that_never_leaks_has_no_values() -> None:
    ring = sp.csr_array(np.roll(np.eye(4), 1, axis=1))
    for solve in (linear._factor_dense, lambda rate, rows: linear._factor_banded(rate, 3, 3, rows)):
        with pytest.raises(SolverError, match=r"elimination failed \(pivot of state 3\)"):
            solve(1.0, ring)
    system = LinearSystem(ring)
    with pytest.raises(SolverError, match="elimination failed"):
        system._factor_sparse(ring)
    stays = LinearSystem(sp.csr_array([[0.5, 0.25, 0.25], [0, 0.75, 0.25], [0, 0.5, 0.5]]), 1.0)
    with pytest.raises(SolverError):
        stays.solve(np.ones(3))


# ---- which way is taken --------------------------------------------------------------------------


def banded(states: int, down: int, up: int) -> Any:
    """A chain with all transitions within a band."""
    dense = np.tri(states, k=up) * np.tri(states, k=down).T
    return sp.csr_array(0.9 * dense / dense.sum(axis=1, keepdims=True))


def test_how_far_a_chain_leads_is_counted_by_hand() -> None:
    rng = np.random.default_rng(4)
    for _ in range(20):
        moves, place = chain(rng, 8, terms=2), rng.permutation(8)
        for each in (place, np.arange(8)):
            ahead = [each[t] - each[s] for s, t in zip(*moves.nonzero(), strict=True)]
            assert linear._compute_bandwidths(moves, each) == (-min(*ahead, 0), max(*ahead, 0))
    assert LinearSystem(banded(20, 2, 3))._reach == (2, 3)
    assert LinearSystem(sp.csr_array((3, 3)))._reach == (0, 0)


def taken(system: LinearSystem, patch: pytest.MonkeyPatch) -> str:
    """Return which way of solution is taken."""
    used = list[str]()
    for name in ("_factor_dense", "_factor_banded"):
        inner = getattr(linear, name)
        patch.setattr(linear, name, lambda *a, n=name, f=inner: used.append(n) or f(*a))
    for name in ("_factor_sparse", "_make_substitution", "_solve_by_bicgstab"):
        inner = getattr(LinearSystem, name)
        patch.setattr(LinearSystem, name, lambda *a, n=name, f=inner: used.append(n) or f(*a))
    kept, patched = linear.sweep_system, lambda *a: used.append("sweep_system") or kept(*a)
    patch.setattr(linear, "sweep_system", patched)
    constant = np.arange(1.0, system.transition.shape[0] + 1)
    np.testing.assert_allclose(system.approximate(constant), plain(system, constant), rtol=1e-9)
    patch.undo()
    return " ".join(dict.fromkeys(used))


def test_what_costs_least_is_taken(monkeypatch: pytest.MonkeyPatch) -> None:
    """A band has 2 S (l + 1)(l + u + 1) multiplications, all entries S³ / 3."""
    rng = np.random.default_rng(5)
    for states, down, up, cheaper in (
        (12, 2, 5, "_factor_dense"),  # 6 · 3 · 8 = 144 = 12²
        (13, 2, 5, "_factor_banded"),
        (48, 9, 30, "_factor_dense"),  # 6 · 10 · 40 = 2400 < 49²
        (49, 9, 30, "_factor_banded"),
    ):
        assert taken(LinearSystem(banded(states, down, up)), monkeypatch) == cheaper
    dense = chain(rng, 12, terms=9)
    wide = dense.tolil()
    wide[0, 11] = wide[11, 0] = 0.01
    mixing = wide.tocsr()
    many = mixing.nnz

    def way(**sizes: float) -> str:
        limits(monkeypatch, **sizes)
        return taken(LinearSystem(mixing, 0.5), monkeypatch)

    none = {"CHEAP": 0, "NARROW": 0}
    assert way(FEW=12) == "_factor_dense"
    assert way(FEW=11, SPARSE=many, **none) == "_factor_sparse"
    assert way(FEW=11, SPARSE=many, CHEAP=1e9, NARROW=0) == "_factor_banded"
    assert way(FEW=11, SPARSE=many - 1, **none) == "sweep_system"
    assert way(FEW=11, SPARSE=many - 1, CHEAP=0, NARROW=9) == "_factor_banded"
    assert way(FEW=11, SPARSE=many - 1, CHEAP=1e9, NARROW=0) == "sweep_system"
    assert way(FEW=11, SPARSE=many - 1, SWEEPS=1, **none) == "sweep_system _solve_by_bicgstab"
    assert way(FEW=11, SPARSE=many - 1, SWEEPS=1, STEPS=1, **none) == (
        "sweep_system _solve_by_bicgstab _factor_banded"
    )
    assert (
        way(FEW=11, SPARSE=many - 1, SWEEPS=1, CHEAP=1e9, NARROW=0) == "sweep_system _factor_banded"
    )
    ordered = LinearSystem(backwards(rng, 12), order=np.arange(12))
    for compiled, wanted in (
        (ordered.transition.nnz, "_make_substitution"),
        (10**9, "_factor_sparse"),
    ):
        limits(monkeypatch, FEW=11, COMPILED=compiled)
        assert taken(ordered, monkeypatch) == wanted
        ordered = LinearSystem(ordered.transition, order=np.arange(12))


def test_the_work_of_a_band_is_counted(monkeypatch: pytest.MonkeyPatch) -> None:
    limits(monkeypatch, CHEAP=10**9, NARROW=10**9)
    band = LinearSystem(banded(20, 2, 3))
    assert band.work == 2 * 20 * 3 * 6
    entries = band.transition.nnz
    for cheap, narrow, work in (
        (720, 0, 720), (719, 0, 0), (0, 120 / entries, 720), (0, 119 / entries, 0),
    ):  # fmt: skip
        limits(monkeypatch, CHEAP=cheap, NARROW=narrow)
        assert LinearSystem(band.transition).work == work
    for narrow, fits in ((100 / entries, True), (99 / entries, False)):
        limits(monkeypatch, NARROW=narrow)
        assert LinearSystem(band.transition)._narrow is fits


def test_states_are_put_in_an_order_that_makes_the_band_narrow(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    rng = np.random.default_rng(6)
    place = rng.permutation(30)
    limits(monkeypatch, NARROW=0)
    mixed = sp.csr_array(banded(30, 1, 2).toarray()[place][:, place])
    order, down, up = LinearSystem(mixed)._band
    assert order is not None
    inner = mixed.toarray()[order][:, order]
    rows, columns = inner.nonzero()
    assert (down, up) == (max(rows - columns), max(columns - rows))
    assert down + up < 8 < sum(LinearSystem(mixed)._reach)
    assert LinearSystem(banded(30, 1, 1))._band == (None, 1, 1)
    limits(monkeypatch, NARROW=1000)
    assert LinearSystem(mixed)._band == (None, *LinearSystem(mixed)._reach)


def test_factors_that_would_fill_the_memory_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    system = LinearSystem(chain(np.random.default_rng(7), 20), 0.99)
    entries = sum(system._reach) * 20
    constant = np.arange(20.0)
    asked, kept = list[int](), LinearSystem._solve_by_bicgstab

    def stepped(self: LinearSystem, constant: Array, rtol: float, steps: int) -> Array | None:
        asked.append(steps)
        return kept(self, constant, rtol, steps)

    monkeypatch.setattr(LinearSystem, "_solve_by_bicgstab", stepped)
    monkeypatch.setattr(linear.csgraph, "reverse_cuthill_mckee", lambda *_, **__: np.arange(20))
    limits(monkeypatch, **FAR, SWEEPS=0, STEPS=1, PATIENT=2, MOST_NUMBERS=entries)
    fits = LinearSystem(system.transition, 0.99)
    assert np.allclose(fits.approximate(constant), plain(fits, constant))
    assert asked == [1]
    limits(monkeypatch, MOST_NUMBERS=entries - 1)
    with pytest.raises(SolverError, match="the factors of 20 equations with") as caught:
        LinearSystem(system.transition, 0.99).approximate(constant)
    assert (caught.value.status, asked) == (Status.TOO_LARGE, [1, 2])
    limits(monkeypatch, PATIENT=8000)
    patient = LinearSystem(system.transition, 0.99)
    assert np.allclose(patient.approximate(constant), plain(patient, constant))


# ---- iteration -----------------------------------------------------------------------------------


def test_bicgstab_solves_as_closely_as_asked() -> None:
    rng = np.random.default_rng(8)
    for states in (1, 5, 40):
        for rtol in (0.5, 1e-3, 1e-10):
            matrix = np.eye(states) - 0.7 * chain(rng, states).toarray()
            constant = rng.normal(size=states)
            value = linear._run_bicgstab(lambda y, m=matrix: m @ y, constant, rtol, 4 * states + 4)
            assert value is not None
            left = np.linalg.norm(constant - matrix @ value)
            assert left <= rtol * np.linalg.norm(constant) * (1 + 1e-6) + 1e-15
    assert linear._run_bicgstab(lambda y: 0.5 * y, np.ones(3), 1e-9, 1) is not None
    assert linear._run_bicgstab(lambda y: matrix @ y, constant, 1e-12, 2) is None


def test_bicgstab_begins_anew_where_its_directions_vanish() -> None:
    """A quarter turn moves each direction to one at right angles: b · A b = 0."""
    turn = np.array([[0.0, -1.0], [1.0, 0.0]])
    assert linear._run_bicgstab(lambda y: turn @ y, np.array([1.0, 2.0]), 1e-9, 50) is None
    nearly = turn + 0.3 * np.eye(2)
    value = linear._run_bicgstab(lambda y: nearly @ y, np.array([1.0, 2.0]), 1e-12, 50)
    np.testing.assert_allclose(value, np.linalg.solve(nearly, [1, 2]), rtol=1e-9)
    with np.errstate(all="ignore"):
        assert linear._run_bicgstab(lambda y: np.inf * y, np.ones(2), 1e-9, 5) is None


def test_bicgstab_ends_where_nothing_is_left() -> None:
    assert linear._run_bicgstab(lambda y: 0.5 * y, np.zeros(3), 1e-9, 5).tolist() == [0] * 3
    assert linear._run_bicgstab(lambda y: 0.5 * y, np.ones(3), 0.0, 1).tolist() == [2] * 3
    for singular in (np.zeros((2, 2)), np.array([[1.0, 0.0], [1.0, 0.0]])):
        side = np.array([1.0, 0.0])
        assert linear._run_bicgstab(lambda y, m=singular: m @ y, side, 1e-9, 5) is None


@pytest.mark.parametrize(
    "rows, constant",
    [
        ([[0, 2, 1], [1, -1, 1], [-2, 0, 0]], [2, -2, 2]),
        ([[2, 1, 1], [0, 0, 2], [-1, 2, 1]], [-2, -1, 2]),
        ([[1, 2, 1], [-2, -1, 1], [2, 1, 1]], [-1, 1, -2]),
        ([[0, -1, 1], [-2, 2, 2], [0, 0, 1]], [1, -1, -2]),
        ([[1, 1, 0], [-2, 1, -1], [0, 1, -1]], [-1, -1, 2]),
    ],
)
@pytest.mark.parametrize("size, scale", [(1.0, 1.0), (1e10, 1.0), (1.0, 1e10)])
def test_bicgstab_goes_on_from_where_it_was(
    rows: Any, constant: Any, size: float, scale: float
) -> None:
    """Each of these comes to a direction that vanishes up to rounding, at any scale."""
    matrix, side = scale * np.array(rows), size * np.array(constant)
    value = linear._run_bicgstab(lambda y: matrix @ y, side, 1e-10, 30)
    assert value is not None
    np.testing.assert_allclose(matrix @ value, side, rtol=1e-6)


def test_what_is_asked_for_roughly_is_iterated_for_roughly(monkeypatch: pytest.MonkeyPatch) -> None:
    limits(monkeypatch, **FAR)
    rng = np.random.default_rng(18)
    system, constant = LinearSystem(chain(rng, 40), 0.99), rng.normal(size=40)
    off = [
        np.abs(system.solve_roughly(constant, **more) / plain(system, constant) - 1).max()
        for more in ({}, {"closely": False}, {"closely": True})
    ]
    assert off[0] == off[1] > 1e-6 > 1e-10 > off[2]


def test_sweeps_take_each_state_its_row() -> None:
    rng = np.random.default_rng(9)
    moves, row = chain(rng, 9), rng.permutation(9)
    constant = rng.normal(size=9)
    fixed = LinearSystem(moves[row], 0.5)
    value, done = sweep_system(moves, row, 0.5, constant, False, 1e-12, 0.0)
    assert done
    np.testing.assert_allclose(value, plain(fixed, constant), atol=1e-11)
    whole = mixing(rng, 9)
    value, done = sweep_system(whole, row, 0.999999, constant, True, 1e-9, 0.0)
    assert done  # all values rise at once
    exact = plain(LinearSystem(whole[row], 0.999999), constant)
    np.testing.assert_allclose(value, exact, rtol=1e-9)
    assert not sweep_system(whole, row, 1 - 1e-9, constant, False, 1e-9, 0.0)[1]
    # at discount 1 no constant is what all values lack
    value, done = sweep_system(half := 0.5 * moves, row, 1.0, constant, True, 1e-9, 0.0)
    np.testing.assert_allclose(value, plain(LinearSystem(half[row]), constant), atol=1e-8)


def test_sweeps_of_an_equation_end_where_they_are_close(monkeypatch: pytest.MonkeyPatch) -> None:
    limits(monkeypatch, **FAR)
    moves = mixing(np.random.default_rng(10), 12)
    constant = 1e9 * np.arange(1.0, 13)
    system = LinearSystem(moves, 0.9)
    errors = [
        np.abs(system._solve_nearly(constant, rtol) / plain(system, constant) - 1).max()
        for rtol in (linear.FIRST, linear.CORRECTION)
    ]
    assert errors[0] < 2e-15 < 1e-9 < errors[1] < 2e-3
    assert system._slow == []
    assert not system._solve_nearly(np.zeros(12), 1e-9).any()
    for each in (np.inf, np.nan):
        assert np.isnan(system._solve_nearly(np.full(12, each), 1e-9)).all()
    slow = LinearSystem(chain(np.random.default_rng(11), 12, leak=1e-6), 1.0)
    np.testing.assert_allclose(slow.approximate(constant), plain(slow, constant), rtol=1e-6)
    assert slow._slow == [True]
    for total, closed in ((1.0, True), (1 + 2e-12, False), (1 - 2e-12, False), (1 + 5e-13, True)):
        for rows in ([[total, 0], [0.5, 0.5]], [[0.5, 0.5], [total / 2, total / 2]]):
            assert LinearSystem(sp.csr_array(rows))._closed is closed


# ---- refinement ----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "share, left, calls",
    [
        (0.1, 1e-6, 6),
        (0.4, 0.4**6, 6),
        (0.5, 0.5**6, 6),
        (0.6, 0.36, 2),  # by less than half, and so no more
        (1.0, 1.0, 2),  # no better at all
        (-1.0, -1.0, 2),  # as far off on the other side
        (-1.5, -1.5, 2),  # worse: what was before stays
        (1e-20, 0, 1),
        (1e-10, 0, 2),
    ],
)
def test_values_are_refined_as_long_as_it_helps(
    share: float, left: float, calls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each solution lacks a share of what it should be."""
    system = LinearSystem(sp.csr_array([[0.5, 0.25], [0, 0.5]]))
    asked = list[float]()

    def nearly(self: LinearSystem, constant: Array, rtol: float) -> Array:
        asked.append(rtol)
        return (1 - share) * plain(self, constant)

    monkeypatch.setattr(LinearSystem, "_solve_nearly", nearly)
    constant = np.array([1.0, 3.0])
    value, residual = system._refine_solution(constant)
    wanted = plain(system, constant)
    np.testing.assert_allclose(value, (1 - left) * wanted, rtol=1e-15 if not left else 1e-9)
    again = constant + system.transition @ value - value
    np.testing.assert_array_equal(residual, again)
    assert asked == [linear.FIRST] + [linear.CORRECTION] * (calls - 1)


@pytest.mark.parametrize("terms, units, by", [(4, 8, 1.5), (128, 32, 4)])
def test_what_rounding_alone_leaves_is_not_refined(
    terms: int, units: int, by: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With n terms, n / 4 units of the greatest |c| + |x|; 8 at least."""
    ends = np.arange(0, terms * terms + 1, terms)
    entries = np.eye(terms).ravel() / 4, np.tile(np.arange(terms), terms), ends
    system = LinearSystem(sp.csr_array(entries))  # most of its entries are zeros
    calls = list[int]()
    for off in (units - by, units + by):

        def nearly(self: LinearSystem, constant: Array, rtol: float, off: float = off) -> Array:
            calls.append(1)
            if rtol == linear.CORRECTION:
                return np.zeros(terms)
            return np.full(terms, 4.0) + off * 7 * UNIT / 0.75

        monkeypatch.setattr(LinearSystem, "_solve_nearly", nearly)
        calls.clear()
        system._refine_solution(np.full(terms, 3.0))  # x = 4, and |c| + |x| = 7
        assert len(calls) == 1 + (off > units)


@pytest.mark.parametrize("units, calls", [(8, 1), (8.25, 2)])
def test_eight_units_of_the_largest_number_are_not_refined(
    units: float, calls: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A small number beside a large one, of which no digit is lost, is off by twice as much."""
    asked = list[float]()

    def nearly(self: LinearSystem, constant: Array, rtol: float) -> Array:
        asked.append(rtol)
        return 2 * constant + np.array([0, 6 * units * UNIT]) * (rtol == linear.FIRST)

    monkeypatch.setattr(LinearSystem, "_solve_nearly", nearly)
    system = LinearSystem(sp.csr_array(np.eye(2) / 2))
    value, _ = system._refine_solution(np.array([1, 2.0**-6]))  # |c| + |x| = 3 at most
    assert len(asked) == calls
    assert value.tolist() == [2, 2.0**-5 + (48 * UNIT if calls == 1 else 0)]


# ---- errors --------------------------------------------------------------------------------------


@pytest.mark.parametrize("rate", [0.0, 0.5, 0.9, 0.999999, 1.0])
def test_the_exact_solution_is_within_the_error(rate: float) -> None:
    """Its error is a few dozen roundings of what is added up on the way."""
    rng = np.random.default_rng(12)
    for _ in range(20):
        states = int(rng.integers(1, 7))
        system = LinearSystem(chain(rng, states), rate)
        for constant in (rng.normal(size=states), rng.random(states) * 10.0 ** rng.integers(-9, 9)):
            found = system.solve(constant)
            exact = exactly(system, constant)
            near = zip(found.value.tolist(), exact, found.error.tolist(), strict=True)
            assert all(abs(F(x) - y) <= F(e) for x, y, e in near)
            around = np.eye(states) - rate * system.transition.toarray()
            size = np.linalg.solve(around, np.abs(constant) + np.abs(found.value))
            assert found.error.max() <= 60 * UNIT * size.max()


def test_the_error_of_a_constant_comes_on_top() -> None:
    system = LinearSystem(sp.csr_array([[0.5, 0.25], [0.25, 0.5]]))
    for off in (0.125, np.array([0.125, 0.5])):
        error = system.solve(np.ones(2), off).error
        least = plain(system, np.full(2, off) if np.isscalar(off) else off)
        assert (error >= least).all()
        assert (error <= 2.001 * least.max()).all()
    assert not system.solve(np.zeros(2)).error.any()
    late = LinearSystem(sp.csr_array([[0.0, 1.0], [0.0, 0.5]]))
    assert not late.solve(np.zeros(2)).error.any()


def test_the_error_is_that_of_the_roundings_of_the_residual() -> None:
    """Half of each state stays: nothing is left but γ(n + k + 4)(c + P x) + 2 u x, twice."""
    for rounded in (1, 3):
        half = sp.csr_array(np.eye(2) / 2)
        system = LinearSystem(half) if rounded == 1 else LinearSystem(half, roundings=rounded)
        found = system.solve(np.array([1.0, 1.5]))
        assert found.value.tolist() == [2, 3]
        wanted = 2 * UNIT * (1 + rounded + 4 + 2) * np.array([2, 3])
        assert (found.error >= wanted * (1 + 2.0**-20)).all()
        # Small errors are a 2^-10th of the largest too large.
        assert (found.error <= wanted * [1 + 2.0**-10, 1 + 2.0**-18]).all()


def test_a_chain_that_leaks_by_rounding_alone_proves_nothing(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Ten floats of 0.1 add up to 0.9999999999999999 in floats, and to more than 1 exactly."""
    tenths = np.full((10, 10), 0.1)
    assert sum(tenths[0].tolist()) < 1 < sum(map(F, tenths[0].tolist()))
    system = LinearSystem(sp.csr_array(tenths))
    monkeypatch.setattr(LinearSystem, "_solve_nearly", lambda self, constant, _: np.ones(10))
    monkeypatch.setattr(LinearSystem, "approximate", lambda self, constant: np.ones(10))
    with pytest.raises(SolverError):
        system._bound_error(np.arange(10.0))


def test_the_rounding_of_a_residual_is_what_its_terms_can_lose() -> None:
    """γ(n + k + 4) of c + γ P x for n terms of k roundings, and 2 units of x, for magnitudes."""
    rng = np.random.default_rng(13)
    for roundings in (1, 7):
        system = LinearSystem(chain(rng, 9, terms=6), 0.75, roundings=roundings)
        constant, value = rng.random(9), rng.random(9)
        terms = (system.transition.toarray() > 0).sum(axis=1) + roundings + 4
        unit = terms * UNIT / (1 - terms * UNIT)
        flow = 0.75 * system.transition.toarray() @ value
        wanted = unit * (constant + flow) + 2 * UNIT * value
        given = system._bound_rounding(constant, value)
        np.testing.assert_allclose(given, wanted, rtol=1e-13)
        assert (given >= wanted * (1 - 1e-15)).all()
    tiny = system._bound_rounding(0 * constant, 0 * value)
    assert not tiny.any()
    least = system._bound_rounding(0 * constant, np.full(9, 1e-320))  # products vanish
    entries = (system.transition.toarray() > 0).sum(axis=1) + 1
    np.testing.assert_allclose(least, 2.0**-1000 * entries, rtol=1e-10)
    beside = LinearSystem(sp.csr_array([[0.5, 0, 0], [0, 0, 0], [0, 0, 0.5]]))
    far = beside._bound_rounding(np.zeros(3), np.array([1e300, 0, 0]))
    np.testing.assert_allclose(far[1:], 2.0**-1000 * 1e300 * np.array([1, 2]), rtol=1e-10)


def dominated(system: LinearSystem, excess: Array) -> tuple[Array, Array]:
    """Return the error, which is proven to be at least the exact one, and the exact one."""
    error, least = system._bound_error(excess), exactly(system, excess)
    rate, moves = F(float(system.discount)), system.transition.toarray().tolist()
    for own, row, need in zip(error, moves, excess, strict=True):
        ahead = sum((F(p) * F(float(e)) for p, e in zip(row, error, strict=True)), F(0))
        assert F(float(own)) - rate * ahead >= F(float(need))
    return error, np.array([float(x) for x in least])


@pytest.mark.parametrize("sizes", [{}, FAR])
def test_errors_dominate_what_the_residual_leaves(
    sizes: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    limits(monkeypatch, **sizes)
    rng = np.random.default_rng(14)
    for _ in range(30):
        system = LinearSystem(chain(rng, 6, leak=0.5), 0.97)
        excess = 1e-12 * rng.random(6) * (rng.random(6) < 0.5)
        if not excess.any():
            continue
        error, least = dominated(system, excess)
        every = plain(system, np.ones(6))
        close = 1e-5 if not sizes else 0.2
        assert (error <= (least + 2.0**-10 * excess.max() * every) * (1 + close)).all()


def test_errors_are_refined_where_rough_ones_prove_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(15)
    system = LinearSystem(chain(rng, 6, leak=0.5), 0.97)
    excess = 1e-12 * np.array([1.0, 0, 0, 0, 2, 0])
    wanted = system._bound_error(excess)
    kept = LinearSystem._solve_nearly

    def rough(self: LinearSystem, constant: Array, rtol: float) -> Array:
        value = kept(self, constant, rtol)
        return value if rtol == linear.FIRST else value * (1 - 2 * (np.arange(6) == 2))

    monkeypatch.setattr(LinearSystem, "_solve_nearly", rough)
    np.testing.assert_allclose(system._bound_error(excess), wanted, rtol=1e-9)
    monkeypatch.setattr(LinearSystem, "_solve_nearly", lambda self, constant, _: -constant)
    with pytest.raises(SolverError):
        system._bound_error(excess)


def test_an_error_is_that_of_the_residual_and_no_more(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of a value of 0 the residual is c, and the error the solution of the equation itself."""
    system = LinearSystem(sp.csr_array([[0.5, 0.25], [0.25, 0.5]]))
    constant = np.array([1.0, 3.0])
    wanted = plain(system, constant)
    monkeypatch.setattr(LinearSystem, "_refine_solution", lambda *_: (np.zeros(2), constant))
    error = system.solve(constant).error
    assert (error >= wanted).all()
    np.testing.assert_allclose(error, wanted, rtol=2.0**-8)


def test_where_nothing_is_lost_errors_are_a_thousandth_of_the_largest() -> None:
    """1 + 2^-10 and 2^-10, scaled until the first is 1: states that do not lead to each other."""
    error = LinearSystem(sp.csr_array(np.eye(2) / 2))._bound_error(np.array([1.0, 0.0]))
    np.testing.assert_allclose(error, [2, 2 / (2**10 + 1)], rtol=1e-5)


def test_a_rough_solution_is_enough_for_an_error(monkeypatch: pytest.MonkeyPatch) -> None:
    """The equation of errors has no constant, the rounding of which would count."""
    system, asked = LinearSystem(sp.csr_array([[0.5, 0.25], [0.25, 0.5]])), list[float]()
    kept = LinearSystem._solve_nearly

    def nearly(self: LinearSystem, constant: Array, rtol: float) -> Array:
        asked.append(rtol)
        return kept(self, constant, rtol)

    monkeypatch.setattr(LinearSystem, "_solve_nearly", nearly)
    monkeypatch.setattr(LinearSystem, "_bound_rounding", lambda self, constant, _: constant / 2)
    dominated(system, np.array([1.0, 0.5]))
    assert asked == [linear.CORRECTION]


def test_an_error_that_stays_as_it_is_proves_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """e - P e is 0, and not above it, where all stay."""
    system = LinearSystem(sp.csr_array(np.eye(2)))
    monkeypatch.setattr(LinearSystem, "_solve_nearly", lambda self, constant, _: np.ones(2))
    monkeypatch.setattr(LinearSystem, "approximate", lambda self, constant: np.ones(2))
    monkeypatch.setattr(LinearSystem, "_bound_rounding", lambda self, *_: np.zeros(2))
    with pytest.raises(SolverError):
        system._bound_error(np.ones(2))


def test_an_error_beyond_the_floats_is_refused() -> None:
    system = LinearSystem(sp.csr_array([[0.5, 0.25], [0.25, 0.25]]), 1.0)
    for excess in ([1.0, 1.1], [0.8, 3.0], [0.7, 3.0]):
        error, least = dominated(system, np.array(excess))
        np.testing.assert_allclose(error, least, rtol=1e-2)
    assert not system._bound_error(np.zeros(2)).any()
    for size in (np.inf, np.nan):
        with pytest.raises(SolverError, match="beyond the range of floats"):
            system._bound_error(np.array([size, 1.0]))
    with pytest.raises(SolverError, match="beyond the range of floats"):
        system.solve(np.array([1e308, 1.7e308]))


# ---- near discount 1 -----------------------------------------------------------------------------


@pytest.mark.parametrize("sizes", [{}, FAR])
def test_values_apart_from_what_all_share(
    sizes: dict[str, float], monkeypatch: pytest.MonkeyPatch
) -> None:
    """h + k solves the equation, as closely as h is large, which is 0 in a state often visited."""
    limits(monkeypatch, **sizes)
    rng = np.random.default_rng(16)
    for leak in (2.0**-20, 2.0**-40):
        for _ in range(5):
            weights = rng.integers(1, 9, (5, 5)) * (rng.random((5, 5)) < 0.7) + np.eye(5, k=1)
            weights[:, 0] += 1
            count = weights.sum(axis=1, keepdims=True)
            rows = [
                [F(int(w), int(n)) for w in row] for row, (n,) in zip(weights, count, strict=True)
            ]
            rate, constant = 1 - F(leak), rng.integers(-9, 10, 5)
            moves = [{t: rate * p for t, p in enumerate(row)} for row in rows]
            exact = fixed_point([F(int(c)) for c in constant], moves)
            system = LinearSystem(sp.csr_array(weights / count), float(rate))
            value, level = system.solve_relatively(constant * 1.0, np.full(5, leak))
            size = max(1.0, np.abs(value).max())
            lacks = [F(float(h)) + F(level) - x for h, x in zip(value, exact, strict=True)]
            spread = max(lacks) - min(lacks)
            near = 1e-9 if sizes else 1e-12
            assert float(spread) < near * size
            assert abs(float(lacks[0])) < 10 * near * (abs(float(exact[0])) + size)
            often, others = system._without_one
            share = np.linalg.matrix_power(weights / count, 999)[0]
            assert share[often] == pytest.approx(share.max())
            assert abs(value[often]) < near * size
            wanted = weights / count * (np.arange(5) != often)
            np.testing.assert_array_equal(others.transition.toarray(), wanted)
            assert others.discount == system.discount


# ---- chains of policies --------------------------------------------------------------------------


def test_parts_of_a_matrix_are_those_of_dense_ones() -> None:
    rng = np.random.default_rng(17)
    for _ in range(30):
        matrix = sp.csr_array(rng.random((11, 5)) * (rng.random((11, 5)) < 0.6))
        rows, states = rng.integers(0, 11, 5), rng.random(5) < 0.6
        for inner in (False, True):
            wanted = matrix.toarray()[rows] * states[:, None]
            if inner:
                wanted = wanted * states
            given = (
                select_rows(matrix, rows, states, inner=True)
                if inner
                else select_rows(matrix, rows, states)
            )
            np.testing.assert_array_equal(given.toarray(), wanted)
            assert given.nnz == (wanted > 0).sum()
            assert given.indptr.dtype == matrix.indptr.dtype


def test_the_chain_of_a_policy_leaves_out_what_has_ended() -> None:
    rows: Any = [
        (0, 0, [(0.5, 0, 1), (0.25, 1, 2), (0.25, 2, 3)]),
        (0, 2, [(1, 2, 7)]),
        (1, 0, [(1, 1, 0)]),
        (2, 1, [(0.5, 1, -1), (0.5, 0, 0)]),
    ]
    mdp = MDP.from_outcomes(rows, "1/2")
    moves, reward = policy_chain(mdp, np.array([0, 2, 3]))
    assert moves.toarray().tolist() == [[0.5, 0, 0.25], [0, 0, 0], [0.5, 0, 0]]
    assert reward.tolist() == [1.75, 0, -0.5]
    moves, reward = policy_chain(mdp, np.array([1, 2, 3]), np.array([4.0, 5, 6, 7]))
    assert moves.toarray().tolist() == [[0, 0, 1], [0, 0, 0], [0.5, 0, 0]]
    assert reward.tolist() == [5, 0, 7]
