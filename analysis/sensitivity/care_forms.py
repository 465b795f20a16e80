"""A care scenario's chances and weights over a box of its parameters, in affine forms.

Each parameter is its middle in the box and half the width times an unknown of its own. Chances are
sums of parameters (`mdp.chances`), cut off at 1; one that is cut off somewhere in the box moves by
between nothing and the whole of what its parameters move. The model is that of Yuan et al. (2025),
Sections 2.1 and 3.2, in all its readings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from fractions import Fraction
from functools import cached_property

import numpy as np

from analysis.sensitivity.affine_expectation import OUT, Span
from analysis.sensitivity.affine_forms import Forms, chained, stacked
from mdp.chances import Chances
from mdp.scenario import Scenario
from mdp.table import Floats, Integers
from solvers.rounding import UNIT


class CareForms:
    """Chances and weights of a scenario over one box.

    Parameters
    ----------
    scenario : Scenario
    chances : Chances
        Its own.
    names : sequence of str
        Parameters that may move.
    low, high : {name: Fraction}
        Ends of the box; those that are the same do not move.

    Attributes
    ----------
    names : tuple of J str
        Parameters that move, an unknown each.
    step, skip : forms (…, n)
        Chances of the next statuses after a trial and after a skip.
    step_use, skip_use : ((…, n, J), (…, n, J))
        The least and the greatest share of each unknown in them.
    """

    def __init__(
        self,
        scenario: Scenario,
        chances: Chances,
        names: Sequence[str],
        low: Mapping[str, Fraction],
        high: Mapping[str, Fraction],
    ) -> None:
        self.scenario, self.chances = scenario, chances
        self.names = tuple(name for name in names if low[name] < high[name])
        self.unknowns = len(self.names)
        number = {name: j for j, name in enumerate(self.names)}
        centre = {p.name: float(low.get(p.name, p.value)) for p in scenario.parameters}
        slope = {name: np.zeros(self.unknowns) for name in centre}
        rest = dict.fromkeys(centre, 0.0)
        for name in self.names:
            middle = (low[name] + high[name]) / 2
            centre[name] = float(middle)
            slope[name][number[name]] = float((high[name] - low[name]) / 2)
        for name in centre:
            rest[name] = UNIT * (abs(centre[name]) + float(np.abs(slope[name]).sum()))
        form = {
            name: Forms.of(np.array(centre[name]), slope[name], np.array(rest[name]))
            for name in centre
        }
        order = chances.names
        none = Forms.constant(np.zeros(1), self.unknowns)
        table = chained(stacked([form[name] for name in order]), none)
        place = np.full(len(order) + 1, -1)
        for k, name in enumerate(order):
            place[k] = number.get(name, -1)
        self.step, self.step_use = self._sums(table, chances.step, place)
        self.skip, self.skip_use = self._sums(table, chances.skip, place)
        self.weight = {
            name.removeprefix("reward."): each
            for name, each in form.items()
            if name.startswith("reward.")
        }
        self.earning = {
            name.removeprefix("reward."): number[name]
            for name in self.names
            if name.startswith("reward.")
        }

    def _sums(self, table: Forms, terms: Integers, place: Integers) -> tuple[Forms, Span]:
        """Return chances (…, n), and the share of each unknown in them: (…, n, J), (…, n, J)."""
        total = table[terms[..., 0]]
        for column in range(1, terms.shape[-1]):
            total = total + table[terms[..., column]]
        use = np.zeros((*terms.shape[:-1], self.unknowns))
        for column in range(terms.shape[-1]):
            which = place[terms[..., column]]
            index = np.nonzero(which >= 0)
            use[(*index, which[index])] = 1.0
        least, most = total.low, total.high
        # A parameter alone is at most 1; only a sum can be cut off.
        alone = (terms[..., 1:] == len(self.chances.names)).all(axis=-1)
        over, cut = (least >= 1) & ~alone, (least < 1) & (most > 1) & ~alone
        bottom = np.clip(least, 0.0, 1.0)
        middle = np.where(over, 1.0, np.where(cut, (bottom + 1) / 2, total.centre))
        half = np.where(over, 0.0, np.where(cut, (1 - bottom) / 2 * (1 + OUT) + UNIT, total.rest))
        linear = np.where((over | cut)[..., None], 0.0, total.slope)
        moving = use * ~over[..., None]
        sure = moving * ~cut[..., None]
        within = bottom, np.minimum(most, 1.0)
        return Forms.of(middle, linear, half, within), (sure, moving)

    def earn(self, *names: str) -> tuple[Forms, Floats]:
        """Return the sum of weights, and its derivative (J,)."""
        total = Forms.constant(np.array(0.0), self.unknowns)
        slope = np.zeros(self.unknowns)
        for name in names:
            total = total + self.weight[name]
            if name in self.earning:
                slope[self.earning[name]] += 1.0
        return total, slope

    @cached_property
    def costs(self) -> tuple[Forms, Floats]:
        """What each status vector costs, and its derivative: (2^n,), (2^n, J)."""
        found = [
            self.earn(
                *(
                    self.scenario.weights[status]
                    for status, on in zip(self.scenario.statuses, row, strict=True)
                    if on
                )
            )
            for row in self.chances.bits.tolist()
        ]
        return stacked([form for form, _ in found]), np.stack([slope for _, slope in found])

    def bonus(self, last: bool, *, skipped: bool, flag: int) -> list[str]:
        """Return the weight earned at the end of a subtask, where its reading pays one."""
        rule = self.scenario.readings["task_bonus"]
        paid = last and (
            rule == "always"
            or (rule == "last-subtask-completed" and not skipped)
            or (rule == "no-subtask-skipped" and not skipped and flag == 0)
        )
        return ["task-complete"] if paid else []
