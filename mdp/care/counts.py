"""Perception counted from labelled examples, and what the counts leave open.

From pairs of a true and a perceived status, N(s, z) of each, the confusion of a row is

    C(s, z) = (N(s, z) + α) / (N(s) + α Z)

with a pseudo-count α for each of the Z cells: the frequencies at α = 0, and the posterior mean
under a Dirichlet prior otherwise. α = 1/Z, the prior of Perks (1947), weighs as much as one
example for each row. Rows are drawn from Dirichlet(N(s, ·) + α). The interval of one status's
sensitivity or specificity is that of Clopper and Pearson (Biometrika 26, 1934).
"""

from __future__ import annotations

import csv
import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import read_text
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.space import Column
from exact_mdp.mdp.table import Floats, Integers

LEVEL = 0.95
PAIRS = ["true", "perceived"]


@dataclass(frozen=True, kw_only=True)
class Rate:
    """How often a status was told rightly: `right` of `total`, with an interval.

    `value` is None where there was nothing to tell.
    """

    right: int
    total: int
    low: float
    high: float

    @property
    def value(self) -> float | None:
        """The frequency."""
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
                f"counts of shape {table.shape} that are no square of whole numbers from 0",
                where="counts",
                fix="give a number for each true (row) and perceived status (column)",
            )
        table = table.astype(np.int64)
        table.setflags(write=False)
        object.__setattr__(self, "counts", table)

    @property
    def bits(self) -> int:
        """Number of statuses, n, where Z = 2^n."""
        return len(self.counts).bit_length() - 1

    @property
    def mean(self) -> Floats:
        """(Z, Z) the confusion matrix: frequencies, or posterior means with a prior.

        Raises
        ------
        ModelError
            Where a status was never seen and there is no prior to go by.
        """
        weight = self._weight()
        return np.asarray(weight / weight.sum(axis=1, keepdims=True))

    @property
    def missing(self) -> tuple[str, ...]:
        """Statuses without any example."""
        rows = np.flatnonzero(self.counts.sum(axis=1) == 0)
        return tuple(format(int(row), f"0{self.bits}b") for row in rows)

    @property
    def unlabelled(self) -> str:
        """What is to be said of `missing`."""
        more = " and others" if len(self.missing) > 4 else ""
        return f"no example was labelled {', '.join(self.missing[:4])}{more}"

    def samples(self, rng: np.random.Generator, draws: int) -> Floats:
        """Return (draws, Z, Z) matrices drawn from the posterior.

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
        drawn = rng.gamma(self._weight(), size=(draws, *self.counts.shape))
        total = drawn.sum(axis=2, keepdims=True)
        if not (total > 0).all():
            raise ModelError(
                f"the prior {self.prior} is too small to draw from", where="counts", fix="raise it"
            )
        return np.asarray(drawn / total)

    def rates(self, statuses: Sequence[str], level: float = LEVEL) -> dict[str, dict[str, Rate]]:
        """Return `sensitivity` and `specificity` of each status by name.

        Parameters
        ----------
        statuses : names, the first one the most significant bit

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

    def _weight(self) -> Floats:
        if self.prior == 0 and self.missing:
            raise ModelError(
                self.unlabelled,
                where="confusion matrix",
                fix="label more, or give a prior (--prior), which counts as that many of each",
            )
        return np.asarray(self.counts + self.prior, dtype=np.float64)


def counted(
    source: NDArray[Any] | Iterable[Sequence[object]], *, size: int, prior: float = 0.0
) -> Counted:
    """Return the counts of a perception.

    Parameters
    ----------
    source : (Z, Z) array of whole numbers, or pairs of the true and the perceived status
        Statuses as numbers, or as strings of bits.
    size : number of status vectors, Z
    prior : pseudo-count of every cell

    Raises
    ------
    ModelError
        For statuses that there are not, and counts that are no whole numbers of at least 0.
    """
    if isinstance(source, np.ndarray) and source.shape == (size, size):
        return Counted(counts=source, prior=prior)
    column = Column(name="status", size=size, bits=size.bit_length() - 1)
    table = np.zeros((size, size), dtype=np.int64)
    for number, (true, seen) in enumerate(source, start=1):
        place = f"pair {number}"
        table[_status(true, column, place), _status(seen, column, place)] += 1
    return Counted(counts=table, prior=prior)


def read_counts(path: str | Path, mdp: MDP, *, prior: float = 0.0) -> Counted:
    """Return the counts of a file of labelled examples.

    A `.csv` has the header `true,perceived` and a row for each example. A `.jsonl` is a recording
    of a conversation or a measurement: lines with `status` and `perceived` are examples, others
    are passed over, and so is a last line that breaks off before its end; a header that names
    `statuses` must name the model's.
    """
    text, where = read_text(path), str(path)
    column = mdp.space.column("status")
    suffix = Path(path).suffix.lower()
    if suffix == ".csv":
        pairs = pairs_of_csv(text, where)
    elif suffix == ".jsonl":
        pairs = _pairs_of_lines(text, where, mdp)
    else:
        raise ModelError(f"unknown kind of examples {where!r}", fix="give a .csv or .jsonl file")
    table = np.zeros((column.size, column.size), dtype=np.int64)
    for place, true, seen in pairs:
        table[_status(true, column, place), _status(seen, column, place)] += 1
    return Counted(counts=table, prior=prior)


def pairs_of_csv(text: str, where: str) -> list[tuple[str, object, object]]:
    """Return the place, true and perceived status of each row of a CSV file."""
    try:
        lines = [line for line in csv.reader(io.StringIO(text), strict=True) if line]
    except csv.Error as error:
        raise ModelError(f"broken CSV: {error}", where=where, fix="mend that line") from error
    if not lines or [word.strip() for word in lines[0]] != PAIRS:
        raise ModelError("no header true,perceived", where=where, fix="write it first")
    found: list[tuple[str, object, object]] = []
    for number, line in enumerate(lines[1:], start=2):
        place = f"{where}, line {number}"
        if len(line) != 2:
            raise ModelError(f"{len(line)} values in a row", where=place, fix="mend the line")
        found.append((place, line[0].strip(), line[1].strip()))
    return found


def _pairs_of_lines(text: str, where: str, mdp: MDP) -> list[tuple[str, object, object]]:
    found: list[tuple[str, object, object]] = []
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
            raise ModelError(f"broken JSON: {error}", where=place, fix="mend the line") from error
        if not isinstance(entry, Mapping):
            raise ModelError("a line that is no object", where=place, fix="mend the line")
        _same_statuses(entry, place, mdp)
        if "status" in entry and "perceived" in entry:
            found.append((place, entry["status"], entry["perceived"]))
    return found


def _same_statuses(entry: Mapping[str, Any], place: str, mdp: MDP) -> None:
    names = [p.name.removeprefix("base.") for p in mdp.parameters if p.name.startswith("base.")]
    told = entry.get("statuses")
    if told is not None and names and told != names:
        raise ModelError(
            f"a recording with the statuses {told}",
            where=place,
            fix="choose the scenario that it was made with",
        )


def interval(right: int, total: int, level: float = LEVEL) -> tuple[float, float]:
    """Return the Clopper-Pearson interval of a proportion.

    Examples
    --------
    >>> low, high = interval(10, 10)
    >>> round(low, 4), high
    (0.6915, 1.0)
    """
    from scipy.stats import beta

    tail = (1 - level) / 2
    low = 0.0 if right == 0 else float(beta.ppf(tail, right, total - right + 1))
    high = 1.0 if right == total else float(beta.ppf(1 - tail, right + 1, total - right))
    return low, high


def _status(value: object, column: Column, where: str) -> int:
    if isinstance(value, str):
        try:
            return column.parse(value)
        except ModelError as error:
            raise ModelError(error.what, where=where, fix=error.fix) from error
    if isinstance(value, int | np.integer) and not isinstance(value, bool):
        number = int(value)
        if 0 <= number < column.size:
            return number
    raise ModelError(
        f"{value!r} is no status",
        where=where,
        fix=f"give a number from 0 to {column.size - 1}, or such as {column.label(0)}",
    )
