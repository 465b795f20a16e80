"""A model estimated from recorded transitions, with the numbers of observations kept.

If action a was taken n(s, a) times in state s, and k of these led to s' with reward r, then

    P(s', r | s, a) = k / n(s, a)          the maximum likelihood estimate, a rational number

The start is estimated from where episodes begin; the model keeps their number. A state that no
record leaves is taken for an end (`entered` lists these). A sixth column, `truncated`, marks the
rows after which an episode was cut off, by a time limit for instance: a state that is entered only
so is no end, and its value is unknown (`cut_off`). Truncated rows without a next state lead to a
special state. They must not be dropped, since truncation depends on what would have followed.

An action that was never taken in a state is unavailable there; or it is as bad as the caller says,
so that an optimum does not rely on what nobody tried (the pessimism of Jin, Yang and Wang,
ICML 2021).

Rows are read in chunks and counted, so memory holds one chunk and one number for each different
outcome (s, a, s', r). Round rewards that hardly ever repeat first.
"""

from __future__ import annotations

import csv
import io
import re
import warnings
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Any, Self

import numpy as np
import tqdm

from exact_mdp.mdp.build import FromArrays
from exact_mdp.mdp.errors import ModelError, extra, of_type, suggest
from exact_mdp.mdp.forms.numbers import grouped, has_floats, one_kind
from exact_mdp.mdp.io.files import opened
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import Integers, OutcomeTable, exact
from exact_mdp.mdp.validate import Flags, as_discount, as_start, check_options

if TYPE_CHECKING:
    from pandas import DataFrame, Series


COLUMNS = ("episode", "state", "action", "reward", "next_state")
TRUNCATED = "truncated"  # the column that a table may have besides
CUT_OFF = "cut off"  # the label of states in which episodes were cut off, and which nobody left
FLAGS = {"true": True, "1": True, "1.0": True, "false": False, "0": False, "0.0": False}
# What other tables call a column that says how an episode stopped, without capitals and marks.
LIKE_TRUNCATED = frozenset(
    ("truncated", "truncation", "truncate", "istruncated", "cut", "cutoff", "wascutoff", "timeout",
     "timelimit", "timedout", "censored", "terminated", "terminal", "termination", "isterminal",
     "done", "dones", "end", "ended", "last", "islast")
)  # fmt: skip
# What programs write where there is no value: no names, as pandas.read_csv has it.
NO_NAMES = frozenset(
    ("", "#N/A", "<NA>", "N/A", "NA", "NULL", "NaN", "NaT", "None", "n/a", "nan", "null")
)
NOWHERE = -2  # the next state of a row that was cut off without one
ROWS = 10**6  # of a chunk
LARGEST_FILE = 2**40
WHOLE = re.compile(r"(-?[0-9]+)\.0+")  # as pandas writes 1 in a column where a value is missing
END, UNSEEN = "end", "unseen"
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
            A whole number is the same name as 1 and as 1.0. A sixth column, truncated (true or
            false), marks the rows after which an episode was cut off, as by a time limit. States
            in which that happened, and that nobody left, have the label "cut off"; rows cut off
            without a next state lead to one of that name.
        discount : number or "p/q"
        columns : mapping, optional
            The names that the table has for "episode", "state", "action", "reward", "next_state"
            and, where it has it, "truncated".
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
        check_options(names, told=("states", "actions", "components"))
        start = names.pop("start", None)
        record = counted(frame, columns, progress=progress)
        parts = record.parts(discount, unseen, costs=names.get("sense") == "min")
        if start is not None:
            parts |= {"start": as_start(start, parts["space"]), "episodes": None}
        labels = {**(names.get("labels") or {}), **parts["labels"]}
        return cls(**(parts | names | {"labels": labels}))


def counted(
    frame: DataFrame | str | Path | Iterable[DataFrame],
    columns: Mapping[str, str] | None = None,
    *,
    progress: bool = False,
) -> Record:
    """Return what was counted in a table of transitions; see `MDP.from_transitions`."""
    record = record_of(frame, columns)
    for _, keys in read(record, frame, progress=progress):
        record.count(keys)
    record.finish()
    return record


def record_of(frame: object, columns: Mapping[str, str] | None = None) -> Record:
    """Return an empty record for a table of transitions."""
    where = str(frame) if isinstance(frame, str | Path) else "transitions"
    return Record(where, _named(columns))


def read(
    record: Record,
    frame: DataFrame | str | Path | Iterable[DataFrame],
    *,
    progress: bool = False,
) -> Iterator[tuple[Integers, Integers]]:
    """Yield the rows of a table, a million at most at a time, checked and in numbers.

    Of each chunk the episodes (R,), and (R, 4) state, action, next state (-1 where the episode is
    over, `NOWHERE` where it was cut off without one) and reward, by the numbers that `record`
    gives to names.
    """
    with (
        tqdm.tqdm(desc="transitions", unit=" rows", disable=None if progress else True) as bar,
        closing(_chunks(frame, record.columns.values())) as chunks,
    ):
        for chunk in chunks:
            for first in range(0, len(chunk), ROWS):
                part = chunk.iloc[first : first + ROWS]
                yield record.numbered(part)
                bar.update(len(part))


def _named(columns: Mapping[str, str] | None) -> dict[str, str]:
    """Return the file's column of each of the five, and of a sixth where it is named."""
    given = dict(of_type(columns or {}, Mapping, "columns", "give {name: name in the table}"))
    for name in given:
        if name not in (*COLUMNS, TRUNCATED):
            near = suggest(str(name), [*COLUMNS, TRUNCATED])
            raise ModelError(f"unknown column {name!r}", where="columns", fix=near)
    found = dict(zip(COLUMNS, COLUMNS, strict=True)) | given
    twice = [name for name, column in found.items() if list(found.values()).count(column) > 1]
    if twice:
        raise ModelError(
            f"the column {found[twice[0]]!r} stands for {' and '.join(twice)}",
            where="columns",
            fix="name one column for each",
        )
    return found


def _chunks(frame: Any, wanted: Iterable[str]) -> Generator[DataFrame]:
    """Yield tables of rows: of a file by the million, of everything else as they come."""
    import pandas

    if not isinstance(frame, str | Path):
        tables = [frame] if isinstance(frame, pandas.DataFrame) else frame
        for table in tables if isinstance(tables, Iterable) else [tables]:
            if not isinstance(table, pandas.DataFrame):
                raise ModelError(
                    f"a {type(table).__name__} is no table of transitions",
                    where="transitions",
                    fix="give a DataFrame, several of them, or the path of a .csv or .parquet file",
                )
            yield table
        return
    path, used = str(frame), list(wanted)
    with opened(path, most=LARGEST_FILE) as file:
        if Path(path).suffix.lower() == ".parquet":
            yield from _parquet(file, path, [*used, TRUNCATED])
            return
        yield from _csv(file, path)


def _csv(file: Any, path: str) -> Generator[DataFrame]:
    import pandas

    errors = pandas.errors
    try:
        header = next(csv.reader([file.readline().decode("utf-8-sig", "replace")]), [])
        _check_once(header, f"{path}, line 1")
        _check_widths(file, path, len(header))
        with warnings.catch_warnings(action="error", category=errors.ParserWarning):
            # Text is kept as it is written: "0.1" is 1/10, and 007 is not 7 (but see `_name`).
            reader = pandas.read_csv(
                file, dtype=str, chunksize=ROWS, encoding="utf-8-sig", na_values=[""],
                keep_default_na=False, index_col=False,
            )  # fmt: skip
        with reader:
            while True:
                # A line with more fields than the header would lose them with a warning.
                with warnings.catch_warnings(action="error", category=errors.ParserWarning):
                    chunk = next(reader, None)
                if chunk is None:
                    return
                yield chunk
    except UnicodeError as error:
        raise ModelError(
            "the file is not UTF-8 text", where=path, fix="save it as UTF-8 text"
        ) from error
    except (errors.ParserError, errors.ParserWarning, errors.EmptyDataError, csv.Error) as error:
        raise ModelError(
            f"the file is no table: {str(error).strip()}",
            where=path,
            fix="give CSV with a header and the same columns in every line",
        ) from error


def _check_once(names: Sequence[str], where: str) -> None:
    """Raise ModelError where two columns have one name."""
    if twice := sorted({name for name in names if names.count(name) > 1}):
        raise ModelError(
            f"the column {twice[0]!r} stands twice in the header",
            where=where,
            fix="give each column a name of its own",
        )


def _check_widths(file: Any, path: str, width: int) -> None:
    """Raise ModelError for a line with fewer fields than the header, which pandas fills up."""
    file.seek(0)
    text = io.TextIOWrapper(file, "utf-8-sig", newline="")
    try:
        lines = csv.reader(text)
        for line in lines:
            if 0 < len(line) < width:
                raise ModelError(
                    f"{len(line)} values under {width} headings",
                    where=f"{path}, line {lines.line_num}",
                    fix="correct the line; where an episode is over, leave next_state empty after "
                    "its comma",
                )
    finally:
        text.detach()
    file.seek(0)


def _parquet(file: Any, path: str, used: list[str]) -> Generator[DataFrame]:
    with extra("models"):
        from pyarrow import parquet
    try:
        table = parquet.ParquetFile(file)
        _check_once(table.schema_arrow.names, path)
        found = [name for name in table.schema_arrow.names if name in used or _like_cut(name)]
        for batch in table.iter_batches(ROWS, columns=found):
            # The columns say it all: what pandas noted beside them may hide one as an index.
            yield batch.to_pandas(ignore_metadata=True, integer_object_nulls=True)
    except ModelError:
        raise
    except Exception as error:  # Arrow raises many kinds on damaged files
        raise ModelError(
            f"the file is no Parquet: {str(error)[:300]}",
            where=path,
            fix="write it again, or give CSV",
        ) from error


def _name(value: Any) -> Any:
    """Return a value as a name: a whole number is the same, be it written 1 or 1.0."""
    if isinstance(value, str):
        found = WHOLE.fullmatch(value)
        return found[1] if found else value
    if isinstance(value, bool | np.bool_):
        return str(value)  # no number: True is not 1
    if isinstance(value, float | np.floating) and value.is_integer():
        return int(value)
    return value


def _like_cut(name: object) -> bool:
    """Return whether a column is called like one that says how an episode stopped."""
    return "".join(filter(str.isalpha, str(name).lower())) in LIKE_TRUNCATED


class _Names:
    """Numbers for names, in the order in which they come."""

    def __init__(self, read: Callable[[Any], Any] = _name) -> None:
        self.numbers: dict[Any, int] = {}
        self.read = read
        self.blank: set[str] = set()  # names of spaces only

    def of(self, column: Series) -> Integers:
        """Return the number of each value; -1 where there is none."""
        import pandas

        try:
            codes, values = pandas.factorize(column)
        except TypeError as error:
            raise ModelError(
                f"a value cannot be a name: {error}",
                where=f"column {column.name}",
                fix="give numbers or text",
            ) from error
        # Python takes True for 1, and so does pandas: as numbers they are one, as names two.
        asked = self.read is _name and column.dtype == object and any(v in (0, 1) for v in values)
        either = column.dropna() if asked else ()
        if len({isinstance(v, bool | np.bool_) for v in either if v in (0, 1)}) > 1:
            raise ModelError(
                "the column holds both truth values and the numbers 0 or 1",
                where=f"column {column.name}",
                fix="use one kind of names",
            )
        self.blank.update(value for value in values if isinstance(value, str) and value.isspace())
        known = [self.numbers.setdefault(self.read(v), len(self.numbers)) for v in values]
        found: Integers = np.array([*known, -1], dtype=np.int64)[codes]
        return found


class Record:
    """What has been counted so far, and where the last row left its episode."""

    def __init__(self, where: str, columns: dict[str, str]) -> None:
        self.where, self.columns = where, columns
        self.file = Path(where).suffix.lower() == ".csv"
        self.states, self.actions, self.episodes = (_Names() for _ in range(3))
        self.rewards = _Names(lambda value: value)
        self.counts: list[tuple[Integers, Integers]] = []
        self.values: list[Any] = []  # of the rewards, by number
        self.starts: dict[int, int] = {}
        self.stops: dict[tuple[int, bool], int] = {}  # by next state, and whether it was cut off
        self.rows = 0
        self.ignored: tuple[str, ...] = ()  # columns called like `truncated` that are not read
        self.last = (-1, -1, False)  # episode, next state, whether it was cut off

    def row(self, number: int) -> str:
        """Return how a row is called, in messages: in a file by its line, blank ones counted."""
        if not self.file:
            return f"{self.where}, row {number}"
        with opened(self.where, most=LARGEST_FILE) as file:
            text = io.TextIOWrapper(file, "utf-8-sig", newline="")
            lines = csv.reader(text)
            left, before = number + 1, 0  # the header is one, too
            for line in lines:
                if line and not left:
                    break
                left, before = left - bool(line), lines.line_num
            text.detach()
        return f"{self.where}, line {before + 1}"

    def refuse(self, bad: Any, what: str, fix: str) -> None:
        """Raise ModelError that names the first rows of those marked."""
        found = np.flatnonzero(bad)
        if len(found):
            more = "" if len(found) == 1 else f" (and in {len(found) - 1:,} more rows)"
            raise ModelError(f"{what}{more}", where=self.row(self.rows + int(found[0])), fix=fix)

    def numbered(self, chunk: DataFrame) -> tuple[Integers, Integers]:
        """Return the episodes and the numbers of the rows of a chunk; see `read`."""
        for name, column in self.columns.items():
            if list(chunk.columns).count(column) > 1:
                raise ModelError(
                    f"the column {column!r} stands twice in the table",
                    where=self.where,
                    fix="give each column a name of its own",
                )
            if column not in chunk:
                spaced = [each for each in map(str, chunk.columns) if each.strip() == column]
                near = suggest(column, map(str, chunk.columns))
                if spaced:
                    near = f"it is called {spaced[0]!r}, with spaces"
                fix = f"{near}; name it (--column {name}=…, columns={{{name!r}: …}})"
                if len(chunk.columns) == 1 and {";", "\t", "|"} & set(str(chunk.columns[0])):
                    fix = "separate columns by commas: the first line has none"
                raise ModelError(f"no column {column!r}", where=self.where, fix=fix)
        parts = {name: chunk[column] for name, column in self.columns.items()}
        used = {TRUNCATED, *self.columns.values()}
        self.ignored = tuple(str(c) for c in chunk.columns if c not in used and _like_cut(c))
        cut = self._cut(chunk)
        episode, state, action = (
            names.of(parts[name])
            for name, names in (
                ("episode", self.episodes),
                ("state", self.states),
                ("action", self.actions),
            )
        )
        then, reward = self.states.of(parts["next_state"]), self.rewards.of(parts["reward"])
        for name, codes in (
            ("episode", episode), ("state", state), ("action", action), ("reward", reward),
        ):  # fmt: skip
            self.refuse(codes < 0, f"no {name}", "fill it in, or leave the row out")
        for name, codes, names in (
            ("episode", episode, self.episodes), ("state", state, self.states),
            ("action", action, self.actions), ("next state", then, self.states),
        ):  # fmt: skip
            for word in names.blank:
                self.refuse(
                    codes == names.numbers[word],
                    f"the {name} is {word!r}, spaces only",
                    "leave it empty where there is none (next_state alone may be)",
                )
            for word in NO_NAMES & names.numbers.keys():
                self.refuse(
                    codes == names.numbers[word],
                    f"the {name} is {word!r}, which programs write where there is none",
                    "leave it empty where there is none (next_state alone may be); where it is a "
                    "name, write another",
                )
        then = np.where(cut & (then < 0), NOWHERE, then)
        self._follow(episode, state, then, cut)
        self._price(reward)
        self.rows += len(chunk)
        return episode, np.stack([state, action, then, reward], axis=1)

    def _cut(self, chunk: DataFrame) -> Flags:
        """Return (R,) whether an episode was cut off after a row; nowhere without such a column."""
        import pandas

        name = self.columns.get(TRUNCATED, TRUNCATED)
        if list(chunk.columns).count(name) > 1:
            raise ModelError(
                f"the column {name!r} stands twice in the table",
                where=self.where,
                fix="give each column a name of its own",
            )
        if name not in chunk or list(self.columns.values()).count(name) > (
            TRUNCATED in self.columns
        ):
            return np.zeros(len(chunk), dtype=bool)
        codes, values = pandas.factorize(chunk[name])
        known = [FLAGS.get(str(value).strip().lower()) for value in values]
        bad = np.array([*(each is None for each in known), True])[codes]
        self.refuse(bad, f"{name} is neither true nor false", "write true or false, or 1 or 0")
        found: Flags = np.array([*map(bool, known), False])[codes]
        return found

    def count(self, keys: Integers) -> None:
        """Count rows by their numbers."""
        self.counts.append(_sums(keys, np.ones(len(keys), dtype=np.int64)))
        if len(self.counts) > 16:
            self.counts = [_merged(self.counts)]

    def _price(self, reward: Integers) -> None:
        """Read the rewards that are new as the numbers that they are."""
        for value, code in list(self.rewards.numbers.items())[len(self.values) :]:
            try:
                exact(value)
            except ModelError as error:
                fix = f"{error.fix}, or leave the row out"
                self.refuse(reward == code, f"the reward is {value!r}", fix)
            # Floats stay floats: a model knows which of its numbers were rounded.
            self.values.append(exact(value) if isinstance(value, str) else value)

    def _follow(self, episode: Integers, state: Integers, then: Integers, cut: Flags) -> None:
        """Check that each row begins where the one before ended; count where episodes begin."""
        if not len(episode):
            return
        before = np.concatenate([[self.last[0]], episode[:-1]])
        left = np.concatenate([[self.last[1]], then[:-1]])
        over = np.concatenate([[self.last[2]], cut[:-1]])
        goes_on = episode == before
        # New names are numbered as they come: an episode that is new has a number above the others.
        most = np.maximum.accumulate(before)
        self.refuse(
            ~goes_on & (episode <= most),
            "an episode goes on after another one began",
            "sort the rows by episode, then by time, and number episodes once",
        )
        self.refuse(
            goes_on & over,
            "an episode goes on after it was cut off",
            "mark its last row alone as truncated, or give what follows another episode number",
        )
        self.refuse(
            goes_on & (left == -1),
            "an episode goes on after it was over: the row before leads nowhere",
            "give the next state there, or give what follows another episode number",
        )
        self.refuse(
            goes_on & (left != state),
            "a gap in an episode: its next row begins in another state than this one led to",
            "add the rows that are missing, or give what follows another episode number",
        )
        fresh, times = np.unique(state[~goes_on], return_counts=True)
        for each, count in zip(fresh.tolist(), times.tolist(), strict=True):
            self.starts[each] = self.starts.get(each, 0) + count
        stops = ~goes_on & (before >= 0)  # before the first row there is no episode
        self._stop(left[stops], over[stops])
        self.last = (int(episode[-1]), int(then[-1]), bool(cut[-1]))

    def _stop(self, then: Integers, cut: Flags) -> None:
        """Count episodes that stop, by their last next states."""
        ends, times = np.unique(2 * then + cut, return_counts=True)
        for end, count in zip(ends.tolist(), times.tolist(), strict=True):
            key = (end >> 1, bool(end & 1))
            self.stops[key] = self.stops.get(key, 0) + count

    def finish(self) -> None:
        """Count where the last episode stops; no row comes any more."""
        self._stop(np.array([self.last[1]]), np.array([self.last[2]]))
        self.last = (-1, -1, False)

    @property
    def n_cut_off(self) -> int:
        """Number of episodes cut off: marked so, or stopped in a state that others leave."""
        left = set(_merged(self.counts)[0][:, 0].tolist())
        return sum(count for (then, cut), count in self.stops.items() if cut or then in left)

    @property
    def n_episodes(self) -> int:
        """Number of episodes."""
        return sum(self.starts.values())

    def parts(self, discount: object, unseen: object, *, costs: bool = False) -> dict[str, Any]:
        """Return the parts of the estimated model."""
        rate = as_discount(discount)
        if not self.rows:
            raise ModelError("no transitions", where=self.where, fix="give at least one row")
        keys, count = _merged(self.counts)
        place, states = _sorted(self.states.numbers)
        choice, actions = _sorted(self.actions.numbers)
        worst = self._worst(unseen, rate, costs=costs)
        nowhere, ended = (bool((keys[:, 2] == code).any()) for code in (NOWHERE, -1))
        extra = (CUT_OFF,) * nowhere + (END,) * ended + (UNSEEN,) * (worst is not None)
        for name in extra:
            if name in states:
                raise ModelError(
                    f"a state is called {name!r}", where=self.where, fix="give it another name"
                )
        # Where there is no next state: cut off, or the end.
        place = np.append(place, [len(states), len(states) + nowhere])
        known: dict[Any, int] = {}
        same = [known.setdefault((isinstance(v, float), v), n) for n, v in enumerate(self.values)]
        values = [*self.values, 0, 0 if worst is None else worst]
        size = len(states) + len(extra)
        observed = np.column_stack(
            [place[keys[:, 0]], choice[keys[:, 1]], place[keys[:, 2]], np.array(same)[keys[:, 3]]]
        )
        taken = np.zeros((size, len(actions)), dtype=bool)
        taken[observed[:, 0], observed[:, 1]] = True
        over = ~taken.any(axis=1)
        unknown = np.zeros(size, dtype=bool)
        for cut in (True, False):  # an episode that was not cut off there was over
            stops = [
                then for (then, flag), count in self.stops.items() if flag is cut and then >= 0
            ]
            unknown[place[stops]] = cut
        if nowhere:
            unknown[place[NOWHERE]] = True
        unknown &= over
        at_end = np.flatnonzero(over)
        free = ~taken & ~over.reshape(-1, 1) & (worst is not None)
        untried = np.argwhere(free)
        certain = np.concatenate(
            [
                np.column_stack([at_end, 0 * at_end, at_end, np.full(len(at_end), len(same))]),
                np.insert(untried, [2, 2], [size - 1, len(same) + 1], axis=1),
            ]
        )
        outcomes, times = _sums(
            np.concatenate([observed, certain]),
            np.append(count, np.zeros(len(certain), dtype=np.int64)),
        )
        return {
            **_table(outcomes, times, values),
            "space": StateSpace(columns=StateSpace.plain(len(states), states).columns, extra=extra),
            "actions": actions,
            "discount_exact": rate,
            "start": tuple(
                sorted(
                    (int(place[each]), Fraction(number, self.n_episodes))
                    for each, number in self.starts.items()
                )
            ),
            "episodes": self.n_episodes,
            "labels": {CUT_OFF: unknown} if unknown.any() else {},
        }

    def _worst(self, unseen: object, discount: Fraction, *, costs: bool) -> Fraction | None:
        """Return what an action that nobody took is worth; None where it is not available."""
        if unseen == UNAVAILABLE:
            return None
        if unseen != PESSIMISTIC:
            try:
                return exact(unseen)
            except ModelError as error:
                raise ModelError(
                    f"actions that nobody took are {unseen!r}",
                    where="unseen",
                    fix=f"give {UNAVAILABLE!r}, {PESSIMISTIC!r}, or what they are worth",
                ) from error
        if discount == 1:
            raise ModelError(
                "no value is the worst at discount 1",
                where="unseen",
                fix="give a number: what an action that nobody took is worth",
            )
        worst = max if costs else min
        return worst(Fraction(0), *map(exact, self.values)) / (1 - discount)


def _sums(keys: Integers, count: Integers) -> tuple[Integers, Integers]:
    """Return the different rows of `keys`, and the sum of the counts of each."""
    order = np.lexsort(keys.T[::-1])
    keys, count = keys[order], count[order]
    fresh = np.ones(len(keys), dtype=bool)
    fresh[1:] = (keys[1:] != keys[:-1]).any(axis=1)
    first = np.flatnonzero(fresh)
    return keys[first], np.add.reduceat(count, first) if len(first) else count


def _merged(parts: Sequence[tuple[Integers, Integers]]) -> tuple[Integers, Integers]:
    keys, counts = zip(*parts, strict=True)
    return _sums(np.concatenate(keys), np.concatenate(counts))


def _sorted(numbers: Mapping[Any, int]) -> tuple[Integers, tuple[str, ...]]:
    """Return the place of each number, and the names in order: whole numbers by size."""
    names = [str(name) for name in numbers]
    whole = all(name.removeprefix("-").isdecimal() for name in names)
    order = sorted(range(len(names)), key=lambda n: (int(names[n]) if whole else 0, names[n]))
    place = np.empty(len(names), dtype=np.int64)
    place[order] = np.arange(len(names))
    if len(set(names)) < len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ModelError(
            f"{twice!r} is both a number and a text", where="names", fix="use one kind of names"
        )
    return place, tuple(names[n] for n in order)


def _table(outcomes: Integers, count: Integers, values: Sequence[Any]) -> dict[str, Any]:
    """Return the table of outcomes (N, 4), in order, its pairs, and the observations of each."""
    pair = outcomes[:, :2]
    first = np.flatnonzero(np.append(True, (pair[1:] != pair[:-1]).any(axis=1)))
    offsets = np.append(first, len(pair)).astype(np.int64)
    observations = np.add.reduceat(count, first)
    earned = one_kind([values[number] for number in outcomes[:, 3].tolist()])
    gain, under = grouped(earned, offsets)
    table = OutcomeTable(
        offsets=offsets,
        next=outcomes[:, 2].astype(np.int32),
        weight=np.where(np.repeat(observations == 0, np.diff(offsets)), 1, count),
        denominator=np.maximum(observations, 1),
        gain=gain,
        gain_denominator=under,
    )
    return {
        "table": table,
        "float_rewards": has_floats(earned),
        "pair_state": pair[first, 0].copy(),
        "pair_action": pair[first, 1].copy(),
        "observations": observations,
    }
