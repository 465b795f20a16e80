"""A controller that remembers: its belief over the statuses, and the action that it takes.

After a perception z and an action a the belief moves on as in `mdp.care.process`:

    b(s) ← b(s) C(s, z) / Σ,        b'(s') ← Σ_s b(s) T(s, a; x', σ, s') / Σ

The action is that of the place's vector with the greatest α · b. With the vectors of
`solvers.pomdp.pomdp.solve_beliefs` its value is at least the lower bound found there; with those of
`solvers.pomdp.values` it is the QMDP or the fast informed controller (Hauskrecht, Journal of
Artificial Intelligence Research 13, 2000), for which no such bound is known beforehand.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.pomdp.search import Vectors
from exact_mdp.solvers.pomdp.values import fast_informed, qmdp


class BeliefController:
    """Acts in one episode; begins anew with `reset`.

    Parameters
    ----------
    process : Process
        What is known of model and perception.
    vectors : for each of the P places; `BeliefSolution.vectors`, `qmdp_vectors` or `fib_vectors`

    Attributes
    ----------
    place : int or None
        Where the episode is; None after its end.
    belief : (Z,) float
        Probability of each status, after the last perception or move.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> from exact_mdp.mdp.care.perception import independent
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> process = Process.of(mdp, independent([0.9] * 4, [0.9] * 4))
    >>> controller = BeliefController(process, fib_vectors(process))
    >>> controller.act("0000")  # at the start the status is known to be 0000
    'non-directive'
    >>> controller.update(subtask=0, trial=1)  # the trial failed
    >>> controller.act("0010"), round(float(controller.belief[0b0010]), 3)
    ('supportive', 0.92)
    """

    def __init__(self, process: Process, vectors: Sequence[Vectors]) -> None:
        self.process, self.vectors = process, tuple(vectors)
        self.reset()

    def reset(self) -> None:
        """Go back to the start."""
        self.place: int | None = self.process.start_place
        self.belief = self.process.start.copy()
        self._action: int | None = None

    def act(self, perceived: int | str) -> str:
        """Return the name of the action to take where this status is perceived.

        Raises
        ------
        ModelError
            For an unknown status, one that cannot be perceived here, or after the end.
        """
        process = self.process
        column = process.mdp.space.column("status")
        seen = column.parse(perceived) if isinstance(perceived, str) else int(perceived)
        if self.place is None or not 0 <= seen < process.statuses:
            raise ModelError(
                "there is nothing to do after the end" if self.place is None
                else f"there is no status number {seen}",
                where="belief controller",
                fix="call reset()" if self.place is None else "give a status of the model",
            )  # fmt: skip
        self.belief = _conditioned(self.belief * process.confusion[:, seen], "what is perceived")
        known = self.vectors[self.place]
        self._action = int(known.action[int((known.value @ self.belief).argmax())])
        return process.mdp.actions[self._action]

    def update(self, *, events: Sequence[str] = (), **place: int) -> None:
        """Move on to the next place; without columns, to the end.

        Parameters
        ----------
        events : events of the model that were noticed, such as `skip`
        **place : the columns of the next place, such as `subtask=0, trial=1`
        """
        process = self.process
        if self.place is None or self._action is None:
            raise ModelError("no action was taken", where="belief controller", fix="call act()")
        bits = sum(1 << process.mdp.events.index(name) for name in events) & process.mask
        target = process.space.index(**place) if place else None
        for move in process.moves[self.place]:
            if move.place == target and move.signal == bits:
                after = self.belief @ move.chance[self._action]
                self.belief = np.zeros(process.statuses)
                self.belief[move.reach] = _conditioned(after, "the next place")
                break
        else:
            if target is not None:
                raise ModelError(
                    "that place does not follow",
                    where=process.space.label(target),
                    fix="give the next trial or subtask, and the events noticed",
                )
        self.place, self._action = target, None


def qmdp_vectors(process: Process) -> tuple[Vectors, ...]:
    """Return the vectors of the QMDP controller."""
    return _vectors(process, qmdp(process))


def fib_vectors(process: Process) -> tuple[Vectors, ...]:
    """Return the vectors of the fast informed controller."""
    return _vectors(process, fast_informed(process)[..., 0])


def _vectors(process: Process, found: Floats) -> tuple[Vectors, ...]:
    offered = [np.flatnonzero(row) for row in process.offered]
    return tuple(
        Vectors(value=rows[some], action=some) for rows, some in zip(found, offered, strict=True)
    )


def _conditioned(belief: Floats, what: str) -> Floats:
    total = belief.sum()
    if not total > 0:
        raise ModelError(
            f"{what} cannot be, by this model and perception",
            where="belief controller",
            fix="check the confusion matrix, or give zeros a small probability",
        )
    return np.asarray(belief / total)
