"""A model estimated from recorded transitions, with the numbers of observations kept.

If action a was taken n(s, a) times in state s, and k of these led to s' with reward r, then

    P(s', r | s, a) = k / n(s, a)          the maximum likelihood estimate, a rational number

The start is estimated from where episodes begin; the model keeps their number. A state that no
record leaves is taken for an end (`entered` lists these). Three more columns may be there:

    truncated     marks the rows after which an episode was cut off, by a time limit for instance
    terminated    marks the rows after which it was over, whatever the next state says
    done          the same as terminated, where there is no such column; where a row is truncated
                  as well, it was cut off

A state that is entered only by rows that were cut off is no end, and its value is unknown
(`cut_off`). Truncated rows without a next state lead to a special state. They must not be dropped,
since truncation depends on what would have followed. The next state of a terminated row is kept if
no record leaves it; else it is that of a reset, and the row leads to the end. Where the records say
which rows are terminated, an episode whose last row is not marked was cut off.

An action that was never taken in a state is unavailable there; or it is as bad as the caller says,
so that an optimum does not rely on what nobody tried (the pessimism of Jin, Yang and Wang,
ICML 2021).

Rows are read in chunks and counted, so memory holds one chunk and one number for each different
outcome (s, a, s', r). Round rewards that hardly ever repeat first.
"""

from __future__ import annotations

import io
import re
import warnings
from collections import Counter
from collections.abc import Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from fractions import Fraction
from itertools import islice
from math import prod
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import tqdm

from exact_mdp.mdp.build import FromArrays
from exact_mdp.mdp.errors import (
    ModelError,
    require_extra,
    require_known_name,
    require_type,
    suggest_name,
)
from exact_mdp.mdp.forms.numbers import group_numbers, has_floats, one_kind
from exact_mdp.mdp.io.files import open_file
from exact_mdp.mdp.io.structured import csv_of
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import EXACT_IN_INT64, Integers, OutcomeTable, exact
from exact_mdp.mdp.validate import Flags, as_discount, as_start, check_options

if TYPE_CHECKING:
    from pandas import DataFrame, Series


COLUMNS = ("episode", "state", "action", "reward", "next_state")
TRUNCATED, TERMINATED, DONE = "truncated", "terminated", "done"
MARKS = (TRUNCATED, TERMINATED, DONE)  # the columns that a table may have besides
CUT_OFF = "cut off"  # the label of states in which episodes were cut off, and which nobody left
FLAGS = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False}
# What programs write where there is no value: no names, as pandas.read_csv has it.
NO_NAMES = frozenset(
    ("", "#N/A", "<NA>", "N/A", "NA", "NULL", "NaN", "NaT", "None", "n/a", "nan", "null")
)
OVER, NOWHERE = -1, -2  # the next state of a row that has none: the end, or cut off
ENDED = -3  # less t, the next state of a row that is terminated in state t
ROWS = 2**13  # of a chunk, whose texts stay in the cache
LARGEST_FILE = 2**40  # bytes: read in chunks, so that it guards against endless input alone
LONGEST_LINE = 2**20  # characters: more is no table, and would be read whole
NO_TABLES = frozenset(
    (".json", ".jsonl", ".gz", ".zip", ".bz2", ".xz", ".xlsx", ".pkl", ".feather")
)
NUMBER = re.compile(r"0|-?[1-9][0-9]{0,3999}")
WHOLE = re.compile(r"(-?[0-9]+)\.0+")  # as pandas writes 1 in a column where a value is missing
END, UNSEEN = "end", "unseen"
WITHOUT = {  # the way out where a column is missing
    "episode": "number the episodes: frame['episode'] = "
    "frame['done'].astype(bool).shift(fill_value=False).cumsum(), where 'done' marks the last "
    "row of each",
    "next_state": "add what follows: frame['next_state'] = "
    "frame.groupby('episode')['state'].shift(-1), where each episode is over after its last row",
}
UNAVAILABLE, PESSIMISTIC = "unavailable", "pessimistic"


class FromTransitions(FromArrays):
    """Models from records."""

    @classmethod
    def from_transitions(
        cls,
        frame: DataFrame | str | Path | Iterable[DataFrame],
        discount: object = 1,
        *,
        columns: Mapping[str, str] | None = None,
        unseen: object = UNAVAILABLE,
        progress: bool = False,
        **names: Any,
    ) -> Self:
        """Estimate a model from recorded transitions; the numbers of observations are kept.

        Parameters
        ----------
        frame : DataFrame, path of a `.csv` or `.parquet` file, or iterable of DataFrames
            One row for each transition: episode, state, action, reward and next state, in the order
            of time, one episode after the other. Without a next state the episode is over there.
            A whole number is the same name as 1 and as 1.0. A column truncated (true or false)
            marks the rows after which an episode was cut off, as by a time limit. States in which
            that happened, and that nobody left, have the label "cut off"; rows cut off without a
            next state lead to one of that name. A column terminated, or done, marks the rows
            after which an episode was over, whatever their next state. Other columns are not
            used, which a warning says.
        discount : number or "p/q"
        columns : mapping, optional
            The names that the table has for "episode", "state", "action", "reward", "next_state"
            and, where it has them, "truncated", "terminated" and "done".
        unseen : "unavailable", "pessimistic", or a number
            What is done about an action that nobody took in a state: it is left out there; or it
            ends the episode and is worth as little as a policy can be worth, or this number.
        progress : bool
            Show a bar on standard error where that is a terminal.
        **names
            `name`, `sense`; `start`, which is then known, instead of the shares of the states that
            episodes begin in, which are estimates.

        Returns
        -------
        MDP
            With `observations` (L,), `counts` (L, S) and `episodes`.

        Raises
        ------
        ModelError
            For a missing column or value, and a gap in an episode, by row; and as the constructor
            does.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> import pandas as pd
        >>> names = ["episode", "state", "action", "reward", "next_state"]
        >>> rows = [
        ...     (1, "low", "wait", 0, "low"),
        ...     (1, "low", "wait", 1, "high"),
        ...     (2, "low", "wait", 1, "high"),
        ... ]
        >>> mdp = MDP.from_transitions(pd.DataFrame(rows, columns=names), discount="9/10")
        >>> mdp.observations.tolist(), mdp.table.row(mdp.pair(1, "wait"))[0][0]
        ([0, 3], Fraction(2, 3))
        """
        known = ("states", "actions", "components")
        check_options(names, dict.fromkeys(known, "leave it out: the records say it"))
        start = names.pop("start", None)
        record = count_transitions(frame, columns, progress=progress)
        if record.unused:
            others = ", ".join(map(repr, record.unused))
            warnings.warn(f"columns that are not used: {others}", stacklevel=2)
        parts = record.build_parts(discount, unseen, costs=names.get("sense") == "min")
        if start is not None:
            parts |= {"start": as_start(start, parts["space"]), "episodes": None}
        labels = {**(names.get("labels") or {}), **parts["labels"]}
        return cls(**(parts | names | {"labels": labels}))


def count_transitions(
    frame: Any, columns: Mapping[str, str] | None, *, progress: bool = False
) -> TransitionRecord:
    """Return what was counted in a table of transitions; see `MDP.from_transitions`."""
    record = TransitionRecord(frame, columns)
    for _, keys in record.read_marked_chunks(progress=progress):
        record.count_rows(keys)
    return record


class TransitionRecord:
    """The rows of a table of transitions in numbers, and what was counted of them so far."""

    def __init__(self, frame: Any, columns: Mapping[str, str] | None = None) -> None:
        given = dict(
            require_type(columns or {}, Mapping, "columns", "give {name: name in the table}")
        )
        for name in given:
            require_known_name(name, (*COLUMNS, *MARKS), "column", "columns")
        self.columns = dict(zip(COLUMNS, COLUMNS, strict=True)) | given
        self.frame = frame
        self.where = str(frame) if isinstance(frame, str | Path) else "transitions"
        self._parquet = Path(self.where).suffix.lower() == ".parquet"
        self._of_file = isinstance(frame, str | Path) and not self._parquet
        # Names of episodes, states and actions are numbered as they come; and so are rewards, each
        # with whether it is a float: a model knows which of its numbers were rounded.
        self.numbers: dict[str, dict[Any, int]] = {name: {} for name in COLUMNS[:4]}
        self.rows = 0
        self.unused: tuple[str, ...] = ()  # columns that are not read
        self.starts = Counter[int]()  # episodes by state
        self.stops = Counter[tuple[int, bool]]()  # by next state, and whether cut off there
        self._counts: list[tuple[Integers, Integers]] = []
        self._places: Any = ()  # of the rows of this chunk, in messages
        self._last = (-1, -1, False)  # episode, next state and cut of the last row
        self.marked = False  # whether the rows say where an episode is over

    # ---- reading ---------------------------------------------------------------------------------

    def read_chunks(self, *, progress: bool = False) -> Iterator[tuple[Integers, Integers]]:
        """Yield the episodes (R,) and (R, 4) state, action, next state and reward of each chunk.

        All are checked, and in numbers; a next state may be `OVER` or `NOWHERE`.
        """
        for episode, keys in self.read_marked_chunks(progress=progress):
            keys[keys[:, 2] <= ENDED, 2] = OVER
            yield episode, keys

    def read_marked_chunks(self, *, progress: bool = False) -> Iterator[tuple[Integers, Integers]]:
        """Yield chunks; the next state of a row that is terminated is less by `ENDED`."""
        with (
            tqdm.tqdm(desc="transitions", unit=" rows", disable=None if progress else True) as bar,
            closing(self._iterate_tables()) as chunks,
        ):
            for chunk in chunks:
                for first in range(0, len(chunk), ROWS):
                    part = chunk.iloc[first : first + ROWS]
                    yield self._number_chunk(part)
                    bar.update(len(part))
        if self.rows:
            self._count_stop(*self._last[1:])

    def _iterate_tables(self) -> Generator[DataFrame]:
        """Yield tables of rows: of a file in parts, of everything else as they come."""
        import pandas

        if isinstance(self.frame, str | Path):
            if (suffix := Path(self.where).suffix.lower()) in NO_TABLES:
                raise ModelError(
                    f"cannot read {suffix}",
                    where=self.where,
                    fix="save it as .csv or .parquet; in Python, give the DataFrame that pandas "
                    "reads from it",
                )
            with open_file(self.where, most=LARGEST_FILE) as file:
                yield from (self._of_parquet if self._parquet else self._of_csv)(file)
            return
        single = isinstance(self.frame, pandas.DataFrame) or not isinstance(self.frame, Iterable)
        for table in [self.frame] if single else self.frame:
            fix = "give a DataFrame, several of them, or the path of a .csv or .parquet file"
            yield require_type(table, pandas.DataFrame, "transitions", fix)

    def _of_csv(self, file: Any) -> Generator[DataFrame]:
        """Yield the rows of a file, all as texts: "0.1" is 1/10; the index has the lines."""
        import pandas

        text = io.TextIOWrapper(file, "utf-8-sig", newline="")
        fix = "correct the line; where an episode is over, leave next_state empty after its comma"
        try:
            rows = csv_of(self._read_lines(text), self.where, fix=fix)
            _, header = next(rows, (0, []))
            more = True
            while more:
                more = bool(listed := [*islice(rows, ROWS)])
                values = np.array([row for _, row in listed], dtype=object)
                values = values.reshape(len(listed), len(header))
                yield pandas.DataFrame(values, [line for line, _ in listed], header, dtype=object)
        except UnicodeError as error:
            raise ModelError(
                "the file is not UTF-8 text", where=self.where, fix="save it as UTF-8 text"
            ) from error
        finally:
            text.detach()

    def _read_lines(self, text: io.TextIOWrapper) -> Iterator[str]:
        """Yield the lines of a file, none of which is long enough to fill the memory."""
        while line := text.readline(LONGEST_LINE):
            if len(line) == LONGEST_LINE:
                raise ModelError(
                    f"a line has more than {LONGEST_LINE:,} characters",
                    where=self.where,
                    fix="check that it is the right file: a table has one line for each transition",
                )
            yield line

    def _of_parquet(self, file: Any) -> Generator[DataFrame]:
        with require_extra("models"):
            from pyarrow import parquet
        used = {*self.columns.values(), *MARKS}
        try:
            table = parquet.ParquetFile(file)
            names = table.schema_arrow.names
            self.unused = tuple(name for name in names if name not in used)
            for batch in table.iter_batches(ROWS, columns=[n for n in names if n in used]):
                # The columns say it all: what pandas noted beside them may hide one as an index.
                yield batch.to_pandas(ignore_metadata=True, integer_object_nulls=True)
        except Exception as error:  # Arrow raises many kinds on damaged files
            what = f"the file is no Parquet: {str(error)[:300]}"
            raise ModelError(what, where=self.where, fix="write it again, or give CSV") from error

    # ---- rows in numbers -------------------------------------------------------------------------

    def _refuse_rows(self, bad: Any, what: str, fix: str) -> None:
        """Raise ModelError that names the first of the rows marked."""
        if len(wrong := np.flatnonzero(bad)):
            more = "" if len(wrong) == 1 else f" (and in {len(wrong) - 1:,} more rows)"
            place = f"{'line' if self._of_file else 'row'} {self._places[int(wrong[0])]}"
            raise ModelError(f"{what}{more}", where=f"{self.where}, {place}", fix=fix)

    def _number_chunk(self, chunk: DataFrame) -> tuple[Integers, Integers]:
        """Return the episodes and the numbers of the rows of a chunk; see `read_chunks`."""
        here = range(self.rows, self.rows + len(chunk))
        self._places = chunk.index if self._of_file else here
        parts = self._parts_of(chunk)
        cut, over = self._read_marks({name: parts.pop(name) for name in MARKS if name in parts})
        codes = {name: self._number_values(name, column) for name, column in parts.items()}
        for name in COLUMNS[:4]:
            self._refuse_rows(codes[name] < 0, f"no {name}", "fill it in, or leave the row out")
        episode, state, action, reward, then = (codes[name] for name in COLUMNS)
        self._refuse_rows(
            (then < 0) & ~cut & ~over & self.marked,
            "no next state, in a row that is neither terminated nor truncated",
            "mark the row as one of these, or fill in its next state",
        )
        then = np.where(cut & (then < 0), NOWHERE, then)
        then = np.where(over & (then >= 0), ENDED - then, then)
        self._check_sequence(episode, state, then, cut)
        self.rows += len(chunk)
        return episode, np.stack([state, action, then, reward], axis=1)

    def _parts_of(self, chunk: DataFrame) -> dict[str, Series]:
        """Return the columns that are read, by what they are."""
        there, wanted = list(chunk.columns), dict(self.columns)
        for mark in MARKS:
            if mark in there and mark not in wanted.values():
                wanted.setdefault(mark, mark)
        if not self._parquet:
            self.unused = tuple(str(c) for c in there if c not in wanted.values())
        for column in wanted.values():
            if there.count(column) > 1:
                raise ModelError(
                    f"the column {column!r} stands twice in the table",
                    where=self.where,
                    fix="give each column a name of its own",
                )
        if missing := [name for name, column in wanted.items() if column not in there]:
            raise self._missing_columns_error(missing, [str(column) for column in there])
        return {name: chunk[column] for name, column in wanted.items()}

    def _missing_columns_error(self, missing: Sequence[str], there: Sequence[str]) -> ModelError:
        """Return the error for columns that the table does not have."""
        listed = " nor ".join(repr(self.columns[name]) for name in missing)
        shown = ", ".join(map(repr, there[:9])) + " …" * (len(there) > 9)
        sign = re.search("[;\t|]", there[0]) if len(there) == 1 else None
        if sign:
            fix = f"separate values by commas, or give pandas.read_csv(path, sep={sign[0]!r})"
        else:
            fix = "; ".join(self._suggest_column(name, there) for name in missing)
        what = f"there is no column {listed} among {shown}"
        return ModelError(what, where=self.where, fix=fix)

    def _suggest_column(self, name: str, there: Sequence[str]) -> str:
        """Return what to do about a column that the table does not have."""
        wanted = self.columns[name]
        near = [column for column in there if column.strip().casefold() == wanted.casefold()]
        if near and near[0] != near[0].strip():
            return (
                f"there is {near[0]!r}, with a space: remove spaces beside commas, as "
                "pandas.read_csv(path, skipinitialspace=True) does"
            )
        if not near and name == wanted and name in WITHOUT:
            return WITHOUT[name]
        known = near[0] if near else "…"
        advice = suggest_name(wanted, there)
        return f"{advice}, and say so: columns={{{name!r}: {known!r}}}, --column {name}={known}"

    def _read_marks(self, columns: Mapping[str, Series]) -> tuple[Flags, Flags]:
        """Return (R,) whether an episode was cut off after a row, and whether it was over."""
        marks = {name: self._read_flags(name, column) for name, column in columns.items()}
        none = np.zeros(len(self._places), dtype=bool)
        cut, over = marks.get(TRUNCATED, none), marks.get(TERMINATED, none)
        self.marked = TERMINATED in marks or DONE in marks
        if DONE in marks and TERMINATED not in marks:
            over = marks[DONE] & ~cut
        elif DONE in marks:
            self._refuse_rows(
                (over & ~marks[DONE]) | (marks[DONE] & ~over & ~cut),
                "terminated and done differ",
                "correct one of them, or leave it out",
            )
        return cut & ~over, over

    def _read_flags(self, name: str, column: Series) -> Flags:
        """Return (R,) what a column of marks says."""
        flags = column.map({v: FLAGS.get(str(v).strip().lower()) for v in column.unique()})
        what = f"{self.columns.get(name, name)} is neither true nor false"
        self._refuse_rows(
            flags.isna(), what, "write true or false, or 1 or 0; or leave the column out"
        )
        return np.asarray(flags, dtype=bool)

    def _number_values(self, what: str, column: Series) -> Integers:
        """Return the number of each value of a column; -1 where there is none."""
        import pandas

        named = what != "reward"
        try:
            if named and column.dtype == object and not self._of_file:
                # Pandas takes True for 1.
                column = pandas.Series(map(_to_name, column), dtype=object, name=column.name)
            codes, values = pandas.factorize(column)
        except TypeError as error:
            raise ModelError(
                f"a value cannot be a name: {error}",
                where=f"column {column.name}",
                fix="give numbers or text",
            ) from error
        known, numbers = self.numbers[what.removeprefix("next_")], list[int]()
        for code, value in enumerate(values):
            if self._of_file and value == "":  # an empty field
                numbers.append(-1)
                continue
            name: Any = str(_to_name(value))
            if not named:
                try:
                    number = exact(value)
                except ModelError as error:
                    fix = f"{error.fix}, or leave the row out"
                    self._refuse_rows(codes == code, f"the reward is {value!r}", fix)
                rounded = isinstance(value, float)
                name = rounded, value if rounded else number
            elif name in NO_NAMES or name.isspace():
                self._refuse_rows(
                    codes == code,
                    f"the {what.replace('_', ' ')} is {name!r}, which programs write where there "
                    "is none",
                    "leave it empty where there is none (next_state alone may be); where it is a "
                    "name, write another",
                )
            numbers.append(known.setdefault(name, len(known)))
        return np.asarray(np.array([*numbers, -1], dtype=np.int64)[codes])

    def _check_sequence(
        self, episode: Integers, state: Integers, then: Integers, cut: Flags
    ) -> None:
        """Check that each row begins where the one before ended; count where episodes begin."""
        before, left, over = (
            np.concatenate([[last], each[:-1]])
            for last, each in zip(self._last, (episode, then, cut), strict=True)
        )
        goes_on = episode == before
        # New names are numbered as they come: an episode that is new has a number above the others.
        known = ~goes_on & (episode <= np.maximum.accumulate(before))
        fix = "sort the rows by episode, then by time, and number episodes once"
        self._refuse_rows(known, "an episode goes on after another one began", fix)
        self._refuse_rows(
            goes_on & (left <= ENDED),
            "an episode goes on after a row that says it is over",
            "give what follows another episode number, or correct the mark",
        )
        self._refuse_rows(
            goes_on & (over | (left != state)),
            "a gap in an episode: it goes on in another state than its row before led to, or after "
            "it was over or cut off",
            "add the rows that are missing, mark its last row alone as truncated, or give what "
            "follows another episode number",
        )
        self.starts.update(state[~goes_on].tolist())
        stops = ~goes_on & (before >= 0)  # before the first row there is no episode
        for last, cut_there in zip(left[stops].tolist(), over[stops].tolist(), strict=True):
            self._count_stop(last, cut_there)
        self._last = int(episode[-1]), int(then[-1]), bool(cut[-1])

    def _count_stop(self, then: int, cut: bool) -> None:
        """Count where an episode stops; without a mark, where there are some, it was cut off."""
        self.stops[then, cut or (self.marked and then >= 0)] += 1

    # ---- counts ----------------------------------------------------------------------------------

    def count_rows(self, keys: Integers) -> None:
        """Count rows by their numbers; counts are merged as often as their number doubles."""
        self._counts.append(_sum_counts(keys, np.ones(len(keys), dtype=np.int64)))
        sizes = [len(different) for different, _ in self._counts]
        if sum(sizes) > 2 * sizes[0]:
            self._counts = [self._merge_counts()]

    def _merge_counts(self) -> tuple[Integers, Integers]:
        keys, counts = zip(*self._counts, strict=True)
        return _sum_counts(np.concatenate(keys), np.concatenate(counts))

    @property
    def values(self) -> list[Any]:
        """The rewards, each an exact number or a float, by number."""
        return [number for _, number in self.numbers["reward"]]

    @property
    def n_cut_off(self) -> int:
        """Number of episodes cut off: marked so, or stopped in a state that others leave."""
        left = set(self._merge_counts()[0][:, 0].tolist())
        return sum(count for (then, cut), count in self.stops.items() if cut or then in left)

    def _resolve_next_states(self, then: Integers, keys: Integers) -> Integers:
        """Return next states: that of a terminated row is the end where some record leaves it."""
        state = ENDED - then
        known = ~np.isin(state, keys[:, 0])
        return np.where(then <= ENDED, np.where(known, state, OVER), then)

    def build_parts(
        self, discount: object, unseen: object, *, costs: bool = False
    ) -> dict[str, Any]:
        """Return the parts of the estimated model."""
        rate = as_discount(discount)
        if not self.rows:
            raise ModelError("no transitions", where=self.where, fix="give at least one row")
        keys, count = self._merge_counts()
        keys[:, 2] = self._resolve_next_states(keys[:, 2], keys)
        place, states = _sort_names(self.numbers["state"])
        choice, actions = _sort_names(self.numbers["action"])
        worst = self._find_worst_value(unseen, rate, costs=costs)
        nowhere, ended = (bool((keys[:, 2] == code).any()) for code in (NOWHERE, OVER))
        extra = (CUT_OFF,) * nowhere + (END,) * ended + (UNSEEN,) * (worst is not None)
        for name in {*extra} & {*states}:
            what = f"a state is called {name!r}"
            raise ModelError(what, where=self.where, fix="give it another name")
        size = len(states) + len(extra)
        place = np.append(place, [len(states), len(states) + nowhere])  # at `NOWHERE` and `OVER`
        values = [*self.values, 0, worst or 0]
        rewards = len(self.values)
        state, action, then, reward = keys.T
        observed = [place[state], choice[action], place[then], reward]
        taken = np.zeros((size, len(actions)), dtype=bool)
        taken[observed[0], observed[1]] = True
        over = ~taken.any(axis=1)
        ends = np.flatnonzero(over)
        untried = np.argwhere(~taken & ~over.reshape(-1, 1) & (worst is not None))
        certain = np.concatenate(
            [
                np.stack([ends, 0 * ends, ends, np.full(len(ends), rewards)], axis=1),
                np.insert(untried, [2, 2], [size - 1, rewards + 1], axis=1),
            ]
        )
        outcomes, times = _sum_counts(
            np.concatenate([np.stack(observed, axis=1), certain]),
            np.append(count, np.zeros(len(certain), dtype=np.int64)),
        )
        pair = outcomes[:, :2]
        begins = np.flatnonzero(np.append(True, (pair[1:] != pair[:-1]).any(axis=1)))
        offsets = np.append(begins, len(pair)).astype(np.int64)
        observations = np.add.reduceat(times, begins)
        earned = one_kind([values[number] for number in outcomes[:, 3].tolist()])
        gain, under = group_numbers(earned, offsets)
        table = OutcomeTable(
            offsets=offsets,
            next=outcomes[:, 2].astype(np.int32),
            weight=np.where(np.repeat(observations == 0, np.diff(offsets)), 1, times),
            denominator=np.maximum(observations, 1),
            gain=gain,
            gain_denominator=under,
        )
        unknown = np.zeros(size, dtype=bool)
        stops = np.array([*self.stops], dtype=np.int64).reshape(-1, 2)
        stops[:, 0] = self._resolve_next_states(stops[:, 0], keys)
        cuts, known = (stops[stops[:, 1] == cut, 0] for cut in (1, 0))
        unknown[place[cuts]] = True
        # An episode that was not cut off there was over.
        unknown[place[known[known >= 0]]] = False
        unknown &= over
        begun = {int(place[each]): number for each, number in self.starts.items()}
        episodes = self.starts.total()
        return {
            "table": table,
            "float_rewards": has_floats(earned),
            "pair_state": pair[begins, 0].copy(),
            "pair_action": pair[begins, 1].copy(),
            "observations": observations,
            "space": StateSpace(columns=(_build_column(states),), extra=extra),
            "actions": actions,
            "discount_exact": rate,
            "start": tuple((s, Fraction(n, episodes)) for s, n in sorted(begun.items())),
            "episodes": episodes,
            "labels": {CUT_OFF: unknown} if unknown.any() else {},
        }

    def _find_worst_value(
        self, unseen: object, discount: Fraction, *, costs: bool
    ) -> Fraction | None:
        """Return what an action that nobody took is worth; None where it is not available."""
        if unseen == UNAVAILABLE:
            return None
        if unseen != PESSIMISTIC:
            return exact(unseen, f"unseen, which may be {UNAVAILABLE!r} or {PESSIMISTIC!r}")
        if discount == 1:
            raise ModelError(
                "no value is the worst at discount 1",
                where="unseen",
                fix="give a number: what an action that nobody took is worth",
            )
        worst = max if costs else min
        return worst(Fraction(0), *map(exact, self.values)) / (1 - discount)


def _to_name(value: Any) -> Any:
    """Return a value as a name: a whole number is the same, be it written 1 or 1.0."""
    if isinstance(value, str):
        match = WHOLE.fullmatch(value)
        return match[1] if match else value
    if isinstance(value, bool | np.bool_):
        return str(value)  # no number: True is not 1
    if isinstance(value, float | np.floating) and value.is_integer():
        return int(value)
    return value


def _sum_counts(keys: Integers, count: Integers) -> tuple[Integers, Integers]:
    """Return the different rows of `keys` in order, and the sum of the counts of each."""
    sizes = (np.ptp(keys, axis=0) + 1).tolist()
    if prod(sizes) < EXACT_IN_INT64:  # one number for each row, in their order
        order = np.argsort(np.ravel_multi_index((keys - keys.min(axis=0)).T, sizes))
    else:
        order = np.lexsort(keys.T[::-1])
    keys, count = keys[order], count[order]
    first = np.flatnonzero(np.append(True, (keys[1:] != keys[:-1]).any(axis=1)))
    return keys[first], np.add.reduceat(count, first)


def _sort_names(numbers: Mapping[str, int]) -> tuple[Integers, tuple[str, ...]]:
    """Return the place of each number, and the names in order: whole numbers by size."""
    names = list(numbers)
    keys: Sequence[Any] = _names_to_integers(names) or names
    order = sorted(range(len(names)), key=keys.__getitem__)
    return np.argsort(order), tuple(names[number] for number in order)


def _names_to_integers(names: Sequence[str]) -> tuple[int, ...]:
    """Return names as numbers where all of them are whole numbers as Python writes them."""
    return tuple(map(int, names)) if all(map(NUMBER.fullmatch, names)) else ()


def _build_column(names: tuple[str, ...]) -> Column:
    """Return the column of states by their names, which are numbers where all of them are whole."""
    whole = _names_to_integers(names)
    if whole == tuple(range(len(names))):
        return Column(name="state", size=len(names))
    return Column(name="state", size=len(names), words=names, objects=whole)
