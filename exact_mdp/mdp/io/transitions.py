"""A model estimated from recorded transitions, with the numbers of observations.

If action a was taken n(s, a) times in state s, and k of these led to s' with reward r, then

    P(s', r | s, a) = k / n(s, a)          the maximum likelihood estimate, a rational number

The start is estimated from the first states of the episodes; the model keeps their number. A state
that no record leaves is assumed to be an end. There may be three more columns:

    truncated     marks the rows after which an episode was cut off, for example by a time limit
    terminated    marks the rows after which it was over, whatever the next state
    done          the same as terminated, if that column is missing; a row that is also truncated
                  was cut off

A state that is entered only by rows that were cut off is not an end, and its value is unknown (the
label "cut off"). Truncated rows without a next state lead to a special state. They must not be
dropped, since truncation depends on the steps that would have followed. The next state of a
terminated row is kept if no record leaves it; otherwise it belongs to a reset, and the row leads to
the end. If the records mark terminated rows, an episode with an unmarked last row was cut off.

If rows are marked, the column episode may be missing, as in a replay buffer: an episode begins
after each marked row. So may next_state, as in a trajectory: it is the state of the next row of the
episode. Files are .csv (separated by commas, tabs or semicolons), .jsonl (an object in each line),
both also as .gz, and .parquet. Usual names of columns are read as these: obs, next_obs, actions,
rewards, terminals, timeouts, dones, traj_id.

An action that was never taken in a state is unavailable there; or it has a bad value that the
caller chooses, so that an optimum does not depend on untried actions (the pessimism of Jin, Yang
and Wang, ICML 2021).

Rows are read in chunks and counted, so memory holds one chunk and one number for each different
outcome (s, a, s', r). Rewards that hardly ever repeat should be rounded first.
"""

from __future__ import annotations

import gzip
import io
import re
import zlib
from collections import Counter
from collections.abc import Collection, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
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
    join_few,
    require_extra,
    require_known_name,
    require_type,
    suggest_name,
    warn_user,
)
from exact_mdp.mdp.forms.numbers import group_numbers, has_floats, one_kind
from exact_mdp.mdp.io.files import open_file
from exact_mdp.mdp.io.formats import RECORDS, find_format, join_endings
from exact_mdp.mdp.io.structured import csv_of, json_of
from exact_mdp.mdp.sense import Sense
from exact_mdp.mdp.space import Column, StateSpace
from exact_mdp.mdp.table import EXACT_IN_INT64, Integers, OutcomeTable, Rows, exact
from exact_mdp.mdp.validate import Flags, as_discount, as_start, check_options

if TYPE_CHECKING:
    from pandas import DataFrame, Series


COLUMNS = ("episode", "state", "action", "reward", "next_state")
TRUNCATED, TERMINATED, DONE = "truncated", "terminated", "done"
MARKS = (TRUNCATED, TERMINATED, DONE)  # optional columns
CUT_OFF = "cut off"  # the label of states in which episodes were cut off, and that no row leaves
FLAGS = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False}
# Texts for missing values, which cannot be names; the list of pandas.read_csv.
NO_NAMES = frozenset(
    ("", "#N/A", "<NA>", "N/A", "NA", "NULL", "NaN", "NaT", "None", "n/a", "nan", "null")
)
# Codes of next states: no next state since the episode is over, or was cut off; and ENDED - t for a
# row that is terminated in state t.
ENDS_HERE = "(ends here)"  # a column beside a table's own, while its rows are filled in
OVER, NOWHERE, ENDED = -1, -2, -3
ROWS = 2**13  # rows of a chunk, so that their texts fit in a core's cache
NO_TABLES = frozenset((".json", ".zip", ".bz2", ".xz", ".xlsx", ".pkl", ".feather"))
NUMBER = re.compile(r"0|-?[1-9][0-9]{0,3999}")
WHOLE = re.compile(r"(-?[0-9]+)\.0+")  # pandas writes 1 as 1.0 in a column with missing values
END, UNSEEN = "end", "unseen"
WITHOUT = {  # advice for a missing column
    "episode": "number the episodes, or mark the last row of each in a column done, terminated or "
    "truncated",
    "next_state": "add the state that follows, or mark the last row of each episode in a column "
    "done or terminated if it is over, truncated if it was cut off",
}
USUAL = {  # other names of the columns, which are read if the table does not have the first
    "episode": ("episode_id", "trajectory", "traj_id"),
    "state": ("obs", "observation", "observations"),
    "action": ("act", "actions"),
    "reward": ("rew", "rewards"),
    "next_state": ("next_obs", "next_observation", "next_observations", "new_obs"),
    TRUNCATED: ("truncations", "timeouts"),
    TERMINATED: ("terminations", "terminals"),
    DONE: ("dones",),
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
        """Estimate a model from recorded transitions, with the numbers of observations.

        Parameters
        ----------
        frame : DataFrame, path of a file of `mdp.io.transitions`, or iterable of DataFrames
            One row for each transition: episode, state, action, reward and next state, in the order
            of time, one episode after the other. A missing next state means that the episode is
            over. 1 and 1.0 are the same name. A column truncated (true or false) marks the rows
            after which an episode was cut off, for example by a time limit. States in which that
            happened, and that no row leaves, have the label "cut off"; rows cut off without a next
            state lead to a state of that name. A column terminated, or done, marks the rows after
            which an episode was over, whatever their next state. Other columns are ignored, with a
            warning.
        discount : number or "p/q"
        columns : mapping, optional
            The table's names of the columns "episode", "state", "action", "reward", "next_state"
            and, if it has them, "truncated", "terminated" and "done".
        unseen : "unavailable", "pessimistic", or a number
            The treatment of an action that was never taken in a state: it is unavailable; or it
            ends the episode, with the lowest value that a policy could have, or with this number.
        progress : bool
            Show a progress bar on standard error, if that is a terminal.
        **names
            `name`, `sense`; `start`, a known initial distribution instead of the estimate from the
            first states of the episodes.

        Returns
        -------
        MDP
            With `observations` (L,), `counts` (L, S) and `episodes`.

        Raises
        ------
        ModelError
            For a missing column or value, or a gap in an episode, with the row; and as the
            constructor does.

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
        check_options(names, dict.fromkeys(known, "leave it out: it follows from the records"))
        start = names.pop("start", None)
        record = count_transitions(frame, columns, progress=progress)
        if record.unused:
            others = ", ".join(map(repr, record.unused))
            warn_user(f"columns that are not used: {others}")
        parts = record.build_parts(discount, unseen, costs=Sense.of_options(names).costs)
        if start is not None:
            parts |= {"start": as_start(start, parts["space"]), "episodes": None}
        labels = {**(names.get("labels") or {}), **parts["labels"]}
        return cls(**(parts | names | {"labels": labels}))


def count_transitions(
    frame: Any, columns: Mapping[str, str] | None, *, progress: bool = False
) -> TransitionRecord:
    """Return the counts of a table of transitions; see `MDP.from_transitions`."""
    record = TransitionRecord(frame, columns)
    for _, keys in record.read_marked_chunks(progress=progress):
        record.count_rows(keys)
    return record


class TransitionRecord:
    """A reader of a table of transitions, which numbers names and counts rows.

    Names of episodes, states and actions are numbered in order of appearance; so are rewards, each
    with whether it is a float, since a model knows which of its numbers were rounded.
    """

    def __init__(self, frame: Any, columns: Mapping[str, str] | None = None) -> None:
        given = dict(
            require_type(columns or {}, Mapping, "columns", "give {name: name in the table}")
        )
        for name in given:
            require_known_name(name, (*COLUMNS, *MARKS), "column", "columns")
        self.given = given
        self.columns = dict(zip(COLUMNS, COLUMNS, strict=True)) | given
        self.frame = frame
        self.where, self.form = "transitions", None
        if isinstance(frame, str | Path):
            self.where = str(frame)
            self.form = find_format(self.where.removesuffix(".gz"), RECORDS) or RECORDS[".csv"]
        self._of_lines = self.form not in (None, RECORDS[".parquet"])
        self._of_texts = self.form is RECORDS[".csv"]
        self.numbers: dict[str, dict[Any, int]] = {name: {} for name in COLUMNS[:4]}
        self._implied: set[str] = set()  # columns that are missing, and follow from the marks
        self.rows = 0
        self.unused: dict[str, None] = {}  # columns that are not read
        self.starts = Counter[int]()  # episodes by first state
        self.stops = Counter[tuple[int, bool]]()  # episodes by last next state, and whether cut off
        self._counts: list[tuple[Integers, Integers]] = []
        self._places: Any = ()  # line or row numbers of this chunk, for messages
        self._last = (-1, -1, False)  # episode, next state and cut of the last row
        self._problems: list[tuple[str, str, str]] = []  # place, what and fix of bad rows
        self.marked = False  # whether rows are marked as terminated

    # ---- reading ---------------------------------------------------------------------------------

    def read_chunks(self) -> Iterator[tuple[Integers, Integers]]:
        """Yield for each chunk the episodes (R,), and state, action, next state and reward (R, 4).

        All are checked, and are numbers of names; a next state may be `OVER` or `NOWHERE`.
        """
        for episode, keys in self.read_marked_chunks():
            keys[keys[:, 2] <= ENDED, 2] = OVER
            yield episode, keys

    def read_marked_chunks(self, *, progress: bool = False) -> Iterator[tuple[Integers, Integers]]:
        """Yield chunks in which the next state t of a terminated row has the code ENDED - t."""
        disable: bool | None = True
        if progress:
            disable = None  # show a bar if standard error is a terminal
        with (
            tqdm.tqdm(desc="transitions", unit=" rows", disable=disable) as bar,
            closing(self._fill_columns(self._iterate_tables())) as chunks,
        ):
            for chunk in chunks:
                for first in range(0, len(chunk), ROWS):
                    part = chunk.iloc[first : first + ROWS]
                    yield self._number_chunk(part)
                    bar.update(len(part))
        if self.rows:
            self._count_stop(*self._last[1:])

    def _iterate_tables(self) -> Generator[DataFrame]:
        """Yield tables of rows: a file in parts, other tables as they are."""
        import pandas

        if self.form is not None:
            suffix = Path(self.where).suffix.lower()
            if suffix in NO_TABLES:
                raise ModelError(
                    f"cannot read {suffix}",
                    where=self.where,
                    fix=f"save it as {join_endings(RECORDS)}; in Python, give the DataFrame that "
                    "pandas reads from it",
                )
            # A file is read in chunks: the limit of a terabyte only stops endless input.
            with open_file(self.where, most=2**40) as file:
                content: Any = file
                if suffix == ".gz":
                    content = gzip.GzipFile(fileobj=file)
                try:
                    yield from self.form.read_file(self, content)
                except (EOFError, gzip.BadGzipFile, zlib.error) as error:
                    what, fix = f"the file is not a whole .gz file: {error}", "compress it again"
                    raise ModelError(what, where=self.where, fix=fix) from error
            return
        tables = self.frame
        if isinstance(tables, pandas.DataFrame) or not isinstance(tables, Iterable):
            tables = [tables]
        for table in tables:
            fix = "give a DataFrame, several of them, or the path of a "
            fix += f"{join_endings(RECORDS)} file"
            yield require_type(table, pandas.DataFrame, "transitions", fix)

    def iterate_csv(self, file: Any) -> Generator[DataFrame]:
        """Yield the rows of a CSV file as texts, so that "0.1" is 1/10; the index has the lines."""
        import pandas

        fix = "correct the line; if an episode is over, leave next_state empty after its comma"
        with self._open_text(file) as text:
            rows = csv_of(self._read_lines(text), self.where, fix=fix)
            _, header = next(rows, (0, []))
            # The last table is empty; it shows the columns of a file without rows.
            more = True
            while more:
                listed = [*islice(rows, ROWS)]
                more = bool(listed)
                values = np.array([row for _, row in listed], dtype=object)
                values = values.reshape(len(listed), len(header))
                yield pandas.DataFrame(values, [line for line, _ in listed], header, dtype=object)

    def iterate_jsonl(self, file: Any) -> Generator[DataFrame]:
        """Yield the rows of a file with a JSON object in each line; "0.1" is 1/10 there, too."""
        import pandas

        with self._open_text(file) as text:
            lines = (each for each in enumerate(self._read_lines(text), 1) if each[1].strip())
            while listed := [*islice(lines, ROWS)]:
                rows = []
                for number, line in listed:
                    place = f"{self.where}, line {number}"
                    row = json_of(line, place, parse_float=str)
                    if not isinstance(row, dict):
                        fix = 'write {"episode": 1, "state": …} in each line'
                        raise ModelError("the line is not a JSON object", where=place, fix=fix)
                    # A list, such as the place on a map, becomes a name.
                    rows.append({key: _freeze_list(value) for key, value in row.items()})
                yield pandas.DataFrame(rows, [line for line, _ in listed], dtype=object)

    @contextmanager
    def _open_text(self, file: Any) -> Iterator[io.TextIOWrapper]:
        """Read a file as UTF-8 text."""
        text = io.TextIOWrapper(file, "utf-8-sig", newline="")
        try:
            yield text
        except UnicodeError as error:
            raise ModelError(
                "the file is not UTF-8 text", where=self.where, fix="save it as UTF-8 text"
            ) from error
        finally:
            text.detach()

    def _read_lines(self, text: io.TextIOWrapper) -> Iterator[str]:
        """Yield the lines of a file; refuse a line that is too long for a table of transitions."""
        most = 2**20  # characters
        for line in iter(lambda: text.readline(most), ""):
            if len(line) == most:
                raise ModelError(
                    f"a line has more than {most:,} characters",
                    where=self.where,
                    fix="check that it is the right file: a table has one line for each transition",
                )
            yield line

    def iterate_parquet(self, file: Any) -> Generator[DataFrame]:
        """Yield the rows of a Parquet file in batches."""
        with require_extra("models"):
            from pyarrow import parquet
        try:
            table = parquet.ParquetFile(file)
            names = table.schema_arrow.names
            used = {*self._find_columns(names).values()}
            for batch in table.iter_batches(ROWS, columns=[n for n in names if n in used]):
                # The metadata of pandas could turn a column into an index: ignore it.
                yield batch.to_pandas(ignore_metadata=True, integer_object_nulls=True)
        except ModelError:
            raise
        except Exception as error:  # Arrow raises many kinds on damaged files
            what = f"the file is not a Parquet file: {str(error)[:300]}"
            raise ModelError(what, where=self.where, fix="write it again, or give CSV") from error

    def _fill_columns(self, tables: Iterable[DataFrame]) -> Generator[DataFrame]:
        """Yield tables with the columns episode and next_state, which marks imply if they miss.

        An episode goes on until a marked row; the next state of a row that is not marked is the
        state of the next row of its episode. The last row of each table waits for the next table.
        """
        import pandas

        held, number, over = None, 0, False
        for table in tables:
            missing: Collection[str] = ()
            if len(table):
                self.columns = self._find_columns([*table.columns])
                missing = self._implied
            if not missing:
                yield table
                continue
            table = table.copy()
            ended = np.zeros(len(table), dtype=bool)
            for mark in {*MARKS} & {*self.columns}:
                flags = table[self.columns[mark]].map(lambda v: FLAGS.get(str(v).strip().lower()))
                ended |= flags.fillna(value=False).to_numpy(dtype=bool)
            if "episode" in missing:
                begins = np.append(over, ended[:-1])
                table[self.columns["episode"]] = number + np.cumsum(begins)
                number, over = int(table[self.columns["episode"]].iloc[-1]), bool(ended[-1])
            if "next_state" not in missing:
                yield table
                continue
            table[ENDS_HERE] = ended
            if held is not None:
                table = pandas.concat([held, table])
            episode = table[self.columns["episode"]].to_numpy()
            then = table[self.columns["state"]].astype(object).shift(-1)
            last = table[ENDS_HERE].to_numpy(dtype=bool, copy=True)
            last[:-1] |= episode[1:] != episode[:-1]
            table[self.columns["next_state"]] = then.where(~last, "" if self._of_texts else None)
            held = table.iloc[-1:]
            yield table.iloc[:-1].drop(columns=ENDS_HERE)
        if held is not None:
            yield held.drop(columns=ENDS_HERE)

    # ---- rows in numbers -------------------------------------------------------------------------

    def _refuse_rows(self, bad: Any, what: str, fix: str) -> None:
        """Note the first of the bad rows (R,), if there are any, as a problem."""
        wrong = np.flatnonzero(bad)
        if not len(wrong):
            return
        if len(wrong) > 1:
            what += f" (and in {len(wrong) - 1:,} more rows)"
        place = f"row {self._places[int(wrong[0])]}"
        if self._of_lines:
            place = f"line {self._places[int(wrong[0])]}"
        self._problems.append((place, what, fix))

    def _raise_problems(self) -> None:
        """Raise one ModelError for all problems that were noted."""
        if len(self._problems) == 1:
            place, what, fix = self._problems[0]
            raise ModelError(what, where=f"{self.where}, {place}", fix=fix)
        if self._problems:
            what = "; ".join(f"{place}: {what}" for place, what, _ in self._problems)
            fix = "; ".join(dict.fromkeys(fix for *_, fix in self._problems))
            raise ModelError(what, where=self.where, fix=fix)

    def _number_chunk(self, chunk: DataFrame) -> tuple[Integers, Integers]:
        """Return the episodes and the numbers of the rows of a chunk; see `read_chunks`."""
        self._places = range(self.rows, self.rows + len(chunk))
        if self._of_lines:
            self._places = chunk.index
        # Read the marks, and number the values of the other columns.
        parts = {name: chunk[column] for name, column in self.columns.items()}
        cut, over = self._read_marks({name: parts.pop(name) for name in MARKS if name in parts})
        codes = {name: self._number_values(name, column) for name, column in parts.items()}
        for name in COLUMNS[:4]:
            self._refuse_rows(codes[name] < 0, f"no {name}", "fill it in, or leave the row out")
        self._raise_problems()
        # Code the next states; a missing one is allowed only at the end of an episode.
        episode, state, action, reward, then = (codes[name] for name in COLUMNS)
        self._refuse_rows(
            (then < 0) & ~cut & ~over & self.marked,
            "no next state, in a row that is neither terminated nor truncated",
            "mark the row as one of these, or fill in its next state",
        )
        then = np.where(cut & (then < 0), NOWHERE, then)
        then = np.where(over & (then >= 0), ENDED - then, then)
        self._check_sequence(episode, state, then, cut)
        self._raise_problems()
        self.rows += len(chunk)
        return episode, np.stack([state, action, then, reward], axis=1)

    def _find_columns(self, there: Sequence[Any]) -> dict[str, str]:
        """Return the table's name of each column, and of those that the marks imply."""
        found = dict(zip(COLUMNS, COLUMNS, strict=True)) | self.given
        for mark in MARKS:
            if mark in there and mark not in found.values():
                found.setdefault(mark, mark)
        for name, others in USUAL.items():
            usual = [other for other in others if other in there and other not in found.values()]
            if name in self.given or found.get(name) in there or not usual:
                continue
            if len(usual) > 1:
                fix = f"say which: columns={{{name!r}: {usual[0]!r}}}, --column {name}={usual[0]}"
                what = f"{' and '.join(map(repr, usual))} may both be the column {name!r}"
                raise ModelError(what, where=self.where, fix=fix)
            found[name] = usual[0]
        for column in found.values():
            if there.count(column) > 1:
                raise ModelError(
                    f"the column {column!r} appears twice in the table",
                    where=self.where,
                    fix="give each column a name of its own",
                )
        missing = [name for name, column in found.items() if column not in there]
        self._implied = {*missing} & {"episode", "next_state"}
        if not {*found} & {*MARKS} or {*missing} - self._implied:
            self._implied = set()
        if {*missing} - self._implied:
            self.columns = found
            raise self._missing_columns_error(missing, [str(column) for column in there])
        unread = [str(column) for column in there if column not in found.values()]
        self.unused |= dict.fromkeys(unread)
        return found

    def _missing_columns_error(self, missing: Sequence[str], there: Sequence[str]) -> ModelError:
        """Return the error for columns that the table does not have."""
        listed = " nor ".join(repr(self.columns[name]) for name in missing)
        shown = join_few(map(repr, there), len(there), most=9)
        fix = "; ".join(self._suggest_column(name, there) for name in missing)
        what = f"there is no column {listed} among {shown}"
        return ModelError(what, where=self.where, fix=fix)

    def _suggest_column(self, name: str, there: Sequence[str]) -> str:
        """Return advice for a column that the table does not have."""
        wanted = self.columns[name]
        near = [column for column in there if column.strip().casefold() == wanted.casefold()]
        if near and near[0] != near[0].strip():
            return (
                f"there is {near[0]!r}, with a space: remove spaces beside commas, as "
                "pandas.read_csv(path, skipinitialspace=True) does"
            )
        if not near and name == wanted and name in WITHOUT:
            return WITHOUT[name]
        known = "…"
        if near:
            known = near[0]
        advice = suggest_name(wanted, there)
        return f"{advice}, and name it: columns={{{name!r}: {known!r}}}, --column {name}={known}"

    def _read_marks(self, columns: Mapping[str, Series]) -> tuple[Flags, Flags]:
        """Return (R,) whether an episode was cut off after each row, and (R,) whether it ended."""
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
        """Return a column of marks as truth values (R,)."""
        flags = column.map({v: FLAGS.get(str(v).strip().lower()) for v in column.unique()})
        what = f"{self.columns.get(name, name)} is neither true nor false"
        self._refuse_rows(
            flags.isna(), what, "write true or false, or 1 or 0; or leave the column out"
        )
        return np.asarray(flags, dtype=bool)

    def _number_values(self, what: str, column: Series) -> Integers:
        """Return the number of each value of a column; -1 for a missing value."""
        import pandas

        named = what != "reward"
        try:
            if named and column.dtype == object and not self._of_texts:
                # For pandas, True equals 1.
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
            if self._of_texts and value == "":  # an empty field
                numbers.append(-1)
                continue
            name: Any = str(_to_name(value))
            if not named:
                try:
                    number = exact(value)
                except ModelError as error:
                    fix = f"{error.fix}, or leave the row out"
                    self._refuse_rows(codes == code, f"the reward is {value!r}", fix)
                    number = Fraction(0)
                name = (False, number)
                if isinstance(value, float):
                    name = (True, value)
            elif name in NO_NAMES or name.isspace():
                self._refuse_rows(
                    codes == code,
                    f"the {what.replace('_', ' ')} is {name!r}, which programs write for a missing "
                    "value",
                    "leave it empty if it is missing (allowed for next_state only); if it is a "
                    "name, choose another",
                )
            numbers.append(known.setdefault(name, len(known)))
        return np.asarray(np.array([*numbers, -1], dtype=np.int64)[codes])

    def _check_sequence(
        self, episode: Integers, state: Integers, then: Integers, cut: Flags
    ) -> None:
        """Check that each row begins where the one before led; count the starts and the stops."""
        last_episode, last_state, last_cut = self._last
        before = np.concatenate([[last_episode], episode[:-1]])
        left = np.concatenate([[last_state], then[:-1]])
        over = np.concatenate([[last_cut], cut[:-1]])
        goes_on = episode == before
        # Episodes are numbered in order of appearance: a new one has the highest number so far.
        known = ~goes_on & (episode <= np.maximum.accumulate(before))
        fix = "sort the rows by episode, then by time, and give each episode its own number"
        self._refuse_rows(known, "an episode continues after another one began", fix)
        self._raise_problems()
        self._refuse_rows(
            goes_on & (left <= ENDED),
            "an episode continues after a row that is marked as terminated",
            "give the rows that follow another episode number, or correct the mark",
        )
        self._raise_problems()
        self._refuse_rows(
            goes_on & (over | (left != state)),
            "a gap in an episode: a row begins in another state than the next state of the row "
            "before, or after the episode was over or cut off",
            "add the missing rows, mark only its last row as truncated, or give the rows that "
            "follow another episode number",
        )
        self.starts.update(state[~goes_on].tolist())
        # An episode stops before the first row of another one; the last one when the file ends.
        stops = ~goes_on & (before >= 0)
        for last, cut_there in zip(left[stops].tolist(), over[stops].tolist(), strict=True):
            self._count_stop(last, cut_there)
        self._last = int(episode[-1]), int(then[-1]), bool(cut[-1])

    def _count_stop(self, then: int, cut: bool) -> None:
        """Count the end of an episode; if others are marked and this one is not, it was cut off."""
        self.stops[then, cut or (self.marked and then >= 0)] += 1

    # ---- counts ----------------------------------------------------------------------------------

    def count_rows(self, keys: Integers) -> None:
        """Count the different rows of a chunk; merge all counts when their number has doubled."""
        self._counts.append(_sum_counts(keys, np.ones(len(keys), dtype=np.int64)))
        sizes = [len(different) for different, _ in self._counts]
        if sum(sizes) > 2 * sizes[0]:
            self._counts = [self._merge_counts()]

    def _merge_counts(self) -> tuple[Integers, Integers]:
        """Return the different rows of all chunks, and their counts."""
        keys, counts = zip(*self._counts, strict=True)
        return _sum_counts(np.concatenate(keys), np.concatenate(counts))

    @property
    def values(self) -> list[Any]:
        """The different rewards, each an exact number or a float, by number."""
        return [number for _, number in self.numbers["reward"]]

    @property
    def n_cut_off(self) -> int:
        """Number of episodes cut off: marked as such, or stopped in a state that others leave."""
        left = set(self._merge_counts()[0][:, 0].tolist())
        return sum(count for (then, cut), count in self.stops.items() if cut or then in left)

    def _resolve_next_states(self, then: Integers, keys: Integers) -> Integers:
        """Return next states; a terminated row leads to the end if some record leaves its state."""
        state = ENDED - then
        known = ~np.isin(state, keys[:, 0])
        return np.where(then <= ENDED, np.where(known, state, OVER), then)

    def _warn_of_done(self, keys: Integers, count: Integers) -> None:
        """Warn if rows that are done, perhaps cut off, lead to states that other rows leave."""
        if {*MARKS} & {*self.columns} != {"done"}:
            return
        number = count[np.isin(ENDED - keys[:, 2], keys[:, 0]) & (keys[:, 2] <= ENDED)].sum()
        if number:
            warn_user(
                f"{number:,} rows of {self.where} are done in states that other rows leave, and "
                "count as ends; if a time limit cut some off, mark them in a column 'truncated'"
            )

    def build_parts(
        self, discount: object, unseen: object, *, costs: bool = False
    ) -> dict[str, Any]:
        """Return the parts of the estimated model."""
        rate = as_discount(discount)
        if not self.rows:
            raise ModelError("no transitions", where=self.where, fix="give at least one row")
        # Number states and actions in the order of their names; extra states follow.
        keys, count = self._merge_counts()
        self._warn_of_done(keys, count)
        keys[:, 2] = self._resolve_next_states(keys[:, 2], keys)
        place, states = _sort_names(self.numbers["state"])
        choice, actions = _sort_names(self.numbers["action"])
        worst = self._find_worst_value(unseen, rate, costs=costs)
        nowhere, ended = (bool((keys[:, 2] == code).any()) for code in (NOWHERE, OVER))
        extra = list[str]()
        if nowhere:
            extra.append(CUT_OFF)
        if ended:
            extra.append(END)
        if worst is not None:
            extra.append(UNSEEN)
        for name in {*extra} & {*states}:
            what = f"a state is named {name!r}, like an additional state of the model"
            raise ModelError(what, where=self.where, fix="give it another name")
        size = len(states) + len(extra)
        # Negative codes index the array from its end: OVER is -1, NOWHERE -2.
        place = np.append(place, [len(states), len(states) + nowhere])
        values = [*self.values, 0, worst or 0]
        rewards = len(self.values)
        state, action, then, reward = keys.T
        observed = [place[state], choice[action], place[then], reward]
        # States without a record are ends; untried actions of other states may get the worst value.
        taken = np.zeros((size, len(actions)), dtype=bool)
        taken[observed[0], observed[1]] = True
        over = ~taken.any(axis=1)
        ends = np.flatnonzero(over)
        untried = np.argwhere(~taken & ~over.reshape(-1, 1) & (worst is not None))
        # Both have one certain outcome: stay with reward 0, or go to the last state with reward
        # `worst`. They have no observations.
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
        # Group the outcomes by pair.
        pair = outcomes[:, :2]
        begins = np.flatnonzero(np.append(True, (pair[1:] != pair[:-1]).any(axis=1)))
        offsets = np.append(begins, len(pair)).astype(np.int64)
        observations = np.add.reduceat(times, begins)
        earned = one_kind([values[number] for number in outcomes[:, 3].tolist()])
        gain, under = group_numbers(earned, offsets)
        rows = Rows(
            offsets=offsets,
            next=outcomes[:, 2].astype(np.int32),
            weight=np.where(np.repeat(observations == 0, np.diff(offsets)), 1, times),
            denominator=np.maximum(observations, 1),
        )
        table = OutcomeTable(rows=rows, gain=gain, gain_denominator=under)
        # States in which episodes were cut off, and none was over, have unknown values.
        unknown = np.zeros(size, dtype=bool)
        stops = np.array([*self.stops], dtype=np.int64).reshape(-1, 2)
        stops[:, 0] = self._resolve_next_states(stops[:, 0], keys)
        cuts, known = (stops[stops[:, 1] == cut, 0] for cut in (1, 0))
        unknown[place[cuts]] = True
        unknown[place[known[known >= 0]]] = False
        unknown &= over
        labels = {}
        if unknown.any():
            labels[CUT_OFF] = unknown
        begun = {int(place[each]): number for each, number in self.starts.items()}
        episodes = self.starts.total()
        return {
            "table": table,
            "float_rewards": has_floats(earned),
            "pair_state": pair[begins, 0].copy(),
            "pair_action": pair[begins, 1].copy(),
            "observations": observations,
            "space": StateSpace(columns=(_build_column(states),), extra=tuple(extra)),
            "actions": actions,
            "discount_exact": rate,
            "start": tuple((s, Fraction(n, episodes)) for s, n in sorted(begun.items())),
            "episodes": episodes,
            "labels": labels,
        }

    def _find_worst_value(
        self, unseen: object, discount: Fraction, *, costs: bool
    ) -> Fraction | None:
        """Return the value of an action that was never taken; None if it is unavailable."""
        if unseen == UNAVAILABLE:
            return None
        if unseen != PESSIMISTIC:
            return exact(unseen, f"unseen, which may be {UNAVAILABLE!r} or {PESSIMISTIC!r}")
        if discount == 1:
            raise ModelError(
                "there is no worst value at discount 1",
                where="unseen",
                fix="give a number: the value of an action that was never taken",
            )
        # The worst policy earns the worst reward forever: r / (1 - γ).
        rewards = [Fraction(0), *map(exact, self.values)]
        if costs:
            return max(rewards) / (1 - discount)
        return min(rewards) / (1 - discount)


def _freeze_list(value: Any) -> Any:
    """Return a list as a tuple, which can be a name; other values as they are."""
    if isinstance(value, list):
        return tuple(map(_freeze_list, value))
    return value


def _to_name(value: Any) -> Any:
    """Return a value as a name, in which 1 and 1.0 are the same, but True and 1 are not."""
    if isinstance(value, str):
        match = WHOLE.fullmatch(value)
        if match:
            return match[1]
        return value
    if isinstance(value, bool | np.bool_):
        return str(value)
    if isinstance(value, float | np.floating) and value.is_integer():
        return int(value)
    return value


def _sum_counts(keys: Integers, count: Integers) -> tuple[Integers, Integers]:
    """Return the different rows of `keys`, sorted, and the sum of the counts of each."""
    # If rows can be coded as single numbers with the same order, sorting is much faster.
    sizes = (np.ptp(keys, axis=0) + 1).tolist()
    if prod(sizes) < EXACT_IN_INT64:
        order = np.argsort(np.ravel_multi_index((keys - keys.min(axis=0)).T, sizes))
    else:
        order = np.lexsort(keys.T[::-1])
    keys, count = keys[order], count[order]
    first = np.flatnonzero(np.append(True, (keys[1:] != keys[:-1]).any(axis=1)))
    return keys[first], np.add.reduceat(count, first)


def _sort_names(numbers: Mapping[str, int]) -> tuple[Integers, tuple[str, ...]]:
    """Return the sorted names (whole numbers by size), and the place of each number in them."""
    names = list(numbers)
    keys: Sequence[Any] = _names_to_integers(names) or names
    order = sorted(range(len(names)), key=keys.__getitem__)
    return np.argsort(order), tuple(names[number] for number in order)


def _names_to_integers(names: Sequence[str]) -> tuple[int, ...]:
    """Return names as integers if all are whole numbers in Python's notation; else ()."""
    if not all(map(NUMBER.fullmatch, names)):
        return ()
    return tuple(map(int, names))


def _build_column(names: tuple[str, ...]) -> Column:
    """Return the column of states with the given names; whole numbers are also objects."""
    whole = _names_to_integers(names)
    if whole == tuple(range(len(names))):
        return Column(name="state", size=len(names))
    return Column(name="state", size=len(names), words=names, objects=whole)
