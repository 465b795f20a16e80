"""Masses of states and rewards, carried through blocks, beside runs and powers in fractions."""

from collections import defaultdict
from fractions import Fraction as F
from math import inf
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from small_models import given, law_of_return, outcomes_of, random_policy, small_model

from exact_mdp import MDP, ModelError
from exact_mdp.mdp.table import Numbers
from exact_mdp.solvers.values import return_mass as module
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.return_mass import MassFlow, _sum_masses


def whole(seed: int, **kind: Any) -> tuple[MDP, Any, PolicyChain, Numbers]:
    """A model whose rewards are whole numbers, a policy, its chain and its rewards."""
    mdp = small_model(seed, **kind)
    top, below = mdp.table.integer_gains
    mdp = mdp.with_(table=mdp.table.with_reward(top, np.ones_like(below)))
    chances = random_policy(mdp, seed, pure=seed % 4 == 0)
    chain = PolicyChain.of(mdp, given(chances))
    return mdp, chances, chain, chain.gain.astype(np.int64)


def law_with_cycles(mdp: MDP, chances: Any, steps: int) -> tuple[dict[int, float], float]:
    """The masses of returns that have ended after some steps, and what has not ended."""
    listed = [
        [(float(p), to, int(r)) for p, to, r, _ in each] for each in outcomes_of(mdp, chances)
    ]
    moving: dict[tuple[int, int], float] = {(s, 0): float(p) for s, p in mdp.start if p}
    ended: dict[int, float] = defaultdict(float)
    for _ in range(steps + 1):
        after: dict[tuple[int, int], float] = defaultdict(float)
        for (state, earned), mass in moving.items():
            if mdp.terminal[state]:
                ended[earned] += mass
            else:
                for p, to, r in listed[state]:
                    after[to, earned + r] += mass * p
        moving = after
    return ended, sum(moving.values())


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("dense", [0, 8, 10**6])
def test_masses_at_the_end_are_those_of_all_runs(
    exact: bool, dense: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """However the masses are added up: in lists, or in arrays."""
    monkeypatch.setattr(module, "DENSE", dense)
    for seed in range(12):
        mdp, chances, chain, gain = whole(seed, falling=True, states=6)
        for kind in (np.int64, object):
            flow = MassFlow(chain, gain.astype(kind), {}, exact=exact)
            values, masses, lost, roundings = flow.carry_mass()
            runs = law_of_return(mdp, chances)
            assert values.tolist() == [*runs]
            if exact:
                assert masses.tolist() == [*runs.values()]
                assert lost == 0
            else:
                assert 0 <= lost < 1e-280
                for mass, wanted in zip(masses.tolist(), runs.values(), strict=True):
                    assert abs(F(mass) / wanted - 1) <= roundings * F(1, 2**53)
                # Of each block what comes in is added up, after a product with a rounded chance:
                # with seven roundings more, and with ten at the end.
                *inside, last = flow.entering.tolist()
                assert roundings == sum(n + chain.roundings + 7 for n in inside) + last + 10
            assert not flow.cyclic.any()


def test_masses_of_cycles_are_those_of_powers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REMAINING", 1e-3)
    for seed in range(4):
        mdp, chances, chain, gain = whole(seed, states=3)
        ended, left = law_with_cycles(mdp, chances, 30)
        for dense, merged in ((0, 64), (8, 64), (8, 3), (10**6, 5)):
            monkeypatch.setattr(module, "DENSE", dense)
            monkeypatch.setattr(module, "MERGED", merged)
            flow = MassFlow(chain, gain, {}, exact=False)
            values, masses, lost, _ = flow.carry_mass()
            listed = dict(zip(values.tolist(), masses.tolist(), strict=True))
            assert 0 <= lost <= 1e-3
            assert (lost > 1e-290) == flow.cyclic.any()
            assert sum(listed.values()) + lost == pytest.approx(1, rel=1e-12)
            for value, mass in listed.items():
                assert mass <= ended[value] + left + 1e-12
            missing = sum(max(x - listed.get(v, 0.0), 0.0) for v, x in ended.items())
            assert missing <= lost + 1e-12


def test_blocks_are_levels_and_the_ends_are_last() -> None:
    rows: Any = [
        (4, 0, [(F(1, 2), 0, 1), (F(1, 2), 2, 5)]),
        (0, 0, [(F(1, 2), 3, 2), (F(1, 2), 1, 7)]),
        (3, 0, [(F(1, 3), 0, 3), (F(2, 3), 2, 1)]),
        (2, 0, [(1, 1, 4)]),
        (1, 0, [(1, 1, 0)]),
    ]
    chain = PolicyChain.of(MDP.from_outcomes(rows, start=4), "random")
    flow = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=False)
    assert flow.block.tolist() == [0, 1, 1, 2, 3, 3, 3]  # 4, then 0 and 3, then 2, then the ends
    assert flow.first.tolist() == [0, 1, 3, 4, 7]
    assert flow.cyclic.tolist() == [False, True, False, False]
    assert flow.last == 3
    assert dict(flow.start) == {0: 1}
    assert flow.entering.tolist() == [0, 2, 2, 2]  # outcomes into one state of each block, at most
    each = zip(flow.source.tolist(), flow.target.tolist(), flow.gain.tolist(), strict=True)
    assert sorted(each) == [
        (0, 1, 1),
        (0, 3, 5),
        (1, 2, 2),
        (1, 4, 7),
        (2, 1, 3),
        (2, 3, 1),
        (3, 4, 4),
    ]
    assert flow.inner.sum() == 2
    assert flow.share.sum() == pytest.approx(4)
    with pytest.raises(ModelError, match="lead back to each other"):
        MassFlow(chain, chain.gain.astype(np.int64), {}, exact=True)


def test_actions_that_do_the_same_become_one() -> None:
    rows: Any = [
        (0, 0, [(F(1, 2), 1, 1), (F(1, 2), 1, 2)]),
        (0, 1, [(F(1, 4), 1, 1), (F(3, 4), 1, 3)]),
        (1, 0, [(1, 1, 0)]),
    ]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    flow = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=True)
    assert flow.gain.tolist() == [1, 2, 3]
    values, masses, _, _ = flow.carry_mass()
    assert dict(zip(values.tolist(), masses.tolist(), strict=True)) == {
        1: F(3, 8),
        2: F(1, 4),
        3: F(3, 8),
    }
    again = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=False)
    assert again.entering.tolist() == [0, 4]


def test_infinite_ends_come_first_and_last() -> None:
    rows: Any = [(0, 0, [(F(1, 8), 1, 1), (F(2, 8), 2, 2), (F(5, 8), 3, 9)])]
    rows += [(s, 0, [(1, s, 0)]) for s in (1, 2, 3)]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    at = np.eye(4, dtype=bool)
    gain = chain.gain.astype(np.int64)
    for exact in (True, False):
        for low, high, wanted in (
            (1, 2, {-inf: F(1, 8), 9: F(5, 8), inf: F(1, 4)}),
            (2, 1, {-inf: F(1, 4), 9: F(5, 8), inf: F(1, 8)}),
        ):
            flow = MassFlow(chain, gain, {-inf: at[low], inf: at[high]}, exact=exact)
            values, masses, _, _ = flow.carry_mass()
            assert values.tolist() == [*wanted]
            assert masses.tolist() == [*wanted.values()]
        values, masses, _, _ = MassFlow(chain, gain, {inf: at[1] | at[2]}, exact=exact).carry_mass()
        assert (values.tolist(), masses.tolist()) == ([9, inf], [F(5, 8), F(3, 8)])


def test_masses_that_are_too_small_are_counted_as_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    rare = F(1, 10**200)
    rows: Any = [(s, 0, [(rare, s + 1, 1), (1 - rare, 3, 0)]) for s in range(2)] + [
        (2, 0, [(1, 3, 5)]),
        (3, 0, [(1, 3, 0)]),
    ]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    values, masses, lost, _ = MassFlow(
        chain, chain.gain.astype(np.int64), {}, exact=False
    ).carry_mass()
    assert values.tolist() == [0, 1]
    assert masses.tolist() == pytest.approx([1, 1e-200], rel=1e-12)
    assert 0 < lost < 1e-280
    exactly = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=True).carry_mass()
    assert exactly[0].tolist() == [0, 1, 7]
    assert exactly[1].tolist() == [1 - rare, rare * (1 - rare), rare**2]
    for small in (1e-3, 1e-2):
        monkeypatch.setattr(module, "EDGE", small)
        own = PolicyChain.of(
            MDP.from_outcomes(
                [(0, 0, [(F(1, 200), 1, 1), (F(199, 200), 1, 0)]), (1, 0, [(1, 1, 0)])]
            ),
            "random",
        )
        values, masses, lost, _ = MassFlow(
            own, own.gain.astype(np.int64), {}, exact=False
        ).carry_mass()
        assert values.tolist() == ([0, 1] if small < 0.005 else [0])
        assert lost >= (0 if small < 0.005 else 0.005)
        assert masses.sum() + lost == pytest.approx(1, rel=1e-12)


def test_cycles_that_are_hardly_left_are_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    """At once where a power of their matrix tells; else after so many sweeps."""
    monkeypatch.setattr(module, "SWEEPS", 20)
    for stay, few, words in (
        (F(1, 8), 200, ""),
        (F(9, 10), 200, "the end is still to come"),
        (F(9, 10), 0, "of the probability has not reached the end"),
    ):
        monkeypatch.setattr(module, "FEW", few)
        rows: Any = [(0, 0, [(stay, 0, 1), (1 - stay, 1, 0)]), (1, 0, [(1, 1, 0)])]
        chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
        flow = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=False)
        if words:
            with pytest.raises(ModelError, match=words):
                flow.carry_mass()
        else:
            values, masses, lost, _ = flow.carry_mass()
            for value, mass in zip(values.tolist(), masses.tolist(), strict=True):
                assert mass == pytest.approx(float((1 - stay) * stay**value), rel=1e-12)
            assert lost == pytest.approx(float(stay) ** len(values), rel=1e-9)


def test_what_all_cycles_leave_together_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "REMAINING", 1e-3)
    rows: Any = [(s, 0, [(F(1, 2), s, 1), (F(1, 2), s + 1, 0)]) for s in range(4)]
    chain = PolicyChain.of(MDP.from_outcomes([*rows, (4, 0, [(1, 4, 0)])]), "random")
    flow = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=False)
    values, masses, lost, roundings = flow.carry_mass()
    assert 1e-5 < lost <= 1e-3
    assert masses.sum() + lost == pytest.approx(1, rel=1e-12)
    assert roundings >= len(values)  # a sweep for each round
    for value, mass in zip(values.tolist(), masses.tolist(), strict=True):
        exact = (value + 1) * (value + 2) * (value + 3) / 6 / 2 ** (value + 4)
        assert mass <= exact * (1 + 1e-12)


def test_what_underflows_is_lost() -> None:
    rare = F(1, 10**280)
    rows: Any = [(0, 0, [(rare, 1, 1), (1 - rare, 3, 0)]), (1, 0, [(rare, 2, 1), (1 - rare, 3, 0)])]
    rows += [(2, 0, [(1, 3, 2)]), (3, 0, [(1, 3, 0)])]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    for kind in (np.int64, object):
        _, _, lost, _ = MassFlow(chain, chain.gain.astype(kind), {}, exact=False).carry_mass()
        assert 0 < lost < 1e-280


def test_what_is_left_in_a_block_is_a_power_of_its_matrix(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "SWEEPS", 7)
    for seed in range(10):
        _, _, chain, gain = whole(seed, states=4)
        flow = MassFlow(chain, gain, {}, exact=False)
        for block in np.flatnonzero(flow.cyclic).tolist():
            first, last = flow.first[block : block + 2].tolist()
            own = np.flatnonzero((flow.source >= first) & (flow.source < last) & flow.inner)
            mass = np.random.default_rng(seed).random(last - first)
            moving = np.arange(first, last), np.zeros(last - first, dtype=np.int64), mass
            onward = mass
            for _ in range(7):
                onward = [
                    sum(
                        onward[flow.source[k] - first] * flow.share[k]
                        for k in own
                        if flow.target[k] == to
                    )
                    for to in range(first, last)
                ]
            assert flow._estimate_remaining(block, moving, own) == pytest.approx(
                sum(onward), rel=1e-12
            )
            for few, known in ((last - first - 1, False), (last - first, True)):
                with monkeypatch.context() as patch:
                    patch.setattr(module, "FEW", few)
                    assert (flow._estimate_remaining(block, moving, own) > 0) == known


def test_work_beyond_the_limits_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    rows: Any = [(0, 0, [(F(1, 3), 1, k) for k in range(3)]), (1, 0, [(1, 2, 1)])]
    chain = PolicyChain.of(MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])]), "random")
    gain = chain.gain.astype(np.int64)
    for name, least in (("STEPS", 6), ("CELLS", 3)):  # three outcomes, then one of three masses
        with monkeypatch.context() as patch:
            patch.setattr(module, name, least)
            assert MassFlow(chain, gain, {}, exact=False).carry_mass()[0].tolist() == [1, 2, 3]
            patch.setattr(module, name, least - 1)
            with pytest.raises(ModelError, match="too many different returns"):
                MassFlow(chain, gain, {}, exact=False).carry_mass()


def summed(parts: Any) -> dict[tuple[int, int], F]:
    total: dict[tuple[int, int], F] = defaultdict(F)
    for state, multiple, mass in parts:
        for s, m, x in zip(state.tolist(), multiple.tolist(), mass.tolist(), strict=True):
            total[s, m] += F(x)
    return dict(sorted(total.items()))


def test_masses_of_the_same_state_and_reward_are_added_up() -> None:
    rng = np.random.default_rng(0)
    for trial in range(60):
        parts: Any = [
            (
                rng.integers(3, 7, size=k),
                rng.integers(-3, 4, size=k) * 10 ** (trial % 3),
                rng.integers(1, 9, size=k) / 8,
            )
            for k in rng.integers(0, 9, size=3).tolist()
        ]
        for kind in (np.float64, object):
            given_parts = [(s, m, x.astype(kind)) for s, m, x in parts]
            state, multiple, mass = _sum_masses(given_parts)
            listed = zip(state.tolist(), multiple.tolist(), mass.tolist(), strict=True)
            assert [((s, m), F(x)) for s, m, x in listed] == [*summed(given_parts).items()]


def test_products_of_matrices_hand_masses_on_as_loops_do(monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(1)
    for seed in range(20):
        _, _, chain, gain = whole(seed, states=6)
        flow = MassFlow(chain, gain, {}, exact=False)
        sources = np.unique(flow.source)
        some = np.sort(rng.choice(sources, size=min(3, len(sources)), replace=False))
        state = np.repeat(some, 3)
        multiple = np.tile([-2, 5, 11], len(some))
        mass = rng.integers(1, 9, size=len(state)) / 16
        outcomes = np.flatnonzero(rng.random(len(flow.source)) < 0.8)
        wanted: dict[tuple[int, int], float] = defaultdict(float)
        for s, m, x in zip(state.tolist(), multiple.tolist(), mass.tolist(), strict=True):
            for k in outcomes[flow.source[outcomes] == s].tolist():
                wanted[int(flow.target[k]), m + int(flow.gain[k])] += x * float(flow.share[k])
        for dense in (0, 10**9):
            monkeypatch.setattr(module, "DENSE", dense)
            flow.work = 0
            found = summed([flow._handed_on((state, multiple, mass), outcomes)])
            assert flow.work == sum((flow.source[outcomes] == s).sum() for s in state)
            assert [*found] == sorted(wanted)
            for key, value in found.items():
                assert float(value) == pytest.approx(wanted[key], rel=1e-14)
            if dense and len(outcomes):
                products = flow._in_products((state, multiple, mass), outcomes)
                assert products is not None
                assert summed([products]) == found
        for other in (
            (state, multiple.astype(object), mass),
            (state, multiple, mass.astype(object)),
        ):
            assert flow._in_products(other, outcomes) is None
        assert flow._in_products((state, multiple, mass), outcomes[:0]) is None


def test_an_episode_that_is_over_at_the_start_returns_0() -> None:
    chain = PolicyChain.of(MDP.from_outcomes([(0, 0, [(1, 0, 0)])]), "random")
    for exact in (True, False):
        flow = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=exact)
        assert (flow.last, flow.block.tolist()) == (0, [0, 0, 0])
        values, masses, lost, roundings = flow.carry_mass()
        assert (values.tolist(), masses.tolist(), lost) == ([0], [1], 0)
        assert roundings == 10


def test_long_multiples_are_exact() -> None:
    long = 2**60 + 1  # no float
    rows: Any = [(0, 0, [(F(1, 2), 1, long), (F(1, 2), 1, -long)]), (1, 0, [(1, 1, 0)])]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    gain = np.array([-long, long, 0])
    assert chain.gain.tolist() == [-float(2**60), float(2**60), 0]
    for kind in (np.int64, object):
        flow = MassFlow(chain, gain.astype(kind), {}, exact=False)
        assert flow.carry_mass()[0].tolist() == [-long, long]


def circle(stay: F) -> MassFlow:
    """A state in which 1 is earned in each round, until it is left for the end."""
    rows: Any = [(0, 0, [(stay, 0, 1), (1 - stay, 1, 0)]), (1, 0, [(1, 1, 0)])]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    return MassFlow(chain, chain.gain.astype(np.int64), {}, exact=False)


def test_rounds_end_when_what_is_left_is_as_little_as_allowed(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    for allowed, rounds in ((2.0**-10, 10), (2.0**-10.5, 11), (2.0**-11, 11)):
        monkeypatch.setattr(module, "REMAINING", allowed)
        values, masses, lost, _ = circle(F(1, 2)).carry_mass()
        assert values.tolist() == [*range(rounds)]
        assert masses.tolist() == [2.0 ** -(k + 1) for k in range(rounds)]
        assert lost == 2.0**-rounds
    monkeypatch.undo()
    with pytest.raises(ModelError, match="after 1,000,000 steps among states"):
        circle(1 - F(1, 10**7)).carry_mass()


def test_masses_as_small_as_the_edge_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    rows: Any = [(0, 0, [(F(1, 4), 1, 1), (F(3, 4), 1, 0)]), (1, 0, [(1, 1, 0)])]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    for dense in (0, 8):
        monkeypatch.setattr(module, "DENSE", dense)
        for edge, kept, lost in ((0.25, [0, 1], 0), (0.26, [0], 0.25)):
            monkeypatch.setattr(module, "EDGE", edge)
            found = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=False).carry_mass()
            assert found[0].tolist() == kept
            assert lost <= found[2] <= lost + 1e-300


def test_products_that_may_underflow_are_counted_as_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    """In arrays each of them may lose a little as soon as the smallest may."""
    monkeypatch.setattr(module, "DENSE", 10**6)
    rows: Any = [
        (0, 0, [(F(1, 2), 1, 1), (F(1, 4), 1, 2), (F(1, 4), 2, 0)]),
        (1, 0, [(F(1, 8), 2, 1), (F(7, 8), 2, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    flow = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=False)
    of = flow.source == 1
    moving = np.array([1, 1]), np.array([0, 1]), np.array([0.5, 0.25])
    share = flow.share[of].min()
    assert share == 0.125
    for edge, lost in ((0.25 * share, 0), (0.26 * share, 4 * module.TINY)):
        monkeypatch.setattr(module, "EDGE", edge)
        flow.lost = 0.0
        flow._handed_on(moving, np.flatnonzero(of)[np.argsort(-flow.share[of])])
        assert flow.lost == lost


def test_arrays_hold_at_most_so_many_numbers_for_each_mass(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two returns, 3 apart, and rewards that are 2 apart: 6 returns in each of 2 states."""
    rows: Any = [
        (0, 0, [(1, 1, 0)]),
        (1, 0, [(F(1, 2), 2, 0), (F(1, 2), 3, 2)]),
        (2, 0, [(1, 4, 0)]),
        (3, 0, [(1, 4, 0)]),
        (4, 0, [(1, 4, 0)]),
    ]
    chain = PolicyChain.of(MDP.from_outcomes(rows), "random")
    flow = MassFlow(chain, chain.gain.astype(np.int64), {}, exact=False)
    outcomes = np.flatnonzero(flow.source == 1)
    moving = np.array([1, 1]), np.array([4, 7]), np.array([0.5, 0.5])
    for dense, fits in ((6, True), (5, False)):
        monkeypatch.setattr(module, "DENSE", dense)
        assert (flow._in_products(moving, outcomes) is not None) is fits

    # The same of sums: 4 returns of states 3 and 4 are 8 numbers for 2 masses.
    sorted_ = list[int]()
    unique = np.unique

    def kept(*given: Any, **how: Any) -> Any:
        sorted_.append(1)
        return unique(*given, **how)

    monkeypatch.setattr(np, "unique", kept)
    parts: Any = [(np.array([3, 4]), np.array([4, 7]), np.array([0.5, 0.25]))]
    for dense, fits in ((4, True), (3, False)):
        monkeypatch.setattr(module, "DENSE", dense)
        assert summed([_sum_masses(parts)]) == {(3, 4): F(1, 2), (4, 7): F(1, 4)}
        assert (sorted_ == []) is fits
        sorted_.clear()


def test_a_bar_is_shown_at_a_terminal_and_only_if_it_takes_long(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    shown = list[dict[str, Any]]()

    def bar(blocks: Any, **how: Any) -> Any:
        shown.append(how)
        return blocks

    monkeypatch.setattr(module, "tqdm", SimpleNamespace(tqdm=bar))
    circle(F(1, 2)).carry_mass()
    assert shown == [{"desc": "returns", "unit": "block", "delay": 2, "disable": None}]
