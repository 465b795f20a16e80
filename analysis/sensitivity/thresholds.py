"""Every value of a parameter at which an optimal action changes.

Within a piece of the parameter's range a policy stays optimal up to a root of one of its gap
polynomials (`analysis.sensitivity.gaps`); `analysis.sensitivity.sweep` walks from root to root and
solves the model exactly on both sides of each. How far the nearest one is, is told in
`analysis.sensitivity.threshold_result`.
"""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np

from analysis.proven_optimum import proven
from analysis.sensitivity.gaps import Rows
from analysis.sensitivity.ranges import Range, admitted, around, checked
from analysis.sensitivity.sweep import Stretch, Sweep
from analysis.sensitivity.threshold_result import Switch, Threshold, Thresholds
from mdp.chain import reachable
from mdp.model import MDP
from mdp.parametric import Parametric, parameter_of, parametric
from mdp.row_change import Piece, row_change
from mdp.scenario import Scenario


def thresholds(
    source: Scenario | MDP | Parametric,
    name: str,
    bounds: Range | tuple[object, object] | None = None,
) -> Thresholds:
    """Return every threshold of a parameter, the others held.

    Parameters
    ----------
    source : Scenario, MDP or Parametric
    name : str
    bounds : (low, high), optional
        Within today's value ± 20 % unless given, and within what the model admits
        (`analysis.sensitivity.ranges.admitted`).

    Returns
    -------
    Thresholds
        Those inside the range, touches included; its own ends are not looked at. They are certified
        where the degree of the rows is proven; where that of a `mdp.parametric.Family` is only
        checked at some points they say so.

    Raises
    ------
    ModelError
        For an unknown name, an empty range, a model with cycles that is too large, or rows that are
        no polynomials of the degree that a family states.

    Examples
    --------
    >>> rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    >>> found = thresholds(MDP.from_outcomes(rows, "1/2"), "discount", ("1/10", "99/100"))
    >>> [threshold.value for threshold in found.found]  # 10/11: Puterman (1994), section 3.1
    [0.90909090909...]
    """
    model = parametric(source)
    parameter = parameter_of(model, name)
    if bounds is None:
        span = admitted(model, parameter, around(parameter))
    else:
        span = checked(model, {name: bounds})[name]
    found: list[Threshold] = []
    stretches: list[Stretch] = []
    mdp = model.at({})
    checked_at: int | None = None
    for low, high in _parts(model, name, span):
        middle = (low + high) / 2
        base = model.at({name: middle})
        change = row_change(model, name, Piece(low=low, high=high), origin=middle, base=base)
        if change.checked is not None:
            checked_at = change.checked
        sweep = Sweep(Rows(base, change), lambda value: model.at({name: value}), low, high)
        stretches += list(sweep)
    for left, right in pairwise(stretches):
        switches = _switches(mdp, left, right)
        low, high = left.after[0], max(left.after[1], right.before[1])
        if switches:
            found.append(Threshold(low=low, high=high, switches=switches))
        if low == high:  # a breakpoint: rows have a kink there, and so may a gap that is 0 there
            found += _ties(mdp, model.at({name: low}), left, right, low)
    for each in stretches:
        found += [_touch(mdp, each, *touch) for touch in each.touches]
    found.sort(key=lambda threshold: threshold.low)
    return Thresholds(parameter=parameter, range=span, found=tuple(found), checked=checked_at)


def _parts(model: Parametric, name: str, span: Range) -> list[tuple[Fraction, Fraction]]:
    """Return the range cut at its breakpoints; nothing where it is a single point."""
    inside = [cut for cut in model.breakpoints(name) if span.low < cut < span.high]
    ends = sorted({span.low, *inside, span.high})
    return list(pairwise(ends))


def _switches(mdp: MDP, left: Stretch, right: Stretch) -> tuple[Switch, ...]:
    moved = np.flatnonzero(left.optimal != right.optimal)
    if not len(moved):
        return ()
    seen = reachable(mdp, pairs=left.optimal) | reachable(mdp, pairs=right.optimal)
    return tuple(
        _switch(mdp, state, left.optimal, right.optimal, bool(seen[state]))
        for state in np.unique(mdp.pair_state[moved]).tolist()
    )


def _switch(mdp: MDP, state: int, before: np.ndarray, after: np.ndarray, reached: bool) -> Switch:
    def actions(optimal: np.ndarray) -> tuple[str, ...]:
        taken = [pair for pair in mdp.pairs_of(state) if optimal[pair]]
        return tuple(mdp.actions[mdp.pair_action[pair]] for pair in taken)

    return Switch(
        state=state,
        label=mdp.space.label(state),
        columns=dict(mdp.space.as_dict(state)),
        before=actions(before),
        after=actions(after),
        reached=reached,
    )


def _ties(mdp: MDP, there: MDP, left: Stretch, right: Stretch, value: Fraction) -> list[Threshold]:
    """Return the touch at a breakpoint: what is as good there and on neither side of it."""
    tied = proven(there).optimal_pairs & ~left.optimal & ~right.optimal
    tied &= ~mdp.terminal[mdp.pair_state]
    if not tied.any():
        return []
    more = left.optimal | tied
    seen = reachable(mdp, pairs=left.optimal) | reachable(mdp, pairs=right.optimal)
    switches = tuple(
        _switch(mdp, state, left.optimal, more, bool(seen[state]))
        for state in np.unique(mdp.pair_state[tied]).tolist()
    )
    return [Threshold(low=value, high=value, switches=switches, touch=True)]


def _touch(mdp: MDP, stretch: Stretch, low: Fraction, high: Fraction, pair: int) -> Threshold:
    more = stretch.optimal.copy()
    more[pair] = True
    state = int(mdp.pair_state[pair])
    seen = bool(reachable(mdp, pairs=stretch.optimal)[state])
    return Threshold(
        low=low,
        high=high,
        switches=(_switch(mdp, state, stretch.optimal, more, seen),),
        touch=True,
    )
