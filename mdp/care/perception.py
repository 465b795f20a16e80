"""Acting on a perceived status: the confusion of statuses, and the policy that it induces.

Whoever acts sees the status z with probability C(s, z) where it is s, draws seen anew at every
timestep. A policy π that acts on what it sees is, in the true state, the mixed policy

    π_C(a | s) = Σ_z C(s, z) π(a | z),

which everything that evaluates policies takes as it is. The other columns are seen as they are.
Files may state rationals; what is used is each number rounded to the nearest float, and so are the
probabilities π_C. What is exact elsewhere is exact for these: 0.9 is then the dyadic number
nearest to it.
"""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.mdp.errors import ModelError, suggest
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike
from exact_mdp.mdp.table import FLOAT_ROW_TOLERANCE, Floats, beside, exact, float_array


def perceived(mdp: MDP, policy: PolicyLike, confusion: ArrayLike) -> Policy:
    """Return the policy that acts on perceived statuses, as a mixed policy of the true state.

    Parameters
    ----------
    mdp : MDP with a column `status`, the one that moves fastest
    policy : anything that `Policy.of` takes
    confusion : (Z, Z) probabilities of the perceived status (column) given the true one (row)

    Raises
    ------
    ModelError
        Where the matrix does not fit the statuses, or a row is not a distribution.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> blind = np.full((16, 16), 1 / 16)
    >>> perceived(mdp, {f"{s:04b}": "none" for s in range(16)}, blind).weights(mdp)[:4]
    array([1., 0., 0., 0.])
    """
    matrix = checked(confusion, size=status_size(mdp), where="confusion matrix")
    by_action = np.zeros((mdp.n_states, mdp.n_actions))
    by_action[mdp.pair_state, mdp.pair_action] = Policy.of(mdp, policy).weights(mdp)
    regular = mdp.space.regular
    places = by_action[:regular].reshape(-1, len(matrix), mdp.n_actions)
    by_action[:regular] = (matrix @ places).reshape(regular, mdp.n_actions)
    return Policy(space=mdp.space, actions=mdp.actions, rule=by_action)


def independent(sensitivity: Sequence[float], specificity: Sequence[float]) -> Floats:
    """Return the (2^n, 2^n) confusion of n statuses that are told apart independently.

    Parameters
    ----------
    sensitivity, specificity : (n,)
        Probability that a status is seen where it is present, and not seen where it is absent.

    Examples
    --------
    >>> independent([0.75], [0.5]).tolist()
    [[0.5, 0.5], [0.25, 0.75]]
    """
    matrix = np.ones((1, 1))
    for hit, clear in zip(sensitivity, specificity, strict=True):
        matrix = np.kron(matrix, np.array([[clear, 1 - clear], [1 - hit, hit]]))
    return matrix


def checked(confusion: ArrayLike, *, size: int, where: str) -> Floats:
    """Return a (size, size) matrix whose rows are distributions, or raise ModelError."""
    matrix = float_array(confusion)
    if matrix.shape != (size, size):
        raise ModelError(
            f"a confusion matrix of shape {matrix.shape}",
            where=where,
            fix=f"give {size} true by {size} perceived statuses",
        )
    bits = size.bit_length() - 1
    labels = [format(number, f"0{bits}b") for number in range(size)]
    below = np.argwhere(~(matrix >= 0))
    if len(below):
        row, column = below[0].tolist()
        raise ModelError(
            f"status {labels[row]} is seen as {labels[column]} with probability "
            f"{matrix[row, column]:.12g}",
            where=f"{where}, row {row}",
            fix="give a number from 0 to 1",
        )
    for row, label in enumerate(labels):
        _check_sum(matrix[row], label, f"{where}, row {row}")
    return matrix


def _check_sum(row: Floats, label: str, where: str) -> None:
    total = float(row.sum())
    if not abs(total - 1) <= FLOAT_ROW_TOLERANCE:
        raise ModelError(
            f"the row of status {label} sums to {total:.12g}, not 1",
            where=where,
            fix="correct a probability in this row, or add what is missing",
        )


def read(path: str | Path, mdp: MDP) -> Floats:
    """Return the confusion matrix that a file states.

    A `.csv` has the header `status,0000,…,1111` and a row for each true status. A `.toml` has the
    tables `[sensitivity]` and `[specificity]` with a number for each status by name. Examples that
    are labelled count as their frequencies: a `.csv` with the header `true,perceived`, or the
    `.jsonl` recording of a conversation (`mdp.care.counts`). Numbers are read exactly, then
    rounded to floats.
    """
    size, where = status_size(mdp), str(path)
    suffix = Path(path).suffix.lower()
    if holds_examples(path):
        from exact_mdp.mdp.care.counts import read_counts

        counts = read_counts(path, mdp)
        if counts.missing:
            raise ModelError(
                counts.unlabelled,
                where=where,
                fix="label more; `exact-mdp perception` takes a --prior",
            )
        return checked(counts.mean, size=size, where=where)
    if suffix == ".csv":
        return checked(_from_csv(read_text(path), mdp, where), size=size, where=where)
    if suffix == ".toml":
        return checked(_from_toml(read_text(path, most=SMALL), mdp, where), size=size, where=where)
    raise ModelError(f"unknown kind of perception {where!r}", fix="give .csv, .toml or .jsonl")


def holds_examples(path: str | Path) -> bool:
    """Return whether a file holds labelled examples: a recording, or a CSV of true,perceived."""
    suffix = Path(path).suffix.lower()
    if suffix != ".csv":
        return suffix == ".jsonl"
    header = read_text(path).partition("\n")[0]
    return [word.strip() for word in header.split(",")] == ["true", "perceived"]


def status_size(mdp: MDP) -> int:
    """Return the number of status vectors; raises ModelError where there are none."""
    if "status" not in mdp.space.names or mdp.space.names[-1] != "status":
        raise ModelError(
            "the model has no statuses to perceive", where="perception", fix="use a scenario"
        )
    return mdp.space.column("status").size


def _from_csv(text: str, mdp: MDP, where: str) -> Floats:
    column = mdp.space.column("status")
    labels = [column.label(value) for value in range(column.size)]
    try:
        lines = [line for line in csv.reader(io.StringIO(text), strict=True) if line]
    except csv.Error as error:
        raise ModelError(f"broken CSV: {error}", where=where, fix="mend that line") from error
    header = [word.strip() for word in lines[0]] if lines else []
    if header != ["status", *labels]:
        raise ModelError(
            "the header does not name the statuses in order",
            where=where,
            fix=f"write status,{labels[0]},…,{labels[-1]}",
        )
    matrix = np.full((len(labels), len(labels)), np.nan)
    for number, line in enumerate(lines[1:], start=2):
        place = f"{where}, line {number}"
        if len(line) != len(header):
            raise ModelError(f"{len(line)} values in a row", where=place, fix="mend the line")
        row = labels.index(line[0].strip()) if line[0].strip() in labels else -1
        if row < 0 or not np.isnan(matrix[row, 0]):
            raise ModelError(
                f"status {line[0].strip()!r} is unknown or appears twice",
                where=place,
                fix="give one row for each status",
            )
        matrix[row] = [_number(word.strip(), place) for word in line[1:]]
        _check_sum(matrix[row], labels[row], place)
    if np.isnan(matrix).any():
        missing = labels[int(np.flatnonzero(np.isnan(matrix[:, 0]))[0])]
        raise ModelError(f"the row of status {missing} is missing", where=where, fix="add it")
    return matrix


def _from_toml(text: str, mdp: MDP, where: str) -> Floats:
    names = [p.name.removeprefix("base.") for p in mdp.parameters if p.name.startswith("base.")]
    content = toml_of(text, where)
    rates = []
    for table in ("sensitivity", "specificity"):
        given = content.pop(table, None)
        if not isinstance(given, dict):
            raise ModelError(f"the table [{table}] is missing", where=where, fix="add it")
        for name in given:
            if name not in names:
                raise ModelError(f"unknown status {name!r}", where=where, fix=suggest(name, names))
        for name in names:
            if name not in given:
                raise ModelError(f"{table}.{name} is missing", where=where, fix="state it")
        rates.append([_number(given[name], f"{where}, {table}.{name}") for name in names])
    if content:
        raise ModelError(
            f"unknown key {next(iter(content))!r}",
            where=where,
            fix="keep [sensitivity] and [specificity] alone",
        )
    return independent(*rates)


def _number(value: object, where: str) -> float:
    try:
        number = exact(value)
    except ModelError as error:
        raise ModelError(error.what, where=where, fix=error.fix) from error
    if not 0 <= number <= 1:
        raise ModelError(
            f"{beside(number, Fraction(0), Fraction(1))} is outside [0, 1]",
            where=where,
            fix="give a probability",
        )
    return float(number)
