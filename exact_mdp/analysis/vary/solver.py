"""Optima and policies' values at many draws of a model's parameters.

A care scenario goes through batched loops that never form the model (`solvers.care`). Any other
parametric model is built, solved and evaluated draw by draw. Both answer with the same arrays.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from math import inf
from typing import TypeAlias

import numpy as np

from exact_mdp.analysis.vary.base_case import BaseCase, finite_optimum, finite_worth
from exact_mdp.mdp.care.scenario import Scenario, ScenarioFamily
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parametric import Parametric
from exact_mdp.mdp.table import Floats, Integers, Numbers
from exact_mdp.solvers.bounds.gains import gains
from exact_mdp.solvers.care import MOST_ACTIONS, MOST_STATUSES, cut_off, optimal, policy_values
from exact_mdp.solvers.parallel import Arrays
from exact_mdp.solvers.solution import Solution

SHOWN = 3  # parameters of a draw that an error names


def distinct(rows: Numbers) -> tuple[Numbers, Integers]:
    """Return the (U, G) different rows of (D, G) small integers, and (D,) which of them each is.

    They come in order of appearance. Rows are distinguished by two 64-bit sums of random odd
    multiples; that two rows which differ have both sums in common is about as likely as guessing a
    number of 128 bits.
    """
    width = rows.shape[1] * rows.dtype.itemsize
    padded = np.zeros((len(rows), -(-width // 8) * 8), dtype=np.uint8)
    padded[:, :width] = np.ascontiguousarray(rows).view(np.uint8)
    words = padded.view(np.uint64)
    keys = np.random.default_rng(0).integers(0, 2**63, size=(words.shape[1], 2), dtype=np.uint64)
    sums = words @ (2 * keys + 1)
    both = np.ascontiguousarray(sums).view([("a", np.uint64), ("b", np.uint64)]).reshape(-1)
    _, where, inverse = np.unique(both, return_index=True, return_inverse=True)
    order = np.argsort(where)
    return rows[where[order]], np.argsort(order)[inverse.reshape(-1)]


def merged(blocks: Sequence[Mapping[str, np.ndarray]]) -> tuple[Numbers, Integers]:
    """Return the different rows of several blocks, in order of appearance, and each draw's."""
    rows, place = distinct(np.concatenate([block["rows"] for block in blocks]))
    ends = np.cumsum([len(block["rows"]) for block in blocks])[:-1]
    places = np.split(place, ends)
    return rows, np.concatenate([p[b["which"]] for p, b in zip(places, blocks, strict=True)])


def models(
    model: Parametric, names: Sequence[str], draws: Floats, first: int | None = None
) -> Iterator[tuple[int, MDP]]:
    """Yield each draw's number and model; an error names the draw, counted from `first`."""
    for d, row in enumerate(draws.tolist()):
        try:
            yield d, model.at(dict(zip(names, row, strict=True)))
        except ModelError as error:
            if first is None:
                raise
            where = f"draw {first + d}, {error.where}"
            raise ModelError(error.what, where=where, fix=error.fix) from error


def _at(names: Sequence[str], draw: Floats) -> str:
    """Return the parameters of a draw in words, the first few of many."""
    drawn = zip(names[:SHOWN], draw.tolist(), strict=False)
    more = ", …" if len(names) > SHOWN else ""
    return ", ".join(f"{name} = {x:g}" for name, x in drawn) + more


class ModelSolver:
    """One draw after the other; labels are the states in which there is a choice.

    Attributes
    ----------
    base : BaseCase
        The model at today's values, to whose pairs policies refer.
    block, pool : int
        Draws in one piece of work, and draws of largest regret in which policies are compared to
        choose candidates.
    compiled : bool
        Whether compiled loops do the work, which threads can share.
    labels, actions : tuples of X and A words
        Where choices are reported, and between what.
    """

    block, pool = 64, 32
    compiled = False

    def __init__(self, model: Parametric) -> None:
        self.model = model
        mdp = model.at({})
        self.base = BaseCase(mdp=mdp)
        self.actions = mdp.actions
        self.choosing = np.flatnonzero(~mdp.forced)
        self.labels = tuple(mdp.space.labels(self.choosing))

    def solved(self, names: Sequence[str], draws: Floats) -> Arrays:
        """Return the optima of (D, Q) draws.

        start, error (D,); best (X, A), draws in which an action is optimal up to rounding; lost
        (D, A), what each first action costs, NaN where it is not offered, (D, 0) where there is
        more than one first state; rows (U, G), the policies found, and which (D,) of them is a
        draw's; cut (D,), whether a chance was cut off at 1, of compiled solvers alone.
        """
        mdp, count = self.base.mdp, len(draws)
        start, error = np.empty(count), np.empty(count)
        counts = np.zeros((mdp.n_states, mdp.n_actions), dtype=np.int64)
        first = [state for state, _ in mdp.start]
        lost = np.full((count, mdp.n_actions if len(first) == 1 else 0), np.nan)
        policies = np.empty((count, mdp.n_states), dtype=np.int16)
        for d, drawn in models(self.model, names, draws):
            solution = finite_optimum(drawn, _at(names, draws[d]))
            start[d], error[d] = solution.start.value, solution.start.error
            gap, noise = self._gaps(drawn, solution)
            error_there = solution.state_error
            doubt = error_there[mdp.pair_state] + drawn.discount * (drawn.transition @ error_there)
            near = gap <= doubt + noise
            counts[mdp.pair_state[near], mdp.pair_action[near]] += 1
            policies[d] = solution.policy
            if len(first) == 1:
                here = mdp.pair_state == first[0]
                lost[d, mdp.pair_action[here]] = np.maximum(gap[here], 0.0)
        rows, which = distinct(policies)
        return {
            "start": start,
            "error": error,
            "best": counts[self.choosing],
            "lost": lost,
            "rows": rows,
            "which": which,
            "cut": np.zeros(count, dtype=bool),
        }

    def _gaps(self, mdp: MDP, solution: Solution) -> tuple[Floats, Floats]:
        """Return what each pair (L,) loses, and the rounding of that.

        Some states may be worth ±∞, though the start is not: a pair that leads to -∞ is worth that,
        else one that leads to +∞ that; it loses nothing where its state is worth the same.
        """
        value, here = solution.value, mdp.pair_state
        far = np.isinf(value)
        known = np.where(far, 0.0, value)
        found = gains(mdp, known)
        gap = self.base.sign * (known[here] - mdp.backup(known))
        if far.any():
            ahead = np.zeros(mdp.n_pairs)
            for sign in (inf, -inf):
                ahead[mdp.transition @ (value == sign).astype(float) > 0] = sign
            off = far[here] | np.isinf(ahead)
            gap[off] = np.where(value[here] == ahead, 0.0, inf)[off]
        return gap, found.noise

    def values(
        self,
        names: Sequence[str],
        draws: Floats,
        policies: Sequence[Floats],
        *,
        optimum: bool = False,
        first: int | None = None,
    ) -> Arrays:
        """Return value (D, N) and error (D, N) of N policies, each (L,) probabilities of pairs.

        With `optimum` its column comes before those of the policies, (D, 1 + N).
        """
        value = np.empty((len(draws), optimum + len(policies)))
        error = np.empty_like(value)
        for d, drawn in models(self.model, names, draws, first):
            where = _at(names, draws[d]) if first is None else f"draw {first + d}"
            found = [finite_optimum(drawn, where).start] if optimum else []
            found += [finite_worth(drawn, weights, where) for weights in policies]
            value[d], error[d] = [x.value for x in found], [x.error for x in found]
        return {"value": value, "error": error}

    def weights(self, row: Integers) -> Floats:
        """Return (L,) probabilities of pairs from a row of `solved`."""
        return self.base.taken(row)

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """Return the action at each label, where the policy says one and the same there."""
        mdp, found = self.base.mdp, {}
        for state, label in zip(self.choosing.tolist(), self.labels, strict=True):
            pairs = mdp.pairs_of(state)
            share = weights[list(pairs)]
            if share.max() != 1:
                return None
            found[label] = mdp.actions[int(mdp.pair_action[pairs[int(share.argmax())]])]
        return found


class CareSolver:
    """Batches of draws of a care scenario; labels are the statuses, at subtask 0, trial 0.

    Attributes and methods are those of `ModelSolver`.
    """

    block, pool = 4096, 1000
    compiled = True

    def __init__(self, model: ScenarioFamily) -> None:
        self.scenario: Scenario = model.scenario
        self.base = BaseCase(mdp=model.at({}))
        count = len(self.scenario.statuses)
        self.actions = self.scenario.actions
        self.labels = tuple(f"{number:0{count}b}" for number in range(2**count))
        self.sizes = tuple(column.size for column in self.base.mdp.space.columns)
        flags = self.sizes[2] if len(self.sizes) == 4 else 1
        self.shape = (self.sizes[0], self.scenario.trials, flags, 2**count)

    def solved(self, names: Sequence[str], draws: Floats) -> Arrays:
        """Return the optima of (D, Q) draws; see `ModelSolver.solved`."""
        found = optimal(self.scenario, names, draws, gaps=True, actions=True)
        assert found.gaps is not None
        assert found.actions is not None
        rows, which = distinct(found.actions.reshape(len(draws), -1))
        return {
            "start": found.start,
            "error": found.error,
            "best": (found.gaps <= 2 * found.error[:, None, None]).sum(axis=0),
            "lost": found.gaps[:, 0],
            "rows": rows,
            "which": which,
            "cut": cut_off(self.scenario, names, draws),
        }

    def values(
        self,
        names: Sequence[str],
        draws: Floats,
        policies: Sequence[Floats],
        *,
        optimum: bool = False,
        first: int | None = None,
    ) -> Arrays:
        """Return value (D, N) and error (D, N) of N policies; see `ModelSolver.values`."""
        tables = [self.by_state(weights) for weights in policies]
        value = np.empty((len(draws), optimum + len(tables)))
        error = np.empty_like(value)
        if optimum:
            best = optimal(self.scenario, names, draws)
            value[:, 0], error[:, 0] = best.start, best.error
        # Policies of one kind are evaluated together: pure or mixed, by status or by state.
        kinds: dict[tuple[bool, bool], list[int]] = {}
        for number, table in enumerate(tables):
            pure = bool((table.max(axis=-1) == 1).all())
            same = bool((table == table[:1, :1, :1]).all())
            kinds.setdefault((pure, same), []).append(number)
        for (pure, same), numbers in kinds.items():
            chosen = np.stack([tables[number] for number in numbers])
            chosen = chosen[:, 0, 0, 0] if same else chosen
            chosen = chosen.argmax(axis=-1) if pure else chosen
            found = policy_values(self.scenario, names, draws, chosen)
            columns = np.array(numbers) + optimum
            value[:, columns], error[:, columns] = found.mean, found.error[:, None]
        return {"value": value, "error": error}

    def weights(self, row: Integers) -> Floats:
        """Return (L,) probabilities of pairs from a row of `solved`."""
        mdp = self.base.mdp
        whole = np.zeros((self.shape[0], self.sizes[1], *self.shape[2:]), dtype=np.int64)
        whole[:, : self.shape[1]] = np.reshape(row, self.shape)
        choice = np.append(whole.reshape(-1), np.zeros(mdp.n_states - whole.size, dtype=np.int64))
        return self.base.taken(choice)

    def shown(self, weights: Floats) -> dict[str, str] | None:
        """Return the action at each label, where the policy says one and the same there."""
        table = self.by_state(weights)
        if not ((table == table[:1, :1, :1]).all() and (table.max(axis=-1) == 1).all()):
            return None
        chosen = table[0, 0, 0].argmax(axis=-1)
        return {label: self.actions[a] for label, a in zip(self.labels, chosen, strict=True)}

    def by_state(self, weights: Floats) -> Floats:
        """Return (K, trials, flags, V, A) probabilities of actions from (L,) ones of pairs.

        K subtasks, V status vectors; flags are two where a reading remembers skips, else one.
        """
        mdp = self.base.mdp
        table = np.zeros((mdp.n_states, mdp.n_actions))
        table[mdp.pair_state, mdp.pair_action] = weights
        shape = (self.shape[0], self.sizes[1], *self.shape[2:])
        table = table[: mdp.space.regular].reshape(*shape, mdp.n_actions)
        numbers = [mdp.action(name) for name in self.scenario.actions]
        # A last trial in which a skip is the only action is not a trial of the loops.
        return table[:, : self.shape[1]][..., numbers]


DrawSolver: TypeAlias = ModelSolver | CareSolver


def solver_of(model: Parametric) -> DrawSolver:
    """Return the fastest way to solve a model at many draws."""
    if isinstance(model, ScenarioFamily):
        scenario = model.scenario
        if len(scenario.statuses) <= MOST_STATUSES and len(scenario.actions) <= MOST_ACTIONS:
            return CareSolver(model)
    return ModelSolver(model)


def tell_cut(
    model: Parametric, names: Sequence[str], draws: Floats, cut: np.ndarray | None = None
) -> None:
    """Warn once where a chance of a scenario is cut off at 1 in some draw; workers keep silent.

    Where it is not known in which draws, `cut` (D,), the largest numbers of all are looked at.
    """
    if not isinstance(model, ScenarioFamily):
        return
    if cut is None:
        model.tell(dict(zip(names, draws.max(axis=0).tolist(), strict=True)), where=", in draws")
    elif cut.any():
        first = int(cut.argmax())
        where = f", {int(cut.sum())} of {len(draws)} draws, the first of them draw {first}"
        model.tell(dict(zip(names, draws[first].tolist(), strict=True)), where=where)
