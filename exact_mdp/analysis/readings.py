"""Which readings of a text does the evidence support? Weights, Bayes factors, equivalences.

A text that can be read in several ways is a finite set of models: the product of the options of
each reading. With a uniform prior over that product and a likelihood L(r) of what was reported,

    weight(r)           = L(r) / Σ L
    weight(option o)    = Σ of the weights of the readings that choose o
    B(o, o')            = mean of L over readings with o / mean of L over readings with o'

so that B compares two options with all others averaged out. The words follow Kass and Raftery
(Bayes factors, JASA 90, 1995): B up to 3 is not worth more than a mention, from 20 on it is strong,
from 150 on very strong. The effective number of readings is exp of the entropy of the weights
(Hill, Diversity and evenness, Ecology 54, 1973).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from math import prod

import numpy as np
from scipy import special

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.table import Floats, Integers

FAVOURED, IDENTIFIED, EXCLUDED = 3.0, 20.0, 150.0  # Bayes factors


@dataclass(frozen=True, kw_only=True)
class ReadingSpace:
    """Every combination of the options of some readings; the last reading moves fastest.

    Attributes
    ----------
    options : mapping
        Options of each reading by its name (any name that `Scenario.with_` takes), the default
        first.

    Examples
    --------
    >>> space = ReadingSpace(options={"status_cost": ("next", "current"), "tasks": ((3,), (6,))})
    >>> len(space), space.settings(3)
    (4, {'status_cost': 'current', 'tasks': (6,)})
    >>> space.label(0), space.label(1)
    ('default', 'tasks [6]')
    """

    options: Mapping[str, tuple[object, ...]]

    def __post_init__(self) -> None:
        for name, values in self.options.items():
            if not values:
                raise ModelError(f"reading {name} has no option", where="readings", fix="give one")
        object.__setattr__(self, "options", dict(self.options))

    def __len__(self) -> int:
        return prod(self._sizes)

    @property
    def _sizes(self) -> list[int]:
        return [len(values) for values in self.options.values()]

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the readings."""
        return tuple(self.options)

    @property
    def codes(self) -> Integers:
        """(R, F) which option of each reading every combination chooses."""
        return np.stack(np.unravel_index(np.arange(len(self)), self._sizes), axis=1)

    def settings(self, number: int) -> dict[str, object]:
        """Return the options of one combination by name."""
        if not 0 <= number < len(self):
            raise ModelError(
                f"there is no reading {number}", where="readings", fix=f"give 0 to {len(self) - 1}"
            )
        pairs = zip(self.options.items(), np.unravel_index(number, self._sizes), strict=True)
        return {name: values[int(place)] for (name, values), place in pairs}

    def number(self, **settings: object) -> int:
        """Return the combination with these options; the first option where none is given."""
        place = dict.fromkeys(self.options, 0)
        for name, option in settings.items():
            if name not in self.options or option not in self.options[name]:
                raise ModelError(
                    f"no option {option!r} of {name!r}", where="readings", fix="see `options`"
                )
            place[name] = self.options[name].index(option)
        return int(np.ravel_multi_index(list(place.values()), self._sizes))

    def label(self, number: int) -> str:
        """Return what one combination changes from the default, in words."""
        changed = [
            f"{name.replace('_', ' ')} {option_label(option)}"
            for name, option in self.settings(number).items()
            if option != self.options[name][0]
        ]
        return ", ".join(changed) or "default"

    def apply(self, scenario: Scenario, number: int) -> Scenario:
        """Return the scenario under one combination."""
        return scenario.with_(
            parameters={
                name if name == "evaluation_discount" else f"readings.{name}": option
                for name, option in self.settings(number).items()
            }
        )


def option_label(option: object) -> str:
    """Return an option as it is printed."""
    return str(list(option)) if isinstance(option, tuple) else str(option)


def posterior(log_likelihood: Floats) -> Floats:
    """Return weights from log likelihoods under a uniform prior."""
    shifted = np.exp(log_likelihood - np.max(log_likelihood))
    return np.asarray(shifted / shifted.sum())


def effective_number(weights: Floats) -> float:
    """Return how many equally supported readings would have the entropy of these weights."""
    used = weights[weights > 0]
    return float(np.exp(-(used * np.log(used)).sum()))


def credible(weights: Floats, share: float) -> Integers:
    """Return the fewest readings that hold `share` of the weight, the best supported first."""
    order = np.argsort(-weights, kind="stable")
    total = np.cumsum(weights[order])
    return order[: int(np.searchsorted(total, share * (1 - 1e-12))) + 1]


@dataclass(frozen=True, kw_only=True)
class OptionSupport:
    """What the evidence says of one option, the others averaged out.

    Attributes
    ----------
    weight : float
        Posterior weight; the prior one is 1 over the number of options.
    log10_against : float
        log₁₀ of the Bayes factor of the reading's best option against this one; 0 for the best.
    verdict : str
        Of the best option: identified (every other has at least 20 against it), favoured (3), or
        not identified. Of another one: excluded (150 against it), disfavoured (20), less likely
        (3), or open.
    """

    reading: str
    option: object
    weight: float
    log10_against: float
    verdict: str


def support(space: ReadingSpace, log_likelihood: Floats) -> list[OptionSupport]:
    """Return the support of every option of every reading."""
    codes, found = space.codes, []
    whole = float(special.logsumexp(log_likelihood))
    for column, (name, options) in enumerate(space.options.items()):
        logs = np.array(
            [
                special.logsumexp(log_likelihood[codes[:, column] == number])
                for number in range(len(options))
            ]
        )
        against = (logs.max() - logs) / np.log(10)
        best = int(np.argmin(against))
        nearest = 10 ** min(float(np.delete(against, best).min(initial=np.inf)), 300.0)
        for number, option in enumerate(options):
            factor = nearest if number == best else 10 ** min(float(against[number]), 300.0)
            found.append(
                OptionSupport(
                    reading=name,
                    option=option,
                    weight=float(np.exp(logs[number] - whole)),
                    log10_against=float(against[number]),
                    verdict=_verdict(factor, best=number == best),
                )
            )
    return found


def _verdict(factor: float, *, best: bool) -> str:
    """Return the word for a Bayes factor: of the best option, or against another one."""
    if best:
        if factor >= IDENTIFIED:
            return "identified"
        return "favoured" if factor >= FAVOURED else "not identified"
    words = ((EXCLUDED, "excluded"), (IDENTIFIED, "disfavoured"), (FAVOURED, "less likely"))
    return next((word for least, word in words if factor >= least), "open")


def equivalent(values: Floats, tolerance: float) -> Integers:
    """Return (R,) for each row of values (R, V) the first row equal to it within the tolerance.

    Rows are equal where all their numbers are: no evidence that depends on these numbers alone can
    tell such readings apart.
    """
    first = np.arange(len(values))
    order = np.argsort(values[:, 0], kind="stable")
    key = values[order, 0]
    for place, row in enumerate(order.tolist()):
        if first[row] != row:
            continue
        end = int(np.searchsorted(key, key[place] + tolerance, side="right"))
        near = order[place + 1 : end]
        near = near[first[near] == near]
        if len(near) == 0:
            continue
        same = near[(np.abs(values[near] - values[row]) <= tolerance).all(axis=1)]
        first[same] = row
    names, member = np.unique(first, return_inverse=True)
    least = np.full(len(names), len(values))
    np.minimum.at(least, member, np.arange(len(values)))
    return np.asarray(least[member])
