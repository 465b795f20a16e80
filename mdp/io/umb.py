"""Exchange with model checkers: models as UMB, the unified Markov binary format (package umbi).

A pair is a choice and an outcome a branch; probabilities are rationals where the model's are. What
the format has no place for is written as annotations of a group of its own, `exact-mdp`, which
other tools pass over:

    start        the initial distribution (the format itself has a set of initial states)
    gain         the reward of each branch, where it is not the choice's alone
    event        the events of each branch, as the bits of a number
    …-doubt      how far numbers may lie from what they were rounded from

The description of `start` is the header of `mdp.io.npz` as JSON: discount, columns and names
of the states, components, events, parameters. So nothing of a model is lost. A file of another
program has no such header; its discount is what the caller says, or 1 with a warning, since the
format has none. To other tools

    rewards/reward   is Σ_i p_i r_i for each choice, from which expected totals are the same,

and every reward component is a reward model of its own, likewise by choice, in floats, called by
its name with underscores for what is no letter or digit (`subtask_complete`). States
where the process has ended carry the label `terminal`; the columns of the state space are the
states' valuations (-1 for the states beside the product). Storm, for one, then answers

    R{"reward"}max=? [F "terminal"].

Source of the format: https://pmc-tools.github.io/umb/spec
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Mapping, Sequence
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, shown_text
from exact_mdp.mdp.io.files import write_atomically
from exact_mdp.mdp.io.npz import parts_of
from exact_mdp.mdp.io.umb_read import GROUP, Content, read
from exact_mdp.mdp.io.umb_write import archive_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import (
    Integers,
    Numbers,
    OutcomeTable,
    common,
    exact,
    integers,
    ones,
    shown,
)
from exact_mdp.mdp.validate import as_discount, as_start

Row = tuple[int, int, list[tuple[Any, int, Any]]]


def save(mdp: MDP, path: str | Path) -> None:
    """Write a model as a UMB file, from which `load` returns all of it.

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
    ...     load(f"{folder}/small.umb").table.row(0)
    [(Fraction(1, 3), 0, Fraction(1, 7)), (Fraction(2, 3), 1, Fraction(0, 1))]
    """
    write_atomically(path, archive_of(mdp))


def load(
    path: str | Path,
    *,
    discount: object | None = None,
    reward: str | None = None,
    start: object = None,
) -> MDP:
    """Read a Markov chain or decision process from a UMB file.

    Parameters
    ----------
    discount : number or "p/q", optional
        Instead of the model's own. The format has none: where another program wrote the file, it
        is 1 unless it is given, and a warning says so.
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
        if content.header is not None:
            return _own(content, content.header, discount, start)
        if discount is None:
            warnings.warn(
                f"{shown_text(where)}: a UMB file of another program says no discount, so that 1 "
                "is taken; give one",
                stacklevel=2,
            )
        rows = list(_rows(content))
        return MDP.from_outcomes(
            rows,
            1 if discount is None else discount,
            start=_start(content) if start is None else start,
            actions=content.action_names,
            name=content.name or Path(path).stem,
        )
    except ModelError as error:
        if error.where.startswith(shown_text(where)):
            raise
        place = f"{where}, {error.where}" if error.where else where
        raise ModelError(error.what, where=place, fix=error.fix) from error


# ---- our own files -------------------------------------------------------------------------------


def _own(content: Content, header: Mapping[str, Any], discount: object, start: object) -> MDP:
    """Return a model that `save` wrote, with everything that the header says of it."""
    choices = np.diff(content.state_to_choices)
    if not choices.all():
        raise _changed("a state without choices")
    parts = parts_of(header, pairs=len(content.actions))
    if content.listed_actions != parts["actions"]:
        raise _changed("the names of the actions")
    if {state for state, yes in enumerate(content.initial) if yes} != {
        state for state, weight in parts["start"] if weight > 0
    }:
        raise _changed("the initial states")
    if len(content.components) not in (0, len(parts["component_names"])):
        raise _changed("the components of the reward")
    if not content.ours:
        parts["component_names"] = ("reward",)
    elif content.components:
        parts["components"] = np.array(content.components, dtype=np.float64).T
    if discount is not None:
        parts["discount_exact"] = as_discount(discount)
    if start is not None:
        parts["start"] = as_start(start)
    states = np.repeat(np.arange(len(choices)), choices)
    mdp = MDP(_table(content), states, np.array(content.actions, dtype=np.int64), **parts)
    if content.ours and content.gain is not None:
        _check_rewards(content, mdp)
    return mdp


def _table(content: Content) -> OutcomeTable:
    """Return the table of outcomes, every number as it was written."""
    offsets = np.array(content.choice_to_branches, dtype=np.int64)
    weight, denominator = _stored(content.probability, offsets)
    gains, ends = content.gain, offsets
    if gains is None:
        fixed = _fixed(content)
        gains, ends = fixed, np.arange(len(fixed) + 1)
        if any(content.branch_reward):
            counts = np.diff(offsets).tolist()
            each = [value for value, count in zip(fixed, counts, strict=True) for _ in range(count)]
            gains, ends = [a + b for a, b in zip(each, content.branch_reward, strict=True)], offsets
    gain, gain_denominator = _stored(gains, ends)
    doubts = {name: np.array(values, dtype=np.float64) for name, values in content.doubts.items()}
    return OutcomeTable(
        offsets=offsets,
        next=np.array(content.target, dtype=np.int64),
        weight=weight,
        denominator=denominator,
        gain=gain,
        gain_denominator=gain_denominator,
        event=None if content.event is None else np.array(content.event, dtype=np.uint8),
        **doubts,
    )


def _fixed(content: Content) -> list[Any]:
    """Return the rewards of choices, those of their states among them."""
    return [
        content.state_reward[state] + content.choice_reward[choice]
        for state, (first, last) in enumerate(pairwise(content.state_to_choices))
        for choice in range(first, last)
    ]


def _stored(values: Sequence[Any], offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return numbers as an array with one denominator for each group of them."""
    groups = len(offsets) - 1
    if values and all(isinstance(value, float) for value in values):
        return np.array(values, dtype=np.float64), ones(groups)
    tops: list[int] = []
    bottoms: list[int] = []
    for first, last in pairwise(offsets.tolist()):
        top, bottom = common([exact(value) for value in values[first:last]])
        tops += top
        bottoms.append(bottom)
    return integers(tops), integers(bottoms)


def _check_rewards(content: Content, mdp: MDP) -> None:
    """Raise ModelError unless the rewards of branches average to those of the choices.

    Exact numbers agree exactly. Floats agree within the rounding of a sum of n products, which is
    at most (n + 3) 2^-52 Σ |p r|, and (n + 1) 2^-1074 below the range of normal floats.
    """
    fixed, table = _fixed(content), mdp.table
    if np.float64 not in (table.weight.dtype, table.gain.dtype):
        top, bottom = table.expected_gain_exact()
        pairs = zip(top.tolist(), bottom.tolist(), fixed, strict=True)
        wrong = np.array([Fraction(a, b) != exact(wanted) for a, b, wanted in pairs])
    else:
        counts = np.diff(table.offsets)
        with np.errstate(over="ignore"):
            scale = np.add.reduceat(
                np.abs(table.probabilities() * table.gains()), table.offsets[:-1]
            )
            given = np.array([float(wanted) for wanted in fixed])
            slack = (counts + 3) * 2.0**-52 * scale + (counts + 1) * 2.0**-1074
            wrong = ~(np.abs(mdp.reward - given) <= slack)
    if wrong.any():
        pair = int(np.flatnonzero(wrong)[0])
        raise _averaged(exact(float(mdp.reward[pair])), exact(fixed[pair]), mdp.where(pair))


def _averaged(total: Fraction, wanted: Fraction, where: str) -> ModelError:
    return ModelError(
        f"rewards of branches average {shown(total)}, the choice's is {shown(wanted)}",
        where=where,
        fix=f"change both, or drop the annotation {GROUP}/gain",
    )


def _changed(what: str) -> ModelError:
    return ModelError(
        f"another program changed {what}",
        where=f"annotations/{GROUP}",
        fix=f"drop the annotations of the group {GROUP}, which are no longer of this model",
    )


# ---- files of other programs ---------------------------------------------------------------------


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
        exact_gains = [exact(gain) for gain in gains]
        terms = [exact(p) * r for p, r in zip(chances, exact_gains, strict=True)]
        total, wanted = sum(terms, Fraction(0)), exact(fixed)
        slack = Fraction(0)
        if any(isinstance(number, float) for number in (*chances, *gains, fixed)):
            tiny = (len(terms) + 1) * Fraction(2) ** -1074
            slack = (len(terms) + 3) * Fraction(2) ** -52 * sum(map(abs, terms)) + tiny
        if abs(total - wanted) > slack:
            raise _averaged(total, wanted, f"state {state}, choice {choice}")
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
        fix="pass start= to mdp.io.umb.load, or write the file with one initial state",
    )
