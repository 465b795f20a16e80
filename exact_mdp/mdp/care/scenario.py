"""Care scenarios: read from tables, compiled to an exact MDP, or used as a parametric model.

Each number of the tables is a term of the probability of one status only, so every row of a trial
is affine in it. A row with a skip is a product of two distributions, and quadratic in a number that
both contain (reading `skip_onset = base`). Expected rewards are affine in each weight. As
probabilities are cut off at 1, the polynomial changes at

    base_i + Σ_{j in J} influence_ij = 1     (and persistence_i, if influence adds to it)

for some set J of other statuses (Yuan et al., 2025, Section 2.1).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path

from exact_mdp.mdp.care import toml
from exact_mdp.mdp.care.compile import compile_scenario
from exact_mdp.mdp.care.laws import Laws, describe_excess, warn_of_excess
from exact_mdp.mdp.care.tables import ScenarioTables
from exact_mdp.mdp.errors import locate_errors, require_type
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, moved_from, parameter_of
from exact_mdp.mdp.table import format_rational


class Scenario(ScenarioTables):
    """A care model given by tables: exact numbers, tasks and readings; see `ScenarioTables`.

    Examples
    --------
    >>> scenario = Scenario.load("yuan2025")
    >>> scenario["base.anger"]
    Fraction(1, 20)
    >>> changed = scenario.with_(tasks=[3, 1], parameters={"base.anger": "1/10"})
    >>> changed["base.anger"], changed.tasks
    (Fraction(1, 10), (3, 1))
    """

    @classmethod
    def load(cls, name: str | Path) -> Scenario:
        """Read a shipped scenario by name, or any scenario from a `.toml` file.

        Parameters
        ----------
        name : str or path
            The name of a shipped scenario (yuan2025, tea), or a file.

        Returns
        -------
        Scenario

        Raises
        ------
        ModelError
            For an unknown scenario, or a file with an invalid number or an unknown name.

        Examples
        --------
        >>> Scenario.load("tea").name
        'tea'
        """
        with locate_errors(str(name)):
            return cls(**toml.read_scenario_parts(name))

    @cached_property
    def laws(self) -> Laws:
        """The exact probabilities and weights of the scenario."""
        return Laws.of(self)

    def compile(self) -> MDP:
        """Return the explicit model: one exact row for every state and action.

        Raises
        ------
        ModelError
            If its outcomes would take more than 10 GB.

        Warns
        -----
        ScenarioWarning
            If numbers add up to a probability above 1, which is then cut off at 1.
        """
        mdp = compile_scenario(self.laws)
        warn_of_excess(self.laws)
        return mdp

    def parametric(self) -> ScenarioFamily:
        """Return the scenario as a family of models, one for each choice of its numbers."""
        return ScenarioFamily(scenario=self)


def read_scenario(
    name: str | Path, *, sets: Sequence[str] = (), discount: object | None = None
) -> Scenario:
    """Return a scenario, by name or from a file, with changes "KEY=VALUE" and then a discount."""
    scenario = Scenario.load(name)
    for assignment in require_type(sets, Sequence, "sets", 'give ["KEY=VALUE", …]'):
        scenario = scenario.set(require_type(assignment, str, "sets", 'give "KEY=VALUE"'))
    if discount is not None:
        scenario = scenario.with_(discount=discount)
    return scenario


@dataclass(frozen=True, kw_only=True, eq=False)
class ScenarioFamily(Parametric):
    """A scenario as a family of models, one for each choice of its numbers."""

    scenario: Scenario
    warned: list[str] = field(default_factory=list, repr=False)
    base: MDP | None = field(default=None, repr=False)  # the compiled scenario

    @property
    def name(self) -> str:
        """The scenario's name."""
        return self.scenario.name

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The numbers of the tables, and the discount."""
        rate = Parameter(
            name=DISCOUNT, value=self.scenario.discount, low=Fraction(0), high=Fraction(1)
        )
        return (*self.scenario.parameters, rate)

    def build_model(self, moved: Mapping[str, Fraction]) -> MDP:
        """See `Parametric.build_model`."""
        if not moved and self.base is not None:
            return self.base
        there = self.scenario.with_(parameters=moved)
        mdp = compile_scenario(there.laws)
        where = " at other values of its parameters"
        if not moved:
            where = ""
        elif len(moved) == 1:
            ((name, value),) = moved.items()
            where = f" where {name} is {format_rational(value)}"
        self._warn_once(there, where)
        return mdp

    def warn_of_cutoffs(self, values: Mapping[str, object], *, where: str) -> None:
        """Warn if probabilities are cut off at 1 at other values of some parameters.

        A family warns once, about the first such model; its copies in other processes do not warn.
        `where` names the part of an analysis.
        """
        self._warn_once(self.scenario.with_(parameters=moved_from(self, values)), where)

    def _warn_once(self, there: Scenario, where: str) -> None:
        """Warn about a scenario, unless the family has warned before."""
        if self.warned or describe_excess(there.laws) is None:
            return
        self.warned.append(there.name)
        # If the present values are enough for a warning, use the words of `compile`.
        if describe_excess(self.scenario.laws) is not None:
            there, where = self.scenario, ""
        warn_of_excess(there.laws, where=where)

    def __getstate__(self) -> dict[str, object]:
        return {"scenario": self.scenario, "warned": [self.scenario.name], "asks": self.asks}

    def degree(self, name: str) -> int:
        """See `Parametric.degree`."""
        twice = self.scenario.readings["skip_onset"] == "base"
        twice &= self.scenario.readings["skip_timestep"] == "same"
        moves = parameter_of(self, name).name.startswith(("base.", "influence."))
        if twice and moves:
            return 2
        return 1

    def breakpoints(self, name: str) -> tuple[Fraction, ...]:
        """See `Parametric.breakpoints`."""
        # A sum with this term reaches 1 at 1 less its other terms.
        value, laws = parameter_of(self, name).value, self.scenario.laws
        place = laws.rules.position.get(name, -1)
        sums = laws.sums[(laws.rules.terms == place).any(axis=1)].tolist()
        points = {1 - (Fraction(total, laws.one) - value) for total in sums}
        return tuple(sorted(point for point in points if 0 < point < 1))
