"""How the loops are compiled, and what most of them are given."""

from __future__ import annotations

from typing import NamedTuple

from exact_mdp.mdp.forms.compiling import at, compiled, inlined, span
from exact_mdp.mdp.table import Floats, Numbers

__all__ = ["Rows", "at", "compiled", "inlined", "span"]


class Rows(NamedTuple):
    """The rows of a sparse matrix: row r has the entries indptr[r] … indptr[r+1]-1."""

    indptr: Numbers
    indices: Numbers
    data: Floats
