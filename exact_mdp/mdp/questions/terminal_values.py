"""The values of states when a horizon is reached: amounts that the last step earns.

    r'(l, s') = r(l, s') + γ v(s')    at time N - 1

In a model with components they are a component of their own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction

import numpy as np

from exact_mdp.mdp.components import cancel_common_divisor, with_components
from exact_mdp.mdp.errors import ModelError, locate_errors
from exact_mdp.mdp.forms.names import find_free_name
from exact_mdp.mdp.space import StateSpace
from exact_mdp.mdp.table import OutcomeTable, exact, multiply, over_groups, to_integer_array
from exact_mdp.mdp.validate import Flags, numbers_by_state

TERMINAL_VALUE = "terminal value"


def read_terminal_values(numbers: object, space: StateSpace) -> list[Fraction]:
    """Return one number for each state, from a vector or {state: number} (0 for the others)."""
    if numbers is None:
        return [Fraction(0)] * space.size
    if isinstance(numbers, tuple):  # a tuple could also be read as a state
        numbers = list(numbers)
    with locate_errors("terminal_value"):
        values = numbers_by_state(numbers, space)
        if values is None:
            raise ModelError(
                f"a {type(numbers).__name__} does not give a value for each state",
                fix="give one number for each state, or {state: number}",
            )
        return [exact(values.get(state, 0)) for state in range(space.size)]


def require_unpaid(values: Sequence[Fraction], goal: Flags, space: StateSpace) -> None:
    """Raise ModelError if a state of the goal has a terminal value."""
    for state in np.flatnonzero(goal).tolist():
        if values[state]:
            raise ModelError(
                "a run that has reached the goal is over, and earns no terminal value at the "
                "horizon",
                where=f"terminal_value, {space.place(state)}",
                fix="leave the states of the goal out of terminal_value, and reward an arrival in "
                "the step that arrives",
            )


def add_terminal_values(
    table: OutcomeTable, first: int, earned: Sequence[Fraction], names: tuple[str, ...]
) -> tuple[tuple[str, ...], OutcomeTable]:
    """Return component names and table after the pairs from `first` on earn amounts by outcome."""
    # The amounts (N,) over denominators (L,): 0 in all other pairs.
    begin = int(table.offsets[first])
    here = slice(begin, begin + len(earned))
    pairs = slice(first, int(table.pair[here][-1]) + 1)
    top, bottom = over_groups(earned, table.offsets[first : pairs.stop + 1] - begin)
    more = np.zeros(len(table.next), dtype=top.dtype)
    under = np.ones(table.pairs, dtype=bottom.dtype)
    more[here], under[pairs] = top, bottom
    # Exact rewards by outcome: two outcomes of a pair may now earn different amounts.
    gain, below = table.integer_gains
    if len(gain) == table.pairs:
        gain = gain[table.pair]
    # Both sums over the product of their denominators, then in lowest terms.
    own = multiply(gain, under[table.pair], terms=2)
    gain = own + multiply(more, below[table.pair], terms=2)
    gain, below = cancel_common_divisor(gain, multiply(below, under), table)
    paid = table.with_reward(to_integer_array(gain.tolist()), to_integer_array(below.tolist()))
    if table.components is not None:
        # The terminal value becomes a component of its own, under a name that is still free.
        if table.parted_by_outcome:
            amounts, bottoms = table.components, table.component_denominator
        else:
            amounts, bottoms = table.expected_components_exact()
        names = (*names, find_free_name(TERMINAL_VALUE, names))
        columns = [(column, bottoms) for column in amounts.T]
        paid = with_components(paid, [*columns, (more, under)])
    return names, replace(paid, averaged=table.averaged)
