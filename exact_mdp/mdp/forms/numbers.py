"""Reading numbers from arrays, lists and sparse matrices, each with its exact value.

An array holds 64-bit integers or floats if all of its numbers are of that kind; else objects, each
a `Fraction` or a float. A table of outcomes has integers over one denominator for each row, or
floats over 1: `group_numbers` converts numbers of any kind to this form.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from fractions import Fraction
from functools import reduce
from itertools import pairwise
from math import isfinite
from typing import Any

import numpy as np
import scipy.sparse as sp
from numpy.typing import ArrayLike

from exact_mdp.mdp.errors import ModelError, join_few, locate_errors
from exact_mdp.mdp.forms.rows import FLOAT_ROW_TOLERANCE, rationalize_row, rows_to_integers
from exact_mdp.mdp.table import (
    EXACT_IN_FLOAT,
    EXACT_IN_INT64,
    Floats,
    Integers,
    Numbers,
    as_float,
    exact,
    find_magnitude,
    make_ones,
    normalize_rows,
    over_groups,
    to_common_denominator,
    to_integer_array,
    whole_fraction,
)

FEW_ROWS = 10  # converted one by one in the time that arrays take to make: measured


def array_of(values: object, where: str) -> Any:
    """Return a sparse matrix as a CSR array, and other values as an array of numbers or objects."""
    with locate_errors(where):
        if not isinstance(values, np.ndarray):
            values = convert_tensors(values)
            refuse_labels(values)
        if sp.issparse(values):
            return _to_sparse_rows(values)
        return _to_array(values)


def convert_tensors(value: Any) -> Any:
    """Return a tensor, such as PyTorch's, as an array, also in lists; other values as they are.

    NumPy does not have bfloat16: such a tensor becomes float32, which is exact.
    """
    if isinstance(value, list | tuple):
        if any(map(_is_tensor, value)):
            return type(value)(map(convert_tensors, value))
        return value
    if not _is_tensor(value):
        return value
    value = value.detach().cpu()
    try:
        return np.asarray(value.numpy())
    except TypeError:
        return np.asarray(value.float().numpy())


def _is_tensor(value: Any) -> bool:
    return callable(getattr(value, "detach", None)) and callable(getattr(value, "numpy", None))


def float_array(values: object, where: str) -> Floats:
    """Return an array of floats, each the nearest to the given number."""
    array = array_of(values, where)
    with locate_errors(where):
        if array.dtype == object:
            numbers = [as_float(number) for number in array.flat]
            return np.array(numbers, dtype=np.float64).reshape(array.shape)
        return np.array(to_dense(array), dtype=np.float64)


def as_given(value: object) -> Fraction | float:
    """Return a number as a float if it was given as one, else as a Fraction."""
    # The exact type is compared first: isinstance is slow for abstract classes, and this function
    # is called for each number.
    if type(value) is float or type(value) is Fraction:
        return value
    if type(value) is int:
        return whole_fraction(value)
    if isinstance(value, np.floating) and float(value) == value:
        return float(value)
    if isinstance(value, float):
        return float(value)
    return exact(value)


def refuse_masked(values: object, where: str = "") -> None:
    """Raise ModelError for an array with masked entries, which have no value."""
    if np.ma.is_masked(values):
        raise ModelError(
            "entries of the array are masked",
            where=where,
            fix="fill them, as array.filled(0) does; the reward, or the value, of an action that "
            "is not available is -inf (inf for costs)",
        )


def is_pandas_table(value: object) -> bool:
    """Return whether a value is a pandas DataFrame or Series."""
    pandas = sys.modules.get("pandas")  # a user who has one has imported pandas
    return pandas is not None and isinstance(value, pandas.DataFrame | pandas.Series)


def refuse_labels(values: Any) -> None:
    """Raise ModelError for a pandas table, or a list with one, unless its labels count from 0."""
    if not isinstance(values, list | tuple):
        values = [values]
    for table in filter(is_pandas_table, values):
        for labels in table.axes:
            if list(labels) == list(range(len(labels))):
                continue
            raise ModelError(
                f"a table has the labels {join_few(labels, len(labels))}, and arrays of a model go "
                "by position",
                fix="put rows and columns in the order of states and actions, and give "
                "table.to_numpy(); or give dictionaries, which go by name",
            )


def whole_numbers(values: ArrayLike, what: str) -> Integers:
    """Return whole numbers as an array (L,); raise ModelError for anything else."""
    refuse_masked(values, what)
    array = np.asarray(values)
    if array.ndim != 1 or (array.size and array.dtype.kind not in "iu"):
        raise ModelError(
            f"{what} is not a list of whole numbers", where=what, fix="give integers of shape (L,)"
        )
    return array.astype(np.int64)


def _to_sparse_rows(values: Any) -> sp.csr_array:
    """Return a sparse matrix as a CSR array; repeated entries stay separate."""
    if values.dtype.kind not in "fiub":
        raise ModelError(f"a sparse matrix of type {values.dtype}", fix="give real numbers")
    if values.ndim != 2:
        raise ModelError(
            f"a sparse array of shape {values.shape}",
            fix="give a sparse matrix, a list of A sparse (S, S) matrices, or np.array",
        )
    if values.format in ("csr", "csc", "coo"):
        _check_places(values)
    matrix = values
    if type(values) is not sp.csr_array:
        matrix = sp.csr_array(values)
    # SciPy may leave unused room behind the entries.
    count = int(matrix.indptr[-1])
    if len(matrix.indices) > count:
        parts = (matrix.data[:count], matrix.indices[:count], matrix.indptr)
        matrix = sp.csr_array(parts, shape=matrix.shape)
    if values.format == "coo" and matrix.nnz != values.nnz:
        # SciPy added up repeated entries in floats; keep them apart, to be added exactly.
        order = np.lexsort((values.col, values.row))
        counts = np.bincount(values.row, minlength=values.shape[0])
        indptr = np.concatenate([[0], np.cumsum(counts)]).astype(values.col.dtype)
        parts = (values.data[order], values.col[order], indptr)
        matrix = sp.csr_array(parts, shape=values.shape)
    if matrix.dtype.kind in "iub" and matrix.dtype != np.uint64:
        return matrix.astype(np.int64)
    return matrix


def _check_places(matrix: Any) -> None:
    """Raise ModelError if an entry of a sparse matrix is outside its shape."""
    sizes = dict(zip(("row", "column"), matrix.shape, strict=True))
    if matrix.format == "coo":
        named = {"row": matrix.row, "column": matrix.col}
    else:
        ends = matrix.indptr
        axis = {"csr": "column", "csc": "row"}[matrix.format]
        named = {axis: matrix.indices[: max(ends[-1], 0)]}
        if ends[0] != 0 or ends[-1] > len(matrix.indices) or (ends[1:] < ends[:-1]).any():
            raise ModelError(
                "the indptr of a sparse matrix does not rise from 0 to its number of entries",
                fix="build the matrix again, from coordinates for example",
            )
    for what, numbers in named.items():
        if len(numbers) and not 0 <= numbers.min() <= numbers.max() < sizes[what]:
            worst = numbers.max()
            if numbers.min() < 0:
                worst = numbers.min()
            raise ModelError(
                f"a sparse matrix of shape {matrix.shape} has an entry in {what} {worst}",
                fix=f"number its {what}s from 0 to {sizes[what] - 1}",
            )


def _to_array(values: Any) -> Any:
    """Return an array or nested lists as an array of integers, floats, or exact numbers."""
    if isinstance(values, np.ndarray) and values.dtype == object:
        kinds = set(map(type, values.flat))
        if kinds <= {Fraction, float}:
            return np.array(values)  # this is the form of exact numbers already
        if any(issubclass(kind, np.ndarray) for kind in kinds):
            values = values.tolist()  # an array of matrices is a list of them
    # NumPy reads numbers of one type. Integers beside floats become floats.
    kinds = _find_types(values)
    plain = len(kinds) == 1 or kinds <= {int, bool} or kinds <= {int, float, np.float64}
    try:
        if plain:
            array = np.asarray(values)
            plain = array.dtype.kind != "f" or int not in kinds or _may_hold_integers(array)
        if not plain:
            array = np.array(_to_nested_lists(values), dtype=object)
            if list in set(map(type, array.flat)):
                raise ValueError
    except ValueError as error:
        raise ModelError("rows of different lengths", fix="make the array rectangular") from error
    # Integers and floats are exact as they are.
    if array.dtype.kind in "iub" and array.dtype != np.uint64:
        return array.astype(np.int64)
    if array.dtype.kind == "f":
        return array
    if array.dtype.kind not in "OUSu":
        raise ModelError(f"an array of type {array.dtype}", fix="give real numbers")
    # All others are read one by one.
    if array.dtype != object:
        array = np.array(_to_nested_lists(values), dtype=object)
    numbers = [as_given(value) for value in array.flat]
    return np.array(numbers, dtype=object).reshape(array.shape)


def _may_hold_integers(array: Floats) -> bool:
    """Return whether integers that became floats of an array mean the same as before.

    They are floats exactly below 2^53. And an exact 1 differs from 1.0 only in a row with numbers
    so small that they may be rounding errors of its sum.
    """
    sizes = np.abs(array[np.isfinite(array)])
    rounding = (sizes > 0) & (sizes <= FLOAT_ROW_TOLERANCE)
    return bool(sizes.max(initial=0) < EXACT_IN_FLOAT and not rounding.any())


def _find_types(values: Any) -> set[Any]:
    """Return the types of the numbers in an array, or in lists of lists."""
    if isinstance(values, np.ndarray):
        refuse_masked(values)
        return {values.dtype.type}
    if not isinstance(values, list | tuple):
        return {type(values)}
    kinds = set(map(type, values))
    if any(issubclass(kind, list | tuple | np.ndarray) for kind in kinds):
        return set().union(*map(_find_types, values))
    return kinds


def _to_nested_lists(values: Any) -> Any:
    """Return nested lists of the given numbers, each with its own type."""
    if not (isinstance(values, list | tuple) or (isinstance(values, np.ndarray) and values.ndim)):
        return values
    if any(issubclass(kind, list | tuple | np.ndarray) for kind in set(map(type, values))):
        return [_to_nested_lists(value) for value in values]
    return list(values)


def exact_sum(left: Fraction | float, right: Fraction | float) -> Fraction | float:
    """Return the exact sum of two numbers."""
    for value in (left, right):
        if isinstance(value, float) and not isfinite(value):
            return value  # validation refuses it, with its place
    return exact(left) + exact(right)


def chance_sum(left: Fraction | float, right: Fraction | float) -> Fraction | float:
    """Return the sum of two probabilities, or a negative one, which is refused later."""
    least = min(left, right)
    if least < 0:
        return least
    return exact_sum(left, right)


def order_entries(offsets: Integers, columns: Numbers) -> tuple[Integers, Integers, Integers]:
    """Return the row of each entry, its place (N,), and the order of the places.

    Places rise with the row, and within a row with the column.
    """
    row = np.repeat(np.arange(len(offsets) - 1), np.diff(offsets))
    # Row and column in one number sort twenty times as fast as two numbers.
    column = columns.astype(np.int64)
    if len(row) and not 0 <= column.min() <= column.max() < 2**31:
        column = np.unique(columns, return_inverse=True)[1]
    place = row * (int(column.max(initial=0)) + 1) + column
    return row, place, np.argsort(place, kind="stable")


def merge_entries(
    offsets: Integers,
    columns: Numbers,
    values: Numbers,
    keys: Any = None,
    *,
    chances: bool = False,
) -> tuple[Integers, Numbers, Numbers, Integers]:
    """Sort the columns of each row, and add up the values of entries with equal column and key.

    Return offsets, columns, values, and the first of the entries that became each one. If the
    values are probabilities (`chances`), a row of floats that has equal entries is first replaced
    by the exact row that it stands for (`mdp.forms.rows`).
    """
    row, place, order = order_entries(offsets, columns)
    parted = [place[order]]
    if keys is not None:
        # Keys are compared only where the place is the same: to order fractions takes long.
        same = np.flatnonzero(parted[0][1:] == parted[0][:-1])
        shared = order[np.union1d(same, same + 1)]
        rank = np.zeros(len(row), dtype=np.int64)
        rank[shared] = np.unique(keys[shared], return_inverse=True)[1]
        order = np.lexsort((rank, place))
        parted = [place[order], rank[order]]
    columns, values = columns[order], values[order]
    # An entry is fresh if it differs from the one before in row, column or key.
    fresh = np.ones(len(row), dtype=bool)
    fresh[1:] = np.logical_or.reduce([part[1:] != part[:-1] for part in parted])
    first = np.flatnonzero(fresh)
    if len(first) < len(row):
        parts = [as_given(value) for value in values]
        add = exact_sum
        if chances:
            add = chance_sum
            for k in np.unique(row[~fresh]).tolist():
                begin, end = offsets[k], offsets[k + 1]
                parts[begin:end] = rationalize_row(parts[begin:end])
        # Each fresh entry begins a run of equal ones, which become their sum.
        values = np.empty(len(first), dtype=object)
        for number, (begin, end) in enumerate(pairwise([*first.tolist(), len(parts)])):
            values[number] = reduce(add, parts[begin:end])
        offsets = np.searchsorted(first, offsets)
    return offsets, columns[first], values, order[first]


def to_dense(values: Any) -> Any:
    """Return a sparse array as a dense one, and other values as they are."""
    if sp.issparse(values):
        return values.toarray()
    return values


def one_kind(values: Sequence[Any]) -> Numbers:
    """Return an array of floats or 64-bit integers if all numbers are of that kind, or objects."""
    kinds = set(map(type, values))
    if kinds and kinds <= {float, np.float64}:
        return np.array(values, dtype=np.float64)
    if kinds == {int} and find_magnitude(to_integer_array(values)) < EXACT_IN_INT64:
        return np.array(values)
    if kinds != {Fraction}:
        values = [as_given(value) for value in values]
    return np.array(values, dtype=object)


def has_floats(values: Numbers) -> bool:
    """Return whether some numbers were given as floats."""
    if values.dtype != object:
        return values.dtype.kind == "f"
    return any(issubclass(kind, float) for kind in set(map(type, values)))


def group_numbers(values: Any, offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return numbers in the form of a table: numerators, and one denominator for each group."""
    below = make_ones(len(offsets) - 1)
    if isinstance(values, np.ndarray) and values.dtype in (np.float64, np.int64):
        return np.ascontiguousarray(values), below
    flat = values.tolist() if isinstance(values, np.ndarray) else values
    if set(map(type, flat)) == {Fraction}:
        return over_groups(flat, offsets)
    flat = [as_given(value) for value in flat]
    floats = [value for value in flat if isinstance(value, float)]
    if not all(map(isfinite, floats)):
        # Validation refuses the model, with the place of the number.
        return np.array([as_float(value) for value in flat]), below
    if floats and all(isinstance(value, float) or _is_double(value) for value in flat):
        return np.array([float(value) for value in flat]), below
    return over_groups([exact(value) for value in flat], offsets)


def rationalize_rows(values: Numbers, offsets: Integers) -> tuple[Numbers, Numbers]:
    """Return exact rows in the form of a table; as floats if the rows stand for the same then."""
    if values.dtype.kind == "f":
        values = values.astype(np.float64, copy=False)
    if values.dtype != object:
        return group_numbers(values, offsets)
    flat = [as_given(value) for value in values]
    if not has_floats(values):
        return group_numbers(flat, offsets)
    rows = [flat[first:last] for first, last in pairwise(offsets.tolist())]
    if all(_in_floats(row) for row in rows):
        return np.array([float(value) for value in flat]), make_ones(len(rows))
    tops, bottoms, known = list[int](), list[int](), _float_rows_to_integers(rows)
    for number, row in enumerate(rows):
        if number not in known:
            exactly = rationalize_row(row)
            if any(isinstance(value, float) and not isfinite(value) for value in exactly):
                return group_numbers(flat, offsets)
            known[number] = to_common_denominator([exact(value) for value in exactly])
        top, below = known[number]
        tops += top
        bottoms.append(below)
    return to_integer_array(tops), to_integer_array(bottoms)


def _float_rows_to_integers(
    rows: list[list[Fraction | float]],
) -> dict[int, tuple[list[int], int]]:
    """Return the exact rows of floats, {number: (numerators, denominator)}, all at once.

    This takes a tenth of the time of `rationalize_row`. For few rows, and for rows that are not
    distributions, return {}.
    """
    places = []
    for number, row in enumerate(rows):
        if all(isinstance(value, float) for value in row):
            places.append(number)
    if len(places) <= FEW_ROWS:
        return {}
    weight = np.array([value for number in places for value in rows[number]], dtype=np.float64)
    offsets = np.cumsum([0, *(len(rows[number]) for number in places)])
    if not normalize_rows(weight, offsets):
        return {}
    tops, bottoms = (array.tolist() for array in rows_to_integers(weight, offsets))
    ends = pairwise(offsets.tolist())
    each = [(tops[first:last], below) for (first, last), below in zip(ends, bottoms, strict=True)]
    return dict(zip(places, each, strict=True))


def _in_floats(row: list[Fraction | float]) -> bool:
    """Return whether a row of floats and exact numbers stands for the same if all are floats."""
    if all(isinstance(value, float) for value in row) or row == [1]:
        return True
    if not all(map(_is_double, row)):
        return False
    return rationalize_row(row) == rationalize_row([float(value) for value in row])


def _is_double(value: Fraction | float) -> bool:
    """Return whether a float has exactly this value."""
    try:
        return float(value) == value
    except OverflowError:
        return False
