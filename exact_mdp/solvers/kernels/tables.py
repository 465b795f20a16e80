"""A model laid out for sampling in constant time.

Alias tables: a pair with n outcomes has n columns, each holding an outcome of its own and an alias;
u · n picks a column, and the fraction left over decides between the two (Walker 1977; built as in
Vose, IEEE Transactions on Software Engineering 17, 1991).
"""

from __future__ import annotations

from typing import NamedTuple

from exact_mdp.mdp.forms.compiling import compiled
from exact_mdp.mdp.table import Floats, Numbers


class Tables(NamedTuple):
    """A model laid out for sampling; made by `solvers.learning.sampler`.

    A position is the number of a pair; behind those come the actions that terminal states are
    given where a learner looks beyond the end. An entry is a number in a flat (K·A,) Q-table.

    Attributes
    ----------
    low, high : (S,) int64
        Positions of each state's actions: low[s] … high[s]-1.
    entry : (L+X,) int64
        Entry of the Q-table that each position reads.
    offsets : (L+1,) int64
        Alias columns of pair l are offsets[l] … offsets[l+1]-1.
    cut : (N,) float64
        Where each column passes from its own outcome to its alias.
    next, gain : (2N,) int64, float64
        Next state and reward: of column i itself at 2i, of its alias at 2i + 1.
    terminal : (S,) bool
    start, start_total : (B,) int64, (B,) float64
        First states and their cumulative probabilities.
    row_offsets, row_entry : (K+1,), (…,) int64
        Entries that a greedy policy compares in each of the K rows of the Q-table.
    """

    low: Numbers
    high: Numbers
    entry: Numbers
    offsets: Numbers
    cut: Floats
    next: Numbers
    gain: Floats
    terminal: Numbers
    start: Numbers
    start_total: Floats
    row_offsets: Numbers
    row_entry: Numbers


@compiled
def alias_tables(
    offsets: Numbers,
    probability: Floats,
    cut: Floats,
    alias: Numbers,
    small: Numbers,
    large: Numbers,
) -> None:
    """Fill `cut` and `alias` (N,) for rows of probabilities (N,) that `offsets` (L+1,) delimit.

    `small` and `large` (N,) are room to work in.
    """
    for pair in range(len(offsets) - 1):
        first, last = offsets[pair], offsets[pair + 1]
        total = 0.0
        for i in range(first, last):
            total += probability[i]
        few, many = 0, 0
        for i in range(first, last):
            cut[i], alias[i] = probability[i] / total * (last - first), i
            if cut[i] < 1.0:
                small[few] = i
                few += 1
            else:
                large[many] = i
                many += 1
        while few > 0 and many > 0:
            few -= 1
            giver = large[many - 1]
            alias[small[few]] = giver
            cut[giver] = (cut[giver] + cut[small[few]]) - 1.0
            if cut[giver] < 1.0:
                many -= 1
                small[few] = giver
                few += 1
        # What is left over is 1 up to rounding: these columns keep their own outcome.
        for i in range(few):
            cut[small[i]] = 1.0
        for i in range(many):
            cut[large[i]] = 1.0
