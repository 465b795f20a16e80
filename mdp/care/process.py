"""Acting on a perceived status, seen as a decision process whose status is hidden.

A state is a *place* x (all columns but the status) and a status s. At every timestep the actor
knows the place, perceives z with probability C(s, z), and acts; the next place x' is known, and so
is the *signal* σ: which of the model's events happened (that a subtask was skipped, say, which the
robot that skips it knows). Rewards are not observed. With

    T(s, a; x', σ, s') = P(x', s', σ | x, s, a)

a belief b over the statuses, before perceiving, turns into b(s) C(s, z) after it, and that into
Σ_s b(s) C(s, z) T(s, a; x', σ, s') at the next place, each up to its sum, which is the probability
of what was seen (mixed observability: Ong, Png, Hsu and Lee, International Journal of Robotics
Research 29, 2010). Places never come back, as trials and subtasks are counted, so the horizon is
finite and everything is computed from the last place to the first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from graphlib import CycleError, TopologicalSorter

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.care.perception import checked, status_size
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike
from exact_mdp.mdp.result import Brief
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Floats, Integers


@dataclass(frozen=True, kw_only=True, eq=False)
class Move:
    """A next place and signal, with the statuses that one may have there.

    Attributes
    ----------
    place, signal : int
        The next place; the event bits that are seen.
    reach : (R,) int64
        Statuses possible there.
    chance : (A, Z, R) float
        Probability of this place, signal and status after each action in each status.
    """

    place: int
    signal: int
    reach: Integers
    chance: Floats


@dataclass(frozen=True, kw_only=True, eq=False, repr=False)
class Process(Brief):
    """A model whose status is hidden, P places by Z statuses by A actions.

    Attributes
    ----------
    mdp : MDP
    confusion : (Z, Z) float
        Probability of the perceived status (column) given the true one (row).
    order : tuple of int
        Places that can be reached, each before those that follow it.
    moves : tuple of tuples of Move
        For each of the P places; none where nothing follows but the end.
    reward : (P, Z, A) float
        Expected reward; 0 for actions that are not available.
    offered : (P, A) bool
        Actions available at each place, the same in all its statuses.
    start_place : int
    start : (Z,) float
        The belief at the start, before perceiving.
    """

    mdp: MDP
    confusion: Floats
    order: tuple[int, ...]
    moves: tuple[tuple[Move, ...], ...]
    reward: Floats
    offered: NDArray[np.bool_]
    start_place: int
    start: Floats

    @property
    def statuses(self) -> int:
        """Number of status vectors, Z."""
        return len(self.confusion)

    @property
    def discount(self) -> float:
        """The discount as a float."""
        return self.mdp.discount

    @cached_property
    def space(self) -> StateSpace:
        """The places, by the columns that they are made of."""
        return StateSpace(columns=self.mdp.space.columns[:-1])

    @cached_property
    def depth(self) -> int:
        """Timesteps from the start to the end at most."""
        steps = np.ones(len(self.moves), dtype=np.int64)
        for place in reversed(self.order):
            steps[place] += max((int(steps[m.place]) for m in self.moves[place]), default=0)
        return int(steps[self.start_place])

    @cached_property
    def terms(self) -> int:
        """Roundings that one step of a backward pass can leave in a number, at most."""
        followers = max((len(found) for found in self.moves), default=0)
        widest = int(np.diff(self.mdp.table.offsets).max())
        return widest + followers + 2 * self.statuses + len(self.mdp.actions) + 12

    def with_confusion(self, confusion: ArrayLike) -> Process:
        """Return the same model under another perception."""
        return replace(self, confusion=_normalised(confusion, self.statuses))

    def table(self, policy: PolicyLike) -> Floats:
        """Return (P, Z, A) what a policy does at each place and *perceived* status."""
        return _spread(self.mdp, Policy.of(self.mdp, policy).weights(self.mdp)).copy()

    @classmethod
    def of(cls, mdp: MDP, confusion: ArrayLike, *, events: Sequence[str] | None = None) -> Process:
        """Return the process of a model and a perception.

        Parameters
        ----------
        mdp : MDP with a column `status`, the one that moves fastest
        confusion : (Z, Z) probabilities of the perceived status (column) given the true one (row)
        events : names of the model's events that the actor notices; all of them unless given

        Raises
        ------
        ModelError
            Where the model has no statuses, places come back, statuses of one place offer
            different actions, or the start is spread over places.

        Examples
        --------
        >>> from exact_mdp import Scenario
        >>> process = Process.of(Scenario.load("yuan2025").compile(), np.eye(16))
        >>> len(process.order), process.depth, [move.place for move in process.moves[4]]
        (15, 15, [5, 5])
        """
        size = status_size(mdp)
        matrix = _normalised(confusion, size)
        moves = _moves(mdp, size, _mask(mdp, events))
        places = {state // size for state, weight in mdp.start if weight}
        if len(places) != 1 or max(places) * size >= mdp.space.regular:
            raise ModelError(
                "episodes begin at several places, or at the end",
                where="start",
                fix="choose one place; its status may be uncertain",
            )
        start_place = places.pop()
        first = start_place * size
        return cls(
            mdp=mdp,
            confusion=matrix,
            order=_order(mdp, moves, start_place),
            moves=moves,
            reward=_spread(mdp, np.where(mdp.terminal[mdp.pair_state], 0.0, mdp.reward)),
            offered=_offered(mdp),
            start_place=start_place,
            start=mdp.start_distribution[first : first + size],
        )


def _normalised(confusion: ArrayLike, size: int) -> Floats:
    """Return a confusion matrix whose rows sum to 1 up to rounding, not only up to a tolerance."""
    matrix = checked(confusion, size=size, where="confusion matrix")
    matrix = np.asarray(matrix / matrix.sum(axis=1, keepdims=True))
    matrix.setflags(write=False)
    return matrix


def _mask(mdp: MDP, events: Sequence[str] | None) -> int:
    names = mdp.events if events is None else tuple(events)
    for name in names:
        if name not in mdp.events:
            raise ModelError(
                f"unknown event {name!r}",
                where="events",
                fix=f"choose one of {', '.join(mdp.events)}"
                if mdp.events
                else "the model has no events",
            )
    return sum(1 << mdp.events.index(name) for name in set(names))


def _moves(mdp: MDP, size: int, mask: int) -> tuple[tuple[Move, ...], ...]:
    """Return the moves of every place, outcomes that end the episode left out."""
    table, regular = mdp.table, mdp.space.regular
    pair = table.pair
    state, action, following = mdp.pair_state[pair], mdp.pair_action[pair], table.next
    if not mdp.terminal[regular:].all():
        raise ModelError(
            "a state without a status is not an end", where="perception", fix="use a scenario"
        )
    signal = np.zeros(len(pair), dtype=np.int64)
    if table.event is not None:
        signal = table.event.astype(np.int64) & mask
    kept = ~mdp.terminal[state] & (following < regular) & ~mdp.terminal[following]
    state, action, following = state[kept], action[kept], following[kept].astype(np.int64)
    signal, chance = signal[kept], table.probabilities()[kept]
    place, target = state // size, following // size
    keys = np.stack([place, target, signal])
    found, group = np.unique(keys, axis=1, return_inverse=True)
    moves: list[list[Move]] = [[] for _ in range(regular // size)]
    if not kept.any():
        return tuple(tuple(each) for each in moves)
    order = np.argsort(group.reshape(-1), kind="stable")
    cuts = np.cumsum(np.bincount(group.reshape(-1), minlength=found.shape[1]))[:-1]
    for (here, there, seen), rows in zip(found.T.tolist(), np.split(order, cuts), strict=True):
        reach, column = np.unique(following[rows] % size, return_inverse=True)
        law = np.zeros((mdp.n_actions, size, len(reach)))
        np.add.at(law, (action[rows], state[rows] % size, column.reshape(-1)), chance[rows])
        for array in (law, reach):
            array.setflags(write=False)
        moves[here].append(Move(place=there, signal=seen, reach=reach, chance=law))
    return tuple(tuple(each) for each in moves)


def _spread(mdp: MDP, values: Floats | NDArray[np.bool_]) -> Floats:
    """Return (P, Z, A) by place, status and action what `values` (L,) are by pair, else 0."""
    by_state = np.zeros((mdp.n_states, mdp.n_actions))
    by_state[mdp.pair_state, mdp.pair_action] = values
    found = by_state[: mdp.space.regular].reshape(-1, status_size(mdp), mdp.n_actions)
    found.setflags(write=False)
    return found


def _offered(mdp: MDP) -> NDArray[np.bool_]:
    by_place = _spread(mdp, np.ones(mdp.n_pairs)) > 0
    differ = (by_place != by_place[:, :1]).any(axis=(1, 2))
    if differ.any():
        place = int(np.flatnonzero(differ)[0])
        raise ModelError(
            "the available actions reveal the status",
            where=f"state ({mdp.space.label(place * by_place.shape[1])}) and its other statuses",
            fix="offer the same actions in every status of a place",
        )
    return by_place[:, 0]


def _order(mdp: MDP, moves: Sequence[Sequence[Move]], start: int) -> tuple[int, ...]:
    """Return the places reached from the start, each before those that follow it."""
    before: dict[int, set[int]] = {start: set()}
    stack = [start]
    while stack:
        here = stack.pop()
        for move in moves[here]:
            if move.place not in before:
                before[move.place] = set()
                stack.append(move.place)
            before[move.place].add(here)
    try:
        return tuple(TopologicalSorter(before).static_order())
    except CycleError as error:
        stuck = min(error.args[1])
        raise ModelError(
            "a place can recur, and beliefs are tracked over a finite horizon only",
            where=f"state ({mdp.space.label(stuck * mdp.space.columns[-1].size)})",
            fix="use a scenario: its trials and subtasks are counted",
        ) from error
