"""Acting on a perceived status: a confusion matrix, stated or counted, and the policy it makes.

If the true status is s, the status z is perceived with probability C(s, z), independently at every
timestep. A policy π that acts on what it perceives is, in the true state, the mixed policy

    π_C(a | s) = Σ_z C(s, z) π(a | z),

which can be evaluated like any other. The other columns are perceived correctly. Files may state
rationals; each number, and each probability π_C, is rounded to the nearest float, and exact results
are exact for these: 0.9 is then the binary fraction nearest to it.

From N(s, z) examples of the true status s and the perceived status z, a row is estimated as

    C(s, z) = (N(s, z) + α) / (N(s) + α Z)

with a pseudo-count α for each of the Z cells: the frequencies at α = 0, and the posterior mean
under a Dirichlet prior otherwise. α = 1/Z, the prior of Perks (1947), has the weight of one
example for each row. Rows are drawn from Dirichlet(N(s, ·) + α). The interval of one status's
sensitivity or specificity is that of Clopper and Pearson (Biometrika 26, 1934).
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exact_mdp.mdp.care.tables import known
from exact_mdp.mdp.errors import ModelError, located
from exact_mdp.mdp.io.files import SMALL, read_text
from exact_mdp.mdp.io.structured import toml_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.policies.policy import Policy, PolicyLike
from exact_mdp.mdp.space import Column
from exact_mdp.mdp.table import FLOAT_ROW_TOLERANCE, Floats, Integers, beside, exact, float_array

LEVEL = 0.95
PAIRS = ["true", "perceived"]


def perceived(model: MDP, policy: PolicyLike, confusion: ArrayLike) -> Policy:
    """Return the policy that acts on perceived statuses, as a mixed policy of the true state.

    Parameters
    ----------
    model : MDP with a column `status`, the one that moves fastest
    policy : anything that `Policy.of` takes
    confusion : (Z, Z) probabilities of the perceived status (column) given the true one (row)

    Returns
    -------
    Policy

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
    matrix = checked(confusion, size=status_size(model), where="confusion matrix")
    weights, regular = Policy.of(model, policy).weights(model), model.space.regular
    by_action = np.zeros((model.n_states, model.n_actions))
    by_action[model.pair_state, model.pair_action] = weights
    by_action[:regular] = (matrix @ by_place(model, weights)).reshape(regular, model.n_actions)
    return Policy(space=model.space, actions=model.actions, rule=by_action)


def by_place(model: MDP, amounts: Floats) -> Floats:
    """Return (P, Z, A) by place, status and action what `amounts` (L,) are by pair, else 0."""
    by_state = np.zeros((model.n_states, model.n_actions))
    by_state[model.pair_state, model.pair_action] = amounts
    return by_state[: model.space.regular].reshape(-1, status_size(model), model.n_actions)


def independent(sensitivity: Sequence[float], specificity: Sequence[float]) -> Floats:
    """Return the (2^n, 2^n) confusion matrix of n statuses perceived independently.

    Parameters
    ----------
    sensitivity, specificity : (n,)
        Probability that a status is seen where it is present, and not seen where it is absent.

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


def checked(confusion: ArrayLike, *, size: int, where: str) -> Floats:
    """Return a (size, size) matrix whose rows are distributions, or raise ModelError."""
    matrix = float_array(confusion)
    if matrix.shape != (size, size):
        raise ModelError(
            f"a confusion matrix of shape {matrix.shape}",
            where=where,
            fix=f"give {size} true by {size} perceived statuses",
        )
    for row in range(size):
        _check_row(matrix[row], statuses_of(size).label(row), f"{where}, row {row}")
    return matrix


def _check_row(row: Floats, label: str, where: str) -> None:
    if not (row >= 0).all():
        seen = int(np.flatnonzero(~(row >= 0))[0])
        raise ModelError(
            f"status {label} is seen as {statuses_of(len(row)).label(seen)} with probability "
            f"{row[seen]:.12g}",
            where=where,
            fix="give a number from 0 to 1",
        )
    if not abs(row.sum() - 1) <= FLOAT_ROW_TOLERANCE:
        raise ModelError(
            f"the row of status {label} sums to {row.sum():.12g}, not 1",
            where=where,
            fix="correct a probability in this row, or add what is missing",
        )


def statuses_of(size: int) -> Column:
    """Return the column of so many status vectors."""
    return Column(name="status", size=size, bits=size.bit_length() - 1)


def status_size(model: MDP) -> int:
    """Return the number of status vectors; raises ModelError where there are none."""
    if not isinstance(model, MDP) or "status" not in model.space.names[-1:]:
        raise ModelError(
            "the model has no statuses to perceive",
            where="perception",
            fix='give Scenario.load("yuan2025").compile(), or another scenario, compiled',
        )
    return model.space.column("status").size


# ---- counts --------------------------------------------------------------------------------------


@dataclass(frozen=True, kw_only=True)
class Rate:
    """How often a status was recognised: `right` of `total` examples, with an interval."""

    right: int
    total: int
    low: float
    high: float

    @property
    def value(self) -> float | None:
        """The frequency; None without an example."""
        return self.right / self.total if self.total else None


@dataclass(frozen=True, kw_only=True, eq=False)
class Counted:
    """How often each true status (row) was perceived as each other (column).

    Attributes
    ----------
    counts : (Z, Z) int64
    prior : float
        Pseudo-count of every cell.

    Examples
    --------
    >>> found = counted([("0", "0"), ("0", "1"), ("1", "1")], size=2, prior=0.5)
    >>> found.counts.tolist(), found.mean.tolist()
    ([[1, 1], [0, 1]], [[0.5, 0.5], [0.25, 0.75]])
    """

    counts: Integers
    prior: float = 0.0

    def __post_init__(self) -> None:
        if not 0 <= self.prior < np.inf:
            raise ModelError(f"the prior is {self.prior}", where="counts", fix="give 0 or more")
        table = np.asarray(self.counts)
        square = table.ndim == 2 and table.shape[0] == table.shape[1] and table.dtype.kind in "iuf"
        if not square or not ((table >= 0) & (table == np.floor(table))).all():
            raise ModelError(
                f"counts of shape {table.shape} that are not a square of whole numbers from 0",
                where="counts",
                fix="give a number for each true (row) and perceived status (column)",
            )
        table = table.astype(np.int64)
        table.setflags(write=False)
        object.__setattr__(self, "counts", table)

    @property
    def mean(self) -> Floats:
        """(Z, Z) the confusion matrix: frequencies, or posterior means with a prior.

        Raises
        ------
        ModelError
            Where a status was never seen and there is no prior.
        """
        if self.prior == 0 and self.missing:
            more = " and others" if len(self.missing) > 4 else ""
            raise ModelError(
                f"no example was labelled {', '.join(self.missing[:4])}{more}",
                where="confusion matrix",
                fix="label more, or give a prior, which counts as that many of each; "
                "`exact-mdp perception` takes a --prior",
            )
        weight = self.counts + self.prior
        return np.asarray(weight / weight.sum(axis=1, keepdims=True))

    @property
    def missing(self) -> tuple[str, ...]:
        """Statuses without any example."""
        label = statuses_of(len(self.counts)).label
        return tuple(map(label, np.flatnonzero(self.counts.sum(axis=1) == 0).tolist()))

    def samples(self, rng: np.random.Generator, n: int) -> Floats:
        """Return (n, Z, Z) matrices drawn from the posterior.

        Raises
        ------
        ModelError
            Without a prior, under which what was not seen would be impossible.
        """
        if self.prior == 0:
            raise ModelError(
                "no prior to draw from",
                where="counts",
                fix=f"give one, such as prior=1/{len(self.counts)}",
            )
        # A Dirichlet row is a row of gamma variates divided by its sum.
        drawn = rng.gamma(self.counts + self.prior, size=(n, *self.counts.shape))
        total = drawn.sum(axis=2, keepdims=True)
        if not (total > 0).all():
            raise ModelError(
                f"the prior {self.prior} is too small to draw from", where="counts", fix="raise it"
            )
        return np.asarray(drawn / total)

    def rates(self, statuses: Sequence[str], level: float = LEVEL) -> dict[str, dict[str, Rate]]:
        """Return `sensitivity` and `specificity` of each status by name, the first the highest bit.

        Examples
        --------
        >>> found = counted([(1, 1)] * 10 + [(0, 0)], size=2).rates(["anger"])
        >>> rate = found["anger"]["sensitivity"]
        >>> rate.right, round(rate.low, 4), rate.high
        (10, 0.6915, 1.0)
        """
        numbers = np.arange(len(self.counts))
        found: dict[str, dict[str, Rate]] = {}
        for place, name in enumerate(statuses):
            bit = numbers >> (len(statuses) - 1 - place) & 1
            found[name] = {}
            for what, present in (("sensitivity", 1), ("specificity", 0)):
                rows = self.counts[bit == present]
                right, total = int(rows[:, bit == present].sum()), int(rows.sum())
                low, high = interval(right, total, level)
                found[name][what] = Rate(right=right, total=total, low=low, high=high)
        return found


def interval(right: int, total: int, level: float = LEVEL) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a proportion."""
    from scipy import stats

    tail, beta = (1 - level) / 2, stats.beta
    low = 0.0 if right == 0 else float(beta.ppf(tail, right, total - right + 1))
    high = 1.0 if right == total else float(beta.ppf(1 - tail, right + 1, total - right))
    return low, high


def counted(
    source: NDArray[Any] | Iterable[Sequence[object]], *, size: int, prior: float = 0.0
) -> Counted:
    """Return the counts of true and perceived statuses.

    Parameters
    ----------
    source : (Z, Z) array of whole numbers, or pairs of the true and the perceived status
        Statuses as numbers, or as strings of bits.
    size : number of status vectors, Z
    prior : pseudo-count of every cell

    Returns
    -------
    Counted

    Raises
    ------
    ModelError
        For unknown statuses, and for counts that are not whole numbers of at least 0.

    Examples
    --------
    >>> from exact_mdp import counted
    >>> counted([("0", "0"), ("0", "1"), ("1", "1")], size=2).mean.tolist()
    [[0.5, 0.5], [0.0, 1.0]]
    """
    if isinstance(source, np.ndarray) and source.shape == (size, size):
        return Counted(counts=source, prior=prior)
    pairs = ((f"pair {k}", *pair) for k, pair in enumerate(source, start=1))
    return _tally(pairs, size, prior)


def _tally(pairs: Iterable[tuple[str, object, object]], size: int, prior: float) -> Counted:
    """Return the counts of places, true and perceived statuses."""
    column, table = statuses_of(size), np.zeros((size, size), dtype=np.int64)

    def status(value: object) -> int:
        if isinstance(value, str):
            return column.parse(value)
        number = -1
        if isinstance(value, int | np.integer) and not isinstance(value, bool):
            number = int(value)
        if not 0 <= number < size:
            raise ModelError(
                f"{value!r} is not a status",
                fix=f"give a number from 0 to {size - 1}, or a label such as {column.label(0)}",
            )
        return number

    for place, true, seen in pairs:
        with located(place, instead=True):
            table[status(true), status(seen)] += 1
    return Counted(counts=table, prior=prior)


# ---- files ---------------------------------------------------------------------------------------


def read(path: str | Path, model: MDP) -> Floats:
    """Return the confusion matrix that a file states.

    A `.csv` has the header `status,0000,…,1111` and a row for each true status. A `.toml` has the
    tables `[sensitivity]` and `[specificity]` with a number for each status by name. Examples that
    are labelled count as their frequencies (`read_counts`). Numbers are read exactly, then rounded
    to floats.
    """
    size, where = status_size(model), str(path)
    suffix = Path(path).suffix.lower()
    if holds_examples(path):
        counts = read_counts(path, model)
        with located(where, instead=True):
            return counts.mean
    if suffix == ".csv":
        matrix = _matrix_of_rows(read_text(path), model.space.column("status"), where)
    elif suffix == ".toml":
        matrix = _matrix_of_rates(read_text(path, most=SMALL), model, where)
    else:
        raise ModelError(f"unknown kind of perception {where!r}", fix="give .csv, .toml or .jsonl")
    return checked(matrix, size=size, where=where)


def holds_examples(path: str | Path) -> bool:
    """Return whether a file holds labelled examples: a recording, or a CSV of true,perceived."""
    suffix = Path(path).suffix.lower()
    if suffix != ".csv":
        return suffix == ".jsonl"
    header = read_text(path).partition("\n")[0]
    return [word.strip() for word in header.split(",")] == PAIRS


def read_counts(path: str | Path, model: MDP, *, prior: float = 0.0) -> Counted:
    """Return the counts of a file of labelled examples.

    A `.csv` has the header `true,perceived` and a row for each example. A `.jsonl` is a recording
    of a conversation or a measurement: lines with `status` and `perceived` are examples, others
    are passed over, and so is a last line that breaks off before its end; a header that names
    `statuses` must name the model's.
    """
    text, where, suffix = read_text(path), str(path), Path(path).suffix.lower()
    if suffix == ".csv":
        rows = _csv_rows(text, where, PAIRS, "write true,perceived first")
        pairs: Iterable[Any] = [(place, *row) for place, row in rows]
    elif suffix == ".jsonl":
        pairs = _pairs_of_lines(text, where, _named(model))
    else:
        raise ModelError(f"unknown kind of examples {where!r}", fix="give a .csv or .jsonl file")
    return _tally(pairs, status_size(model), prior)


def _named(model: MDP) -> list[str]:
    names = (parameter.name for parameter in model.parameters)
    return [name.removeprefix("base.") for name in names if name.startswith("base.")]


def status_names(model: MDP) -> tuple[str, ...]:
    """Return the names of the statuses, the most significant bit first; numbers where unnamed."""
    names, bits = _named(model), status_size(model).bit_length() - 1
    return tuple(names) if len(names) == bits else tuple(f"bit {bit}" for bit in range(bits))


def _csv_rows(text: str, where: str, header: list[str], fix: str) -> list[tuple[str, list[str]]]:
    """Return the place and the words of each row below a header, all of the header's length."""
    try:
        lines = [line for line in csv.reader(io.StringIO(text), strict=True) if line]
    except csv.Error as error:
        raise ModelError(f"broken CSV: {error}", where=where, fix="correct that line") from error
    rows = [[word.strip() for word in line] for line in lines]
    if not rows or rows[0] != header:
        raise ModelError(f"the header is not {','.join(header)}", where=where, fix=fix)
    found = [(f"{where}, line {number}", row) for number, row in enumerate(rows[1:], start=2)]
    for place, row in found:
        if len(row) != len(header):
            raise ModelError(f"{len(row)} values in a row", where=place, fix="correct the line")
    return found


def _pairs_of_lines(
    text: str, where: str, names: list[str]
) -> Iterator[tuple[str, object, object]]:
    lines = text.split("\n")
    for number, line in enumerate(lines, start=1):
        place = f"{where}, line {number}"
        if not line.strip():
            continue
        try:
            entry = json.loads(line)
        except (ValueError, RecursionError) as error:
            if number == len(lines):
                continue  # torn: the writer was stopped before the newline that ends a line
            raise ModelError(f"broken JSON: {error}", where=place, fix="correct it") from error
        if not isinstance(entry, Mapping):
            raise ModelError("a line that is not an object", where=place, fix="correct the line")
        stated = entry.get("statuses")
        if stated is not None and names and stated != names:
            raise ModelError(
                f"a recording with the statuses {stated}",
                where=place,
                fix="choose the scenario that it was made with",
            )
        if "status" in entry and "perceived" in entry:
            yield place, entry["status"], entry["perceived"]


def _matrix_of_rows(text: str, column: Column, where: str) -> Floats:
    labels = [column.label(value) for value in range(column.size)]
    fix = f"name the statuses in order: status,{labels[0]},…,{labels[-1]}"
    rows: dict[str, list[float]] = {}
    for place, (label, *words) in _csv_rows(text, where, ["status", *labels], fix):
        if label not in labels or label in rows:
            raise ModelError(
                f"status {label!r} is unknown or appears twice",
                where=place,
                fix="give one row for each status",
            )
        rows[label] = [_probability(word, place) for word in words]
        _check_row(np.array(rows[label]), label, place)
    for label in labels:
        if label not in rows:
            raise ModelError(f"the row of status {label} is missing", where=where, fix="add it")
    return np.array([rows[label] for label in labels])


def _matrix_of_rates(text: str, model: MDP, where: str) -> Floats:
    names, content = _named(model), toml_of(text, where)
    rates = []
    for table in ("sensitivity", "specificity"):
        given = content.pop(table, None)
        if not isinstance(given, dict):
            raise ModelError(f"the table [{table}] is missing", where=where, fix="add it")
        for name in given:
            known(name, names, "status", where)
        for name in names:
            if name not in given:
                raise ModelError(f"{table}.{name} is missing", where=where, fix="state it")
        rates.append([_probability(given[name], f"{where}, {table}.{name}") for name in names])
    for key in content:
        known(key, ("sensitivity", "specificity"), "key", where)
    return independent(*rates)


def _probability(value: object, where: str) -> float:
    with located(where, instead=True):
        number = exact(value)
    if not 0 <= number <= 1:
        raise ModelError(
            f"{beside(number, Fraction(0), Fraction(1))} is outside [0, 1]",
            where=where,
            fix="give a probability",
        )
    return float(number)
