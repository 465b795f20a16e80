"""Exchange with model checkers: models as UMB, the unified Markov binary format (package umbi).

A pair is a choice and an outcome a branch; probabilities are rationals where the model's are. Two
things that the format has no place for are written as annotations of a group of their own,
`exact-mdp`, which other tools pass over: `start`, the initial distribution (the format itself has
a set of initial states), and `gain`, the reward of each branch. To other tools

    rewards/reward   is Σ_i p_i r_i for each choice, from which expected totals are the same,

and every reward component is a reward model of its own, likewise by choice, in floats, called by
its name with underscores for what is no letter or digit (`subtask_complete`). States
where the process has ended carry the label `terminal`; the columns of the state space are the
states' valuations (-1 for the states beside the product). Storm, for one, then answers

    R{"reward"}max=? [F "terminal"].

The format holds no discount. Components, events, parameters and the names of states do not come
back from it; `mdp.interop.npz` keeps everything.

Source of the format: https://pmc-tools.github.io/umb/spec
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

from mdp.errors import ModelError
from mdp.files import write_atomically
from mdp.interop.umb_read import Content, read
from mdp.interop.umb_write import archive_of
from mdp.model import MDP
from mdp.table import exact, shown

Row = tuple[int, int, list[tuple[Any, int, Any]]]


def save(mdp: MDP, path: str | Path) -> None:
    """Write a model as a UMB file; the discount is left out.

    Raises
    ------
    ModelError
        Where umbi is not installed or the file cannot be written.

    Examples
    --------
    >>> import tempfile
    >>> mdp = MDP.from_outcomes([(0, 0, [("1/3", 0, "1/7"), ("2/3", 1, 0)]), (1, 0, [(1, 1, 0)])])
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     save(mdp, f"{folder}/small.umb")
    ...     load(f"{folder}/small.umb", discount="1/2").table.row(0)
    [(Fraction(1, 3), 0, Fraction(1, 7)), (Fraction(2, 3), 1, Fraction(0, 1))]
    """
    write_atomically(path, archive_of(mdp))


def load(
    path: str | Path, *, discount: object = 1, reward: str | None = None, start: object = None
) -> MDP:
    """Read a Markov chain or decision process from a UMB file.

    Parameters
    ----------
    discount : number or "p/q"
        Not part of the format.
    reward : str, optional
        Name of a reward model; may be left out where there is one alone, or one called "reward".
        Its rewards of states, choices and branches add up.
    start : state, or {state: probability}, optional
        Needed where the file has several initial states, or none, and no distribution over them.

    Raises
    ------
    ModelError
        Where the file cannot be read, is damaged, or holds a model of another kind: in continuous
        time, of several players, partially observable, with intervals for probabilities.
    """
    where = str(path)
    try:
        content = read(path, reward)
        rows = list(_rows(content))
        return MDP.from_outcomes(
            rows,
            discount,
            start=_start(content) if start is None else start,
            actions=content.action_names,
            name=content.name or Path(path).stem,
        )
    except ModelError as error:
        place = f"{where}, {error.where}" if error.where else where
        raise ModelError(error.what, where=place, fix=error.fix) from error


def _rows(content: Content) -> Iterator[Row]:
    """Yield every pair; a state without choices is where the process ends, and stays put."""
    for state, (first, last) in enumerate(pairwise(content.state_to_choices)):
        if first == last:
            if content.state_reward[state] != 0:
                raise ModelError(
                    f"a reward of {content.state_reward[state]} in a state without choices",
                    where=f"state {state}",
                    fix="add a choice that stays there, or drop the reward",
                )
            yield state, 0, [(1, state, 0)]
        for choice in range(first, last):
            yield state, content.actions[choice], _outcomes(content, state, choice)


def _outcomes(content: Content, state: int, choice: int) -> list[tuple[Any, int, Any]]:
    first, last = content.choice_to_branches[choice : choice + 2]
    fixed = content.state_reward[state] + content.choice_reward[choice]
    if content.gain is None:
        gains = [fixed + earned for earned in content.branch_reward[first:last]]
    else:
        gains = content.gain[first:last]
        chances = content.probability[first:last]
        terms = [exact(p) * exact(r) for p, r in zip(chances, gains, strict=True)]
        total, wanted = sum(terms, Fraction(0)), exact(fixed)
        if abs(total - wanted) * 10**9 > sum(map(abs, terms), abs(wanted)):
            raise ModelError(
                f"rewards of branches average {shown(total)}, the choice's is {shown(wanted)}",
                where=f"state {state}, choice {choice}",
                fix="change both, or drop the annotation exact-mdp/gain",
            )
    return list(
        zip(content.probability[first:last], content.target[first:last], gains, strict=True)
    )


def _start(content: Content) -> object:
    if content.start is not None:
        return {state: weight for state, weight in enumerate(content.start) if weight != 0}
    initial = [state for state, yes in enumerate(content.initial) if yes]
    if len(initial) == 1:
        return initial[0]
    raise ModelError(
        f"{len(initial)} initial states and no distribution over them",
        where="state-is-initial",
        fix="pass start= to mdp.interop.umb.load, or write the file with one initial state",
    )
