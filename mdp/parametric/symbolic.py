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
from fractions import Fraction
from functools import wraps
from math import inf
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar

import numpy as np

from exact_mdp.mdp.lazy import later

if TYPE_CHECKING:
    from flint import fmpq, fmpq_poly

flint = later("flint")

Arguments = ParamSpec("Arguments")
Made = TypeVar("Made")
Piece = tuple[Fraction | None, Fraction | None]
"""An open interval; None for an open end."""

HALVINGS = 10  # of a piece on which a sign is looked for


class Unknown(Exception):
    """The run asks for what depends on the value of the parameter."""

    def __init__(self, run: _Run | None = None) -> None:
        super().__init__()
        if run is not None:
            run.broken = True  # even where the builder catches this


def degree_of(
    build: Callable[[Mapping[str, Fraction]], object],
    values: Mapping[str, Fraction],
    name: str,
    piece: Piece,
    point: Fraction,
) -> float | None:
    """Return the degree of what a builder makes of one parameter; None where there is no proof.

    That is the greatest one of transition probabilities, expected rewards and the discount, and
    infinite where one is not a polynomial. The builder makes a model of all `values`, of which
    that of `name` is replaced by a polynomial. The degree holds on the piece; `point` is a value on
    it, at which the model is built for the run.

    Examples
    --------
    >>> from exact_mdp.mdp.model import MDP
    >>> degree_of(
    ...     lambda at: MDP.from_arrays([[[at["p"] ** 2, 1 - at["p"] ** 2], [0, 1]]], [1, 0]),
    ...     {"p": Fraction(1, 2)},
    ...     "p",
    ...     (Fraction(0), Fraction(1)),
    ...     Fraction(1, 3),
    ... )
    2
    """
    run = _Run(piece=piece, point=point)
    token = _RUN.set(run)
    try:
        model = build({**values, name: Symbolic(run, flint.fmpq_poly([0, 1]))})
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
    top: fmpq_poly
    bottom: fmpq_poly

    def __new__(cls, run: _Run, top: fmpq_poly, bottom: fmpq_poly | None = None) -> Symbolic:
        """Return top / bottom; what `Fraction` keeps in its own slots is left unset on purpose."""
        self = object.__new__(cls)
        if bottom is None:
            bottom = flint.fmpq_poly([1])
        elif bottom.degree() > 0:
            shared = top.gcd(bottom)
            top, bottom = top // shared, bottom // shared
        scale = 1 / bottom[bottom.degree()]
        self.run, self.top, self.bottom = run, top * scale, bottom * scale
        return self

    @property
    def degree(self) -> float:
        """The polynomial's degree, infinite where this is none."""
        return max(self.top.degree(), 0) if self.bottom.degree() == 0 else inf

    def at(self, point: Fraction) -> Fraction:
        """Return the value at a point."""
        return fraction(self.top(rational(point)) / self.bottom(rational(point)))

    def _other(self, number: object) -> Symbolic | None:
        if isinstance(number, Symbolic):
            return number
        if isinstance(number, int | Fraction | np.integer):
            constant = number if isinstance(number, Fraction) else Fraction(int(number))
            return Symbolic(self.run, flint.fmpq_poly([rational(constant)]))
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
        return Symbolic(self.run, base.top ** abs(power), base.bottom ** abs(power))

    def __rpow__(self, base: object, modulus: object = None) -> Any:
        raise Unknown(self.run)

    def __neg__(self) -> Symbolic:
        return Symbolic(self.run, -self.top, self.bottom)

    def __pos__(self) -> Symbolic:
        return self

    def __abs__(self) -> Symbolic:
        return -self if self._sign() < 0 else self

    def _sign(self) -> int:
        """Return the sign on the whole piece, or raise Unknown."""
        try:
            return _sign(self.top * self.bottom, *self.run.piece)
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


def rational(number: Fraction | int) -> fmpq:
    """Return a number as FLINT's rational."""
    found: fmpq = flint.fmpq(number.numerator, number.denominator)
    return found


def fraction(number: fmpq) -> Fraction:
    """Return FLINT's rational as Python's."""
    return Fraction(int(number.p), int(number.q))


def _sum(a: Symbolic, b: Symbolic) -> Symbolic:
    return Symbolic(a.run, a.top * b.bottom + b.top * a.bottom, a.bottom * b.bottom)


def _product(a: Symbolic, b: Symbolic) -> Symbolic:
    return Symbolic(a.run, a.top * b.top, a.bottom * b.bottom)


def _inverse(a: Symbolic) -> Symbolic:
    """Return 1 / a where a has one sign on the piece."""
    if a._sign() == 0:
        raise Unknown(a.run)
    return Symbolic(a.run, a.bottom, a.top)


def _sign(
    poly: fmpq_poly, low: Fraction | None, high: Fraction | None, halvings: int = HALVINGS
) -> int:
    """Return the sign of a polynomial on an open interval; raise Unknown where it may change.

    By Descartes' rule there is no root where the coefficients of a polynomial in t > 0, which has
    the same signs, have one sign. That is `poly` at θ = (low + high t) / (1 + t), times (1 + t)^n;
    with an open end, at θ = low + t or high - t.
    """
    order = poly.degree()
    if order < 1:
        return (poly[0] > 0) - (poly[0] < 0)
    if low is None and high is None:
        raise Unknown
    end = low if high is None else high if low is None else high - low
    assert end is not None
    t = flint.fmpq_poly([0, 1])
    if low is None or high is None:
        moved = poly(rational(end) + (t if high is None else -t))
    else:
        inner = poly(rational(low) + rational(end) * t)  # θ = low + end · t / (1 + t)
        moved = sum(
            (c * t**k * (1 + t) ** (order - k) for k, c in enumerate(inner.coeffs())), 0 * t
        )
    signs = {c > 0 for c in moved.coeffs() if c}
    if len(signs) == 1:
        return 1 if signs.pop() else -1
    if low is None or high is None or not halvings:
        raise Unknown
    middle = (low + high) / 2
    sides = {_sign(poly, *ends, halvings - 1) for ends in ((low, middle), (middle, high))}
    if not poly(rational(middle)) or len(sides) > 1:
        raise Unknown
    return sides.pop()


# ---- the run -------------------------------------------------------------------------------------


class _Run:
    """One call of a builder: the piece, and the models that constructors make meanwhile."""

    def __init__(self, *, piece: Piece, point: Fraction) -> None:
        self.piece, self.point, self.broken = piece, point, False
        self.made: list[object] = []
        self.found: list[float] = []

    def through(
        self,
        make: Callable[..., Made],
        read: Callable[..., float],
        args: Sequence[Any],
        names: Mapping[str, Any],
    ) -> Made:
        """Note the degree of a constructor's arguments, and make the model at the run's point."""
        # Iterators become lists, so that they can be read twice.
        args, names = _each(args, lambda part: part), _each(names, lambda part: part)
        degree = read(*args, **names)
        token = _RUN.set(None)
        try:
            model = make(*_each(args, self._plain), **_each(names, self._plain))
        finally:
            _RUN.reset(token)
        if any(model is known for known in self.made):
            raise Unknown
        self.made.append(model)
        self.found.append(degree)
        return model

    def _plain(self, value: Any) -> Any:
        return value.at(self.point) if isinstance(value, Symbolic) else value


_RUN: ContextVar[_Run | None] = ContextVar("symbolic run", default=None)


def followed(
    read: Callable[..., float],
) -> Callable[[Callable[Arguments, Made]], Callable[Arguments, Made]]:
    """Return a decorator for constructors, whose arguments' degree `read` gives."""

    def decorate(make: Callable[Arguments, Made]) -> Callable[Arguments, Made]:
        @wraps(make)
        def made(*args: Arguments.args, **names: Arguments.kwargs) -> Made:
            run = _RUN.get()
            return make(*args, **names) if run is None else run.through(make, read, args, names)

        return made

    return decorate


def arrays_degree(
    made: object, P: object, R: object, discount: object = 1, **names: object
) -> float:
    """Return the degree of what `MDP.from_arrays` takes."""
    chance = _degree(P)
    earned = _earned(R, chance, joint=3)
    return max(chance, earned, _degree(discount), _components(names, chance, joint=3))


def pairs_degree(
    made: object,
    pair_state: object,
    pair_action: object,
    transition: object,
    reward: object,
    discount: object = 1,
    **names: object,
) -> float:
    """Return the degree of what `MDP.from_pairs` takes."""
    _constant(pair_state, pair_action)
    chance = _degree(transition)
    earned = _earned(reward, chance, joint=2)
    return max(chance, earned, _degree(discount), _components(names, chance, joint=2))


def outcomes_degree(made: object, rows: Any, discount: object = 1, **names: object) -> float:
    """Return the degree of what `MDP.from_outcomes` takes."""
    found = [_degree(discount), _components(names, 0, joint=2)]
    for state, action, outcomes in rows:
        _constant(state, action, [following for _, following, _ in outcomes])
        found += [_degree(chance) + _degree(gain) for chance, _, gain in outcomes]
    return max(found)


def _earned(reward: object, chance: float, *, joint: int) -> float:
    """Return the degree of expected rewards; an array of `joint` dimensions is of transitions."""
    return _degree(reward) + (chance if np.ndim(_objects(reward)) == joint else 0)


def _components(names: dict[str, object], chance: float, *, joint: int) -> float:
    """Return the degree of the components of the reward; nothing else by name may depend on θ."""
    given = names.pop("components", None)
    _constant(names)
    parts = given.values() if isinstance(given, Mapping) else [given]
    return max((_earned(part, chance, joint=joint) for part in parts), default=0)


def changed_degree(mdp: object, *, discount: object = None, **parts: object) -> float:
    """Return the degree of what `MDP.with_` changes of a model that the run has not made."""
    _constant(parts)
    run = _RUN.get()
    if run is not None and run.made:
        raise Unknown
    return _degree(discount)


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


def _each(value: Any, change: Callable[[Any], Any]) -> Any:
    """Return nested numbers with each one changed."""
    if isinstance(value, Mapping):
        return {_each(key, change): _each(part, change) for key, part in value.items()}
    if isinstance(value, list | Iterator):
        return [_each(part, change) for part in value]
    if isinstance(value, tuple):
        return tuple(_each(part, change) for part in value)
    if isinstance(value, np.ndarray) and value.dtype == object:
        flat = np.empty(value.size, dtype=object)
        flat[:] = [_each(part, change) for part in value.flat]
        return flat.reshape(value.shape)
    return change(value)
