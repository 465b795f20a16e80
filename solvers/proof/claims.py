"""What a certificate claims: the fields that the checker checks and that a file keeps.

`solvers.proof.certificate` says what each field means, and adds rational values, the check against
a model, and saving. The fields stand apart so that the checker and the file format know nothing
else of a certificate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from exact_mdp.mdp.table import Floats, Integers


@dataclass(frozen=True, kw_only=True, eq=False)
class ExactClaims:
    """What an exact certificate claims; see `solvers.proof.certificate.Certificate`."""

    model: str
    numerator: Sequence[int]
    group: Integers
    denominator: Sequence[int]
    policy: Integers
    optimal_pairs: NDArray[np.bool_]
    gap: Sequence[int | None]
    gap_scale: Sequence[int]
    unique: bool
    start_value: Fraction
    rank: Integers | None = None
    weight: Sequence[int] | None = None

    def __post_init__(self) -> None:
        for array in (self.group, self.policy, self.optimal_pairs, self.rank):
            if array is not None:
                array.setflags(write=False)


@dataclass(frozen=True, kw_only=True, eq=False)
class BoundedClaims:
    """What a bounded certificate claims; see `solvers.proof.certificate.BoundedCertificate`."""

    model: str
    lower: Floats
    upper: Floats
    policy: Integers
    weight: Floats

    def __post_init__(self) -> None:
        for array in (self.lower, self.upper, self.policy, self.weight):
            array.setflags(write=False)
