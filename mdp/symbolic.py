"""A proof that a function builds rows of a known degree: the function run on polynomials.

A builder is called with one parameter θ as a polynomial instead of a number. Sums, products and
quotients of it are rational functions again; what is handed to a constructor of `MDP` shows its
degree. A comparison is answered only where the answer is the same on the whole open piece, by
Descartes' rule of signs, so that the function takes the same way everywhere on it. Whatever asks
for the number itself (a float, a numerator, a hash, a text) ends the proof without an answer, and
so does a builder that returns anything else than the one model it has made. Where the run ends well
the degree holds on the piece; where it does not, nothing is known.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextvars import ContextVar
from dataclasses import dataclass
from fractions import Fraction
from functools import wraps
from itertools import pairwise
from math import comb, inf
from typing import Any, ParamSpec, TypeVar

import numpy as np

Arguments = ParamSpec("Arguments")
Made = TypeVar("Made")
Poly = tuple[Fraction, ...]
"""Coefficients from the constant up, the last one not 0; () is 0."""

ZERO, ONE = Fraction(0), Fraction(1)
HALVINGS = 10  # of a piece on which a sign is looked for


class Unknown(Exception):
    """The run asks for what depends on the value of the parameter."""

    def __init__(self, run: _Run | None = None) -> None:
        super().__init__()
        if run is not None:
            run.broken = True  # even where the builder catches this


@dataclass(frozen=True, kw_only=True)
class Degrees:
    """Degrees of what a builder makes, at most; infinite where it is no polynomial.

    Attributes
    ----------
    transition, reward, joint, square : int or inf
        Of P(s' | s, a), E[r], E[r; next state is s'] and E[r²].
    discount : int or inf
    """

    transition: float
    reward: float
    joint: float
    square: float
    discount: float

    @property
    def rows(self) -> float:
        """Degree of transition rows, expected rewards and the discount together."""
        return max(self.transition, self.reward, self.discount)

    @property
    def moments(self) -> float:
        """Degree of E[r²] and of E[r; next state]."""
        return max(self.square, self.joint)


def degrees_of(
    build: Callable[[Mapping[str, Fraction]], object],
    values: Mapping[str, Fraction],
    name: str,
    piece: tuple[Fraction | None, Fraction | None],
    point: Fraction,
) -> Degrees | None:
    """Return the degrees of what a builder makes of one parameter; None where there is no proof.

    Parameters
    ----------
    build : function
        From {parameter name: number} to a model.
    values : {parameter name: Fraction}
        All parameters; `name` is replaced by a polynomial.
    piece : (low, high)
        The open interval on which degrees hold; None for an open end.
    point : Fraction
        A value on it, at which the model is built for the run.

    Examples
    --------
    >>> from exact_mdp.mdp.model import MDP
    >>> found = degrees_of(
    ...     lambda at: MDP.from_arrays([[[at["p"] ** 2, 1 - at["p"] ** 2], [0, 1]]], [1, 0]),
    ...     {"p": Fraction(1, 2)},
    ...     "p",
    ...     (Fraction(0), Fraction(1)),
    ...     Fraction(1, 3),
    ... )
    >>> found.transition, found.reward
    (2, 0)
    """
    run = _Run(piece=piece, point=point)
    token = _RUN.set(run)
    try:
        model = build({**values, name: Symbolic(run, (ZERO, ONE))})
    except (ArithmeticError, AttributeError, LookupError, TypeError, ValueError, Unknown):
        return None
    finally:
        _RUN.reset(token)
    alone = len(run.made) == 1 and model is run.made[0]
    return run.found[0] if alone and not run.broken else None


class Symbolic(Fraction):
    """A rational function of the parameter. It has no value of its own, and says so if asked."""

    __slots__ = ("bottom", "run", "top")

    run: _Run
    top: Poly
    bottom: Poly

    def __new__(cls, run: _Run, top: Poly, bottom: Poly = (ONE,)) -> Symbolic:
        """Return top / bottom; what `Fraction` keeps in its own slots is left unset on purpose."""
        self = object.__new__(cls)
        self.run, (self.top, self.bottom) = run, _reduced(top, bottom)
        return self

    @property
    def degree(self) -> float:
        """The polynomial's degree, infinite where this is none."""
        return max(len(self.top) - 1, 0) if len(self.bottom) == 1 else inf

    def at(self, point: Fraction) -> Fraction:
        """Return the value at a point."""
        return _at(self.top, point) / _at(self.bottom, point)

    def _other(self, number: object) -> Symbolic | None:
        if isinstance(number, Symbolic):
            return number
        if isinstance(number, np.integer):
            number = int(number)
        if isinstance(number, int | Fraction):
            return Symbolic(self.run, (Fraction(number),))
        if isinstance(number, float | np.floating):
            raise Unknown(self.run)
        return None

    def _with(self, number: object, result: Callable[[Symbolic, Symbolic], Symbolic]) -> Any:
        other = self._other(number)
        return NotImplemented if other is None else result(self, other)

    def __add__(self, number: object) -> Any:
        return self._with(number, _sum)

    __radd__ = __add__

    def __sub__(self, number: object) -> Any:
        return self._with(number, lambda a, b: _sum(a, -b))

    def __rsub__(self, number: object) -> Any:
        return self._with(number, lambda a, b: _sum(b, -a))

    def __mul__(self, number: object) -> Any:
        return self._with(number, _product)

    __rmul__ = __mul__

    def __truediv__(self, number: object) -> Any:
        return self._with(number, lambda a, b: _product(a, _inverse(b)))

    def __rtruediv__(self, number: object) -> Any:
        return self._with(number, lambda a, b: _product(b, _inverse(a)))

    def __pow__(self, power: object, modulus: object = None) -> Any:
        if not isinstance(power, int) or modulus is not None:
            raise Unknown(self.run)
        base = self if power >= 0 else _inverse(self)
        found = Symbolic(self.run, (ONE,))
        for _ in range(abs(power)):
            found = _product(found, base)
        return found

    def __rpow__(self, base: object, modulus: object = None) -> Any:
        raise Unknown(self.run)

    def __neg__(self) -> Symbolic:
        return Symbolic(self.run, tuple(-c for c in self.top), self.bottom)

    def __pos__(self) -> Symbolic:
        return self

    def __abs__(self) -> Symbolic:
        return -self if self._sign() < 0 else self

    def _sign(self) -> int:
        """Return the sign on the whole piece, or raise Unknown."""
        try:
            return _sign(_times(self.top, self.bottom), *self.run.piece)
        except Unknown:
            raise Unknown(self.run) from None

    def _compared(self, number: object) -> int:
        other = self._other(number)
        if other is None:
            raise Unknown(self.run)
        return _sum(self, -other)._sign()

    def __eq__(self, number: object) -> bool:  # and so there is no hash
        return self._compared(number) == 0

    def __lt__(self, number: object) -> bool:
        return self._compared(number) < 0

    def __le__(self, number: object) -> bool:
        return self._compared(number) <= 0

    def __gt__(self, number: object) -> bool:
        return self._compared(number) > 0

    def __ge__(self, number: object) -> bool:
        return self._compared(number) >= 0

    def __bool__(self) -> bool:
        return self._sign() != 0

    def __str__(self) -> str:
        raise Unknown(self.run)

    __repr__ = __str__

    def __format__(self, form: str, /) -> str:
        raise Unknown(self.run)

    def __getattr__(self, name: str) -> Any:
        if name in ("_numerator", "_denominator"):  # every other way to the number ends here
            raise Unknown(self.run)
        raise AttributeError(name)


class _Run:
    """One call of a builder: the piece, and the models that constructors make meanwhile."""

    def __init__(self, *, piece: tuple[Fraction | None, Fraction | None], point: Fraction) -> None:
        self.piece, self.point, self.broken = piece, point, False
        self.made: list[object] = []
        self.found: list[Degrees] = []

    def through(
        self,
        make: Callable[..., Made],
        read: Callable[..., Degrees],
        args: Sequence[Any],
        names: Mapping[str, Any],
    ) -> Made:
        """Note the degrees of a constructor's arguments, and make the model at the run's point."""
        args, names = _listed(args), _listed(names)
        degrees = read(*args, **names)
        token = _RUN.set(None)
        try:
            model = make(*_plain(args, self.point), **_plain(names, self.point))
        finally:
            _RUN.reset(token)
        if any(model is known for known in self.made):
            raise Unknown
        self.made.append(model)
        self.found.append(degrees)
        return model


_RUN: ContextVar[_Run | None] = ContextVar("symbolic run", default=None)


def followed(
    read: Callable[..., Degrees],
) -> Callable[[Callable[Arguments, Made]], Callable[Arguments, Made]]:
    """Return a decorator for constructors, whose arguments' degrees `read` tells."""

    def decorate(make: Callable[Arguments, Made]) -> Callable[Arguments, Made]:
        @wraps(make)
        def made(*args: Arguments.args, **names: Arguments.kwargs) -> Made:
            run = _RUN.get()
            return make(*args, **names) if run is None else run.through(make, read, args, names)

        return made

    return decorate


def arrays_degrees(
    made: object, P: object, R: object, discount: object = 1, **names: object
) -> Degrees:
    """Return the degrees of what `MDP.from_arrays` takes."""
    return _array_degrees(P, R, discount, names, of_outcomes=np.ndim(_objects(R)) == 3)


def pairs_degrees(
    made: object,
    pair_state: object,
    pair_action: object,
    transition: object,
    reward: object,
    discount: object = 1,
    **names: object,
) -> Degrees:
    """Return the degrees of what `MDP.from_pairs` takes."""
    _constant(pair_state, pair_action)
    each = np.ndim(_objects(reward)) == 2
    return _array_degrees(transition, reward, discount, names, of_outcomes=each)


def outcomes_degrees(made: object, rows: Any, discount: object = 1, **names: object) -> Degrees:
    """Return the degrees of what `MDP.from_outcomes` takes."""
    _constant(names)
    found = [(0.0, 0.0)]
    for state, action, outcomes in rows:
        _constant(state, action, [following for _, following, _ in outcomes])
        found += [(_degree(chance), _degree(gain)) for chance, _, gain in outcomes]
    once = max(chance + gain for chance, gain in found)
    return Degrees(
        transition=max(chance for chance, _ in found),
        reward=once,
        joint=once,
        square=max(chance + 2 * gain for chance, gain in found),
        discount=_degree(discount),
    )


def changed_degrees(mdp: object, *, discount: object = None, **parts: object) -> Degrees:
    """Return the degrees of what `MDP.with_` changes of a model that the run has not made."""
    _constant(parts)
    run = _RUN.get()
    if run is not None and run.made:
        raise Unknown
    return Degrees(transition=0, reward=0, joint=0, square=0, discount=_degree(discount))


def _array_degrees(
    chances: object, gains: object, discount: object, names: object, *, of_outcomes: bool
) -> Degrees:
    _constant(names)
    chance, gain = _degree(chances), _degree(gains)
    return Degrees(
        transition=chance,
        reward=chance + gain if of_outcomes else gain,
        joint=chance + gain,
        square=chance + 2 * gain if of_outcomes else 2 * gain,
        discount=_degree(discount),
    )


def _objects(values: object) -> Any:
    return np.asarray(values, dtype=object)


def _parts(value: object) -> Iterator[object]:
    """Yield the numbers in nested lists, tuples, dictionaries and arrays."""
    if isinstance(value, Mapping):
        for key, part in value.items():
            yield from (*_parts(key), *_parts(part))
    elif isinstance(value, list | tuple):
        for part in value:
            yield from _parts(part)
    elif isinstance(value, np.ndarray) and value.dtype == object:
        yield from value.flat
    else:
        yield value


def _degree(value: object) -> float:
    """Return the greatest degree among the numbers in `value`."""
    return max((part.degree for part in _parts(value) if isinstance(part, Symbolic)), default=0)


def _constant(*values: object) -> None:
    """Raise Unknown where something that has no polynomial in this proof depends on θ."""
    if any(isinstance(part, Symbolic) for part in _parts(values)):
        raise Unknown


def _listed(value: Any) -> Any:
    """Return iterators as lists, so that they can be read twice."""
    if isinstance(value, Mapping):
        return {key: _listed(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return (
            [_listed(part) for part in value]
            if isinstance(value, list)
            else tuple(_listed(part) for part in value)
        )
    return [_listed(part) for part in value] if isinstance(value, Iterator) else value


def _plain(value: Any, point: Fraction) -> Any:
    """Return nested numbers with polynomials replaced by their values."""
    if isinstance(value, Symbolic):
        return value.at(point)
    if isinstance(value, Mapping):
        return {_plain(key, point): _plain(part, point) for key, part in value.items()}
    if isinstance(value, list):
        return [_plain(part, point) for part in value]
    if isinstance(value, tuple):
        return tuple(_plain(part, point) for part in value)
    if isinstance(value, np.ndarray) and value.dtype == object:
        flat = np.empty(value.size, dtype=object)
        flat[:] = [_plain(part, point) for part in value.flat]
        return flat.reshape(value.shape)
    return value


# ---- rational functions --------------------------------------------------------------------------


def _sum(a: Symbolic, b: Symbolic) -> Symbolic:
    left, right = _times(a.top, b.bottom), _times(b.top, a.bottom)
    size = max(len(left), len(right))
    padded = [(*poly, *[ZERO] * (size - len(poly))) for poly in (left, right)]
    top = _trimmed([x + y for x, y in zip(*padded, strict=True)])
    return Symbolic(a.run, top, _times(a.bottom, b.bottom))


def _product(a: Symbolic, b: Symbolic) -> Symbolic:
    return Symbolic(a.run, _times(a.top, b.top), _times(a.bottom, b.bottom))


def _inverse(a: Symbolic) -> Symbolic:
    """Return 1 / a where a has one sign on the piece."""
    if a._sign() == 0:
        raise Unknown(a.run)
    return Symbolic(a.run, a.bottom, a.top)


def _trimmed(numbers: Sequence[Fraction]) -> Poly:
    count = len(numbers)
    while count and numbers[count - 1] == 0:
        count -= 1
    return tuple(numbers[:count])


def _times(a: Poly, b: Poly) -> Poly:
    found = [ZERO] * max(len(a) + len(b) - 1, 0)
    for i, x in enumerate(a):
        for j, y in enumerate(b):
            found[i + j] += x * y
    return _trimmed(found)


def _divided(a: Poly, b: Poly) -> tuple[Poly, Poly]:
    """Return quotient and remainder."""
    rest, quotient = list(a), [ZERO] * max(len(a) - len(b) + 1, 0)
    for k in reversed(range(len(quotient))):
        quotient[k] = rest[k + len(b) - 1] / b[-1]
        for j, y in enumerate(b):
            rest[k + j] -= quotient[k] * y
    return _trimmed(quotient), _trimmed(rest)


def _reduced(top: Poly, bottom: Poly) -> tuple[Poly, Poly]:
    """Return a fraction of polynomials without common factors, the last of `bottom` being 1."""
    top, bottom = _trimmed(top), _trimmed(bottom)
    if len(bottom) > 1:
        a, b = top, bottom
        while b:
            a, b = b, _divided(a, b)[1]
        top, bottom = _divided(top, a)[0], _divided(bottom, a)[0]
    scale = bottom[-1]
    if scale == 1:
        return top, bottom
    return tuple(c / scale for c in top), tuple(c / scale for c in bottom)


def _at(poly: Poly, point: Fraction) -> Fraction:
    total = ZERO
    for coefficient in reversed(poly):
        total = total * point + coefficient
    return total


def _sign(poly: Poly, low: Fraction | None, high: Fraction | None, halvings: int = HALVINGS) -> int:
    """Return the sign of a polynomial on an open interval; raise Unknown where it may change."""
    if len(poly) < 2:
        return 0 if not poly else 1 if poly[0] > 0 else -1
    if low is None and high is None:
        raise Unknown
    signs = [c > 0 for c in _moved(poly, low, high) if c]
    if all(a == b for a, b in pairwise(signs)):
        return 1 if signs[0] else -1
    if low is None or high is None or not halvings:
        raise Unknown
    middle = (low + high) / 2
    here = _at(poly, middle)
    sides = {_sign(poly, *ends, halvings - 1) for ends in ((low, middle), (middle, high))}
    if not here or len(sides) > 1:
        raise Unknown
    return sides.pop()


def _moved(poly: Poly, low: Fraction | None, high: Fraction | None) -> list[Fraction]:
    """Return a polynomial in t > 0 that has the signs of `poly` on the interval.

    At θ = (low + high t) / (1 + t), times (1 + t)^n; with an open end at θ = low + t or high - t.
    """
    order = len(poly) - 1
    total = [ZERO] * (order + 1)
    for k, coefficient in enumerate(poly):
        if low is None or high is None:
            base, step = (high, -ONE) if low is None else (low, ONE)
            assert base is not None
            term: Poly = tuple(comb(k, j) * base ** (k - j) * step**j for j in range(k + 1))
        else:
            term = tuple(comb(k, j) * low ** (k - j) * high**j for j in range(k + 1))
            term = _times(term, tuple(Fraction(comb(order - k, j)) for j in range(order - k + 1)))
        for j, number in enumerate(term):
            total[j] += coefficient * number
    return total
