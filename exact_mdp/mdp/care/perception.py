"""Acting on a perceived status: a confusion matrix, given or counted, and the resulting policy.

If the true status is s, the status z is perceived with probability C(s, z), independently at every
timestep. A policy π that acts on the perceived status is, in the true state, the mixed policy

    π_C(a | s) = Σ_z C(s, z) π(a | z),

which can be evaluated like any other. Files may contain rationals; each number, and each
probability π_C, is rounded to the nearest float, and exact results are exact for these floats.

From N(s, z) examples of the true status s and the perceived status z, a row is estimated by its
frequencies, C(s, z) = N(s, z) / N(s). Intervals of rates follow Clopper and Pearson (Biometrika 26,
1934).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from fractions import Fraction
from io import StringIO
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from exact_mdp.mdp.errors import ModelError, join_few, locate_errors
from exact_mdp.mdp.forms.numbers import float_array
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.formats import PERCEPTIONS, find_format, join_endings
from exact_mdp.mdp.io.structured import csv_of, json_of, require_shape, toml_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike
from exact_mdp.mdp.result import DataFrame, data_frame
from exact_mdp.mdp.space import Column
from exact_mdp.mdp.table import FLOAT_ROW_TOLERANCE, Floats, Integers, exact, format_beside_limits

RATES = ("sensitivity", "specificity")


def perceived(model: MDP, policy: PolicyLike, confusion: ArrayLike) -> Policy:
    """Return the policy that acts on perceived statuses, as a mixed policy over true states.

    Parameters
    ----------
    model : MDP with `status` as its last column
    policy : any form that `Policy.of` accepts
    confusion : (Z, Z) probabilities of the perceived status (column) given the true one (row)

    Returns
    -------
    Policy

    Raises
    ------
    ModelError
        If a row of the matrix is not a distribution, or the matrix does not fit the statuses.

    Examples
    --------
    >>> from exact_mdp import Scenario
    >>> mdp = Scenario.load("yuan2025").compile()
    >>> blind = np.full((16, 16), 1 / 16)
    >>> perceived(mdp, {f"{s:04b}": "none" for s in range(16)}, blind).weights(mdp)[:4]
    array([1., 0., 0., 0.])
    """
    matrix = require_confusion_matrix(confusion, size=status_size(model), where="confusion matrix")
    weights, regular = Policy.of(model, policy).weights(model), model.space.regular
    by_action = model.by_action(weights, 0.0)
    placed = by_place(model, weights)
    # A loop adds in the same order on every processor; a matrix product does not.
    mixed = np.zeros_like(placed)
    for seen, share in enumerate(matrix.T):
        mixed += share[:, None] * placed[:, seen, None, :]
    by_action[:regular] = mixed.reshape(regular, model.n_actions)
    return Policy(space=model.space, actions=model.actions, rule=by_action)


def by_place(model: MDP, amounts: Floats) -> Floats:
    """Return amounts by pair (L,) as an array (P, Z, A) by place, status and action."""
    by_action = model.by_action(amounts, 0.0)
    return by_action[: model.space.regular].reshape(-1, status_size(model), model.n_actions)


def independent(sensitivity: Sequence[float], specificity: Sequence[float]) -> Floats:
    """Return the (2^n, 2^n) confusion matrix of n statuses perceived independently.

    Parameters
    ----------
    sensitivity, specificity : (n,)
        Probabilities that a present status is perceived, and that an absent one is not.

    Returns
    -------
    (2^n, 2^n) array

    Examples
    --------
    >>> independent([0.75], [0.5]).tolist()
    [[0.5, 0.5], [0.25, 0.75]]
    """
    matrix = np.ones((1, 1))
    for hit, clear in zip(sensitivity, specificity, strict=True):
        matrix = np.kron(matrix, np.array([[clear, 1 - clear], [1 - hit, hit]]))
    return matrix


def require_confusion_matrix(confusion: ArrayLike, *, size: int, where: str) -> Floats:
    """Return a confusion matrix (size, size); raise ModelError unless rows are distributions."""
    matrix, label = float_array(confusion, where), statuses_of(size).label
    if matrix.shape != (size, size):
        raise ModelError(
            f"a confusion matrix of shape {matrix.shape}",
            where=where,
            fix=f"give {size} true by {size} perceived statuses",
        )
    sums = matrix.sum(axis=1)
    wrong = ~((matrix >= 0).all(axis=1) & (np.abs(sums - 1) <= FLOAT_ROW_TOLERANCE))
    for true in np.flatnonzero(wrong).tolist():
        raise ModelError(
            f"the row of status {label(true)} is not a distribution: it sums to {sums[true]:.12g}, "
            f"and its least number is {matrix[true].min():.12g}",
            where=f"{where}, row {true}",
            fix="give probabilities from 0 to 1 that sum to 1",
        )
    return matrix


def statuses_of(size: int) -> Column:
    """Return the column of `size` status vectors."""
    return Column(name="status", size=size, bits=size.bit_length() - 1)


def status_size(model: MDP) -> int:
    """Return the number of status vectors; raise ModelError if the model has no statuses."""
    if not isinstance(model, MDP) or "status" not in model.space.names[-1:]:
        raise ModelError(
            "the model has no statuses to perceive",
            where="perception",
            fix='give Scenario.load("yuan2025").compile(), or another scenario, compiled',
        )
    return model.space.column("status").size


def status_names(model: MDP) -> tuple[str, ...]:
    """Return the names of the statuses, most significant bit first; "bit 0", … without names."""
    names, bits = _find_status_names(model), status_size(model).bit_length() - 1
    if len(names) != bits:
        names = [f"bit {bit}" for bit in range(bits)]
    return tuple(names)


def _find_status_names(model: MDP) -> list[str]:
    """Return the names of the statuses from the parameters of a scenario; [] without a scenario."""
    names = (parameter.name for parameter in model.parameters)
    return [name.removeprefix("base.") for name in names if name.startswith("base.")]


# ---- counts --------------------------------------------------------------------------------------


def counted(pairs: Iterable[Sequence[object]], *, size: int) -> Integers:
    """Return how often each true status (row) was perceived as each status (column).

    Parameters
    ----------
    pairs : true and perceived status of each example, as numbers or strings of bits
    size : number of status vectors, Z

    Returns
    -------
    (Z, Z) array of int

    Raises
    ------
    ModelError
        For unknown statuses.

    Examples
    --------
    >>> from exact_mdp import counted
    >>> counted([("0", "0"), ("0", "1"), ("1", "1")], size=2).tolist()
    [[1, 1], [0, 1]]
    """
    column, counts = statuses_of(size), np.zeros((size, size), dtype=np.int64)
    for number, (true, seen) in enumerate(pairs, start=1):
        with locate_errors(f"pair {number}", instead=True):
            counts[column.number(true), column.number(seen)] += 1
    return counts


def frequencies(counts: Integers) -> Floats:
    """Return the confusion matrix of counts: the frequencies in each row.

    Parameters
    ----------
    counts : (Z, Z) array of int

    Returns
    -------
    (Z, Z) array

    Raises
    ------
    ModelError
        For a true status without an example.

    Examples
    --------
    >>> from exact_mdp import frequencies
    >>> frequencies(np.array([[1, 3], [0, 2]])).tolist()
    [[0.25, 0.75], [0.0, 1.0]]
    """
    totals = counts.sum(axis=1, keepdims=True)
    unseen = np.flatnonzero(totals == 0).tolist()
    if unseen:
        labels = join_few(map(statuses_of(len(counts)).label, unseen), len(unseen))
        raise ModelError(
            f"no example was labelled {labels}",
            where="confusion matrix",
            fix="label more",
        )
    return np.asarray(counts / totals)


def compute_rates(counts: Integers, statuses: Sequence[str]) -> DataFrame:
    """Return the sensitivity and specificity of each status; the first is the highest bit.

    Each has a row with `right` of `total` examples, and the ends of a 95 % confidence interval.
    """
    from scipy import stats

    rows, numbers = [], np.arange(len(counts))
    for shift, status in enumerate(reversed(statuses)):
        present = (numbers >> shift & 1) == 1
        for name, of in (("specificity", ~present), ("sensitivity", present)):
            right, total = int(counts[of][:, of].sum()), int(counts[of].sum())
            ends: tuple[float, ...] = (0.0, 1.0)
            if total:
                ends = tuple(stats.binomtest(right, total).proportion_ci(0.95))
            rows.append((status, name, right, total, *map(float, ends)))
    columns = ["status", "rate", "right", "total", "low", "high"]
    return data_frame(rows[::-1], columns=columns)


# ---- files ---------------------------------------------------------------------------------------


def read_confusion_matrix(path: str | Path, model: MDP) -> tuple[Floats, int | None]:
    """Return the confusion matrix of a file, and the number of examples in it, if any.

    Numbers are read exactly, then rounded to floats.
    """
    form = find_format(path, PERCEPTIONS)
    if form is None:
        fix = f"give {join_endings(PERCEPTIONS)}"
        raise ModelError(f"unknown kind of perception {str(path)!r}", fix=fix)
    matrix: tuple[Floats, int | None] = form.read_file(path, model)
    return matrix


def read_examples(path: str | Path, model: MDP) -> tuple[Floats, int]:
    """Return the matrix and number of labelled examples; see `read_counts`."""
    counts = read_counts(path, model)
    with locate_errors(str(path), instead=True):
        return frequencies(counts), int(counts.sum())


def read_rates(path: str | Path, model: MDP) -> tuple[Floats, None]:
    """Return the matrix of a `.toml` file; statuses are perceived independently.

    It has tables `[sensitivity]` and `[specificity]` with a number for each status by name.
    """
    where = str(path)
    with locate_errors(where):
        rates = dict.fromkeys(_find_status_names(model), _parse_rate)
        tables = require_shape(
            toml_of(read_text(path, most=SMALL), where), dict.fromkeys(RATES, rates)
        )
    return independent(*([*tables[name].values()] for name in RATES)), None


def read_matrix(path: str | Path, model: MDP) -> tuple[Floats, None]:
    """Return the matrix of a `.csv` file.

    It has the header `status,0000,…,1111`, and a row for each true status, in any order.
    """
    size, where = status_size(model), str(path)
    lines = csv_of(StringIO(read_text(path)), where)
    labels = list(map(statuses_of(size).label, range(size)))
    header = [word.strip() for word in next(lines, (0, []))[1]]
    if header != ["status", *labels]:
        raise ModelError(
            f"the header is {','.join(header)[:80] or 'missing'}",
            where=where,
            fix=f"name the statuses in order: status,{labels[0]},…,{labels[-1]}",
        )
    rows: dict[str, list[float]] = {}
    for line, (label, *words) in lines:
        place = f"{where}, line {line}"
        if label.strip() in rows or label.strip() not in labels:
            what = f"status {label!r} is unknown or appears twice"
            raise ModelError(what, where=place, fix="give one row for each status")
        with locate_errors(place):
            rows[label.strip()] = list(map(_parse_rate, words))
    for label in labels:
        if label not in rows:
            raise ModelError(f"the row of status {label} is missing", where=where, fix="add it")
    return require_confusion_matrix([rows[label] for label in labels], size=size, where=where), None


def read_counts(path: str | Path, model: MDP) -> Integers:
    """Return the counts of a `.jsonl` file of labelled examples: a recording, or a measurement.

    Lines with `status` and `perceived` are examples. Other lines are ignored, and so is an
    incomplete last line. If a header names `statuses`, they must be the model's.
    """
    counts = np.zeros((status_size(model),) * 2, dtype=np.int64)
    column, names = statuses_of(len(counts)), _find_status_names(model)
    lines = read_text(path).split("\n")
    for number, line in enumerate(lines, start=1):
        with locate_errors(f"{path}, line {number}", instead=True):
            if not line.strip():
                continue
            try:
                entry = json_of(line, str(path))
            except ModelError:
                if number == len(lines):
                    break  # the writer was stopped in the middle of the last line
                raise
            if not isinstance(entry, dict):
                raise ModelError("a line is not a JSON object", fix="correct the line")
            if names and entry.get("statuses", names) != names:
                what = f"a recording with the statuses {entry['statuses']}"
                raise ModelError(what, fix="choose the scenario that it was made with")
            if "status" in entry and "perceived" in entry:
                pair = column.number(entry["status"]), column.number(entry["perceived"])
                counts[pair] += 1
    return counts


def _parse_rate(value: object) -> float:
    """Return a probability as a float; raise ModelError for anything else."""
    if value is None:
        raise ModelError("a rate is missing", fix="state it")
    number = exact(value)
    if not 0 <= number <= 1:
        what = f"{format_beside_limits(number, Fraction(0), Fraction(1))} is outside [0, 1]"
        raise ModelError(what, fix="give a probability")
    return float(number)
