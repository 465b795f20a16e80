"""The loops of the operator form of the care model.

See `mdp.care.operator` for the form and `solvers.dynamic.operator` for the algorithm.
"""

from __future__ import annotations

from exact_mdp.mdp.table import Floats, Numbers
from exact_mdp.solvers.kernels.compiling import compiled, inlined


@inlined
def fold(x: Floats, y: Floats, chance: float, blocks: int, width: int) -> None:
    """Write into y what is left of x when one binary digit, worth `width`, is summed out."""
    if width == 1:
        for h in range(blocks):
            y[h] = x[2 * h] + chance * (x[2 * h + 1] - x[2 * h])
        return
    for h in range(blocks):
        begin = 2 * h * width
        for j in range(width):
            low = x[begin + j]
            y[h * width + j] = low + chance * (x[begin + width + j] - low)


@compiled
def expect(
    chance: Floats,
    ready: Numbers,
    x: Floats,
    found: Floats,
    even: Floats,
    odd: Floats,
    kept: Numbers,
    places: Numbers,
) -> None:
    """Write the expectations of x (2^n,) from every present vector into `found` (2^n,).

    Parameters
    ----------
    chance, ready : (2^n, n), (n, 2)
        Of one rule; see `mdp.care.operator.Law`.
    even, odd : (n, 2^(n-1))
        Room for what is folded at each depth.
    kept, places : (n+1, n+1), (n+1, 5) ints
        Room for what is kept at each depth, and where its vector lies.
    """
    count = chance.shape[1]
    # Columns of places: which array and which row hold the vector, its length, digits kept, state.
    places[0, 0], places[0, 1], places[0, 2], places[0, 3], places[0, 4] = 0, 0, len(x), 0, 0
    for number in range(len(x)):
        again, rest = 0, number
        if number > 0:
            again = count - 1
            while rest & 1 == 0:
                rest >>= 1
                again -= 1
        for depth in range(again, count):
            array, row = places[depth, 0], places[depth, 1]
            length, left, here = places[depth, 2], places[depth, 3], places[depth, 4]
            here |= ((number >> (count - 1 - depth)) & 1) << depth
            after = kept[depth + 1]
            for k in range(left):
                after[k] = kept[depth, k]
            after[left] = depth
            left += 1
            for place in range(left - 1, -1, -1):
                decided = after[place]
                i = count - 1 - decided
                if ready[i, (here >> decided) & 1] > depth:
                    continue
                width = 1 << place
                length //= 2
                if array == 0:
                    fold(x, even[depth], chance[here, i], length // width, width)
                elif array == 1:
                    fold(even[row], odd[depth], chance[here, i], length // width, width)
                else:
                    fold(odd[row], even[depth], chance[here, i], length // width, width)
                array, row = 2 if array == 1 else 1, depth
                left -= 1
                for k in range(place, left):
                    after[k] = after[k + 1]
            places[depth + 1, 0], places[depth + 1, 1] = array, row
            places[depth + 1, 2], places[depth + 1, 3] = length, left
            places[depth + 1, 4] = here
        array, row = places[count, 0], places[count, 1]
        found[places[count, 4]] = even[row, 0] if array == 1 else odd[row, 0]


@inlined
def apply(dense: Floats, x: Floats, base: float, total: Floats) -> None:
    """Write Σ_s' dense[s'] (x[s'] - base) into `total`, in the order of s'."""
    for j in range(len(total)):
        total[j] = 0.0
    for following in range(len(x)):
        worth = x[following] - base
        for j in range(len(total)):
            total[j] += dense[following, j] * worth


@compiled
def induce(
    dense: Floats,
    dense_skip: Floats,
    const: Floats,
    fail: Floats,
    complete: Floats,
    skipped: Floats,
    alone: Floats,
    places: Numbers,
    kept: Numbers,
    trials: int,
    flags: int,
    own: bool,
    discount: float,
    units: Floats,
    value: Floats,
    chosen: Numbers,
    above: Floats,
    below: Floats,
    room: Floats,
    wide: Floats,
) -> None:
    """Do what `solvers.dynamic.operator.induce` does for a model whose law is a small matrix.

    Parameters
    ----------
    places, kept : (K,), (3, 2) ints
        As in `mdp.care.rules.Rules`; what else is earned, as in `mdp.care.operator.CareOperator`.
    units : (6,)
        Unit of roundoff, largest reward, its factor in a layer, errors of the step and of the skip,
        factor of the size of values.
    chosen : (S,) ints
        Filled with actions.
    above, below : (K, layers)
        Filled with rounding errors, trials from the first to the last, then the skip.
    room, wide : (3, 2^n), (2, A · 2^n)
        Room to work in, the last row of `room` with zeros.
    """
    vectors = len(fail)
    actions = len(const) // vectors
    x, y, zero, total, q = room[0], room[1], room[2], wide[0], wide[1]
    size = (trials + (1 if own else 0)) * flags * vectors
    unit, largest, fixed = units[0], units[1], units[2]
    step_error, skip_error, factor = units[3], units[4], units[5]
    for number in range(len(places) - 1, -1, -1):
        place = places[number]
        begin = (number + 1) * size
        flagged = begin + kept[place, 1] * vectors
        behind = value[flagged : flagged + vectors] if place < 2 else zero
        clear = value[begin + kept[place, 0] * vectors] if place < 2 else 0.0
        base = behind[0]
        apply(dense_skip, behind, base, y)
        spread, magnitude = 0.0, abs(clear)
        for v in range(vectors):
            spread = max(spread, abs(behind[v] - base))
            magnitude = max(magnitude, abs(behind[v]))
        if own:
            doubt = (skip_error + 1.0) * spread + factor * (largest + discount * magnitude)
            doubt = unit * (doubt + fixed)
            above[number, trials], below[number, trials] = doubt, doubt
            for flag in range(flags):
                first = number * size + (trials * flags + flag) * vectors
                for v in range(vectors):
                    law = base + y[v]
                    value[first + v] = (alone[v] + skipped[place]) + discount * law
                    chosen[first + v] = actions
        for trial in range(trials - 1, -1, -1):
            for flag in range(flags):
                ends = trial + 1 == trials and not own
                seen = magnitude
                if ends:
                    for v in range(vectors):
                        x[v] = fail[v] + (skipped[place] + discount * (base + y[v]))
                else:
                    first = number * size + ((trial + 1) * flags + flag) * vectors
                    for v in range(vectors):
                        x[v] = fail[v] + discount * value[first + v]
                        seen = max(seen, abs(value[first + v]))
                earlier = base if flag == 1 else clear
                x[0] = complete[place, flag] + discount * earlier
                origin, width = x[0], 0.0
                for v in range(vectors):
                    width = max(width, abs(x[v] - origin))
                apply(dense, x, origin, total)
                doubt = (step_error + 1.0) * width + (skip_error * spread if ends else 0.0)
                doubt += (2 * factor if ends else factor) * (largest + discount * seen)
                doubt = unit * (doubt + fixed)
                first = number * size + (trial * flags + flag) * vectors
                for j in range(len(q)):
                    q[j] = const[j] + (origin + total[j])
                short = doubt
                for v in range(vectors):
                    best = q[v]
                    for a in range(1, actions):
                        best = max(best, q[a * vectors + v])
                    slack = 2 * doubt + 16 * unit * abs(best)
                    taken = 0
                    while q[taken * vectors + v] + slack < best - slack:
                        taken += 1
                    value[first + v], chosen[first + v] = best, taken
                    short = max(short, doubt + (best - q[taken * vectors + v]))
                above[number, trial] = max(above[number, trial], doubt)
                below[number, trial] = max(below[number, trial], short)
