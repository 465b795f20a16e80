"""How near a run has come, and how near to come to a policy's values: numbers in, numbers out.

Runs in Python and the compiled run (`solvers.kernels.rounds`) ask the same functions, so that both
stop at the same pass. All errors here are half the gap between two bounds, in units of value.
"""

from __future__ import annotations

PATIENCE, SHORT = 20, 5
LONG, PART = 200, 0.9
TINY = 2.0**-1000
# Of what is left, by passes without progress.
PARTS: tuple[float, ...] = (1.0, 1.0, 1.0, 1.0, 1.0, 1e-1, 1e-2, 1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
PARTS += (1e-8, 1e-9, 1e-10, 1e-11, 1e-12)


def advanced(
    low: float,
    high: float,
    floor: float,
    weight: float,
    tol: float,
    best: float,
    idle: int,
    mark: float,
    since: int,
    patience: float,
) -> tuple[float, float, int, float, int, bool]:
    """Return the error, the least one so far, passes since it fell, and whether rounding stops it.

    `low`, `high` and `floor` are of a pass, `weight` is the greatest weight, `tol` is 0 for none.
    Where policies are evaluated as closely as the tolerance asks for anyway, patience is short.
    Before the last come the error at which a `mark` was set, each a tenth below the one before, and
    the passes `since` then: rounding alone may make the error fall by next to nothing again and
    again.
    """
    half = (high - low) / 2 * weight
    idle = 0 if half < best else idle + 1
    best = min(best, half)
    mark, since = (half, 0) if half < PART * mark else (mark, since + 1)
    closely = half / 10 * PARTS[SHORT] <= tol / 2
    quiet = half == 0 or idle >= (SHORT if closely else PATIENCE) or since >= patience
    return half, best, idle, mark, since, bool(quiet and half <= 4 * floor * weight)


def patience(states: int, price: float, work: float) -> float:
    """Return how many passes may bring nothing where policies are evaluated.

    News from afar may take as many as there are states, there and back; and an evaluation, of some
    `price`, comes after passes whose `work` is as much.
    """
    return (LONG + 2 * states) * max(1.0, price / work)


def middle(
    low: float, high: float, bottom: float, top: float, least: float, most: float
) -> tuple[float, float, float]:
    """Return the shift to move to, between those of a pass, and bounds of all values.

    The least and the greatest of h are `bottom` and `top`. Where a state's news has yet to come,
    the middle may be as much as 1 / (1 - γ) beyond any value that there can be, and rows whose
    floats sum to more than those of others would seem to be better for it.
    """
    least, most = max(least, bottom + low), min(most, top + high)
    return max(min((low + high) / 2, most - bottom), least - top), least, most


def goal(best: float, idle: int, weight: float, tol: float) -> float:
    """Return how close to come to a policy's values, in units of w: a tenth of the least error yet.

    That of one pass may be far more: a value that news has reached before its neighbours', by what
    makes no difference, counts 1 / (1 - γ) times there. One state far behind makes errors as large
    as all values; where bounds have not fallen for some passes, the goal is less each time. The
    tolerance, 0 for none, may ask for no less than its own.
    """
    part = PARTS[min(idle, 16)]
    enough = tol / (2 * weight) if weight != 0 else 0.0
    return max(best / max(weight, TINY) / 10 * part, enough)
