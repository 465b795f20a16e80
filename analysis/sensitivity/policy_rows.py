"""The different policies among those of many draws, each a row of small integers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from mdp.table import Integers


def distinct(rows: Integers) -> tuple[Integers, Integers]:
    """Return the (U, G) different rows of (D, G) small integers, and (D,) which of them each is.

    Rows are told apart by two 64-bit sums of random odd multiples; that two rows which differ have
    both sums in common is about as likely as guessing a number of 128 bits.
    """
    width = rows.shape[1] * rows.dtype.itemsize
    padded = np.zeros((len(rows), -(-width // 8) * 8), dtype=np.uint8)
    padded[:, :width] = np.ascontiguousarray(rows).view(np.uint8)
    words = padded.view(np.uint64)
    keys = np.random.default_rng(0).integers(0, 2**63, size=(words.shape[1], 2), dtype=np.uint64)
    sums = words @ (2 * keys + 1)
    both = np.ascontiguousarray(sums).view([("a", np.uint64), ("b", np.uint64)]).reshape(-1)
    _, where, inverse = np.unique(both, return_index=True, return_inverse=True)
    order = np.argsort(where)
    place = np.empty(len(order), dtype=np.int32)
    place[order] = np.arange(len(order))
    return rows[where[order]], place[inverse.reshape(-1)]


def merged(blocks: Sequence[Mapping[str, np.ndarray]]) -> tuple[Integers, Integers]:
    """Return the different rows of several blocks, in order of appearance, and each draw's."""
    found: dict[bytes, int] = {}
    rows, which = [], []
    for block in blocks:
        places = []
        for row in np.ascontiguousarray(block["rows"]):
            places.append(found.setdefault(row.tobytes(), len(found)))
            if places[-1] == len(rows):
                rows.append(row)
        which.append(np.array(places, dtype=np.int64)[block["which"]])
    return np.stack(rows), np.concatenate(which)
