"""Care scenarios: read from tables, compiled to an exact MDP, or taken as a parametric model.

Each probability of the tables enters the chance of one status alone, which makes every row of a
trial affine in it; a row that skips is a product of two laws, and where both have the number in
them (reading `skip_onset = base`) it is quadratic. Expected rewards are affine in each weight. A
chance is cut off at 1, and where that happens the polynomial changes:

    base_i + Σ_{j in J} influence_ij = 1     (and persistence_i, where influence adds to it)

for some set J of other statuses (Yuan et al., 2025, Section 2.1).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from functools import cached_property
from pathlib import Path

from exact_mdp.mdp.care import toml
from exact_mdp.mdp.care.compile import compile_scenario
from exact_mdp.mdp.care.laws import Laws, describe_excess, warn_of_excess
from exact_mdp.mdp.care.tables import ScenarioTables
from exact_mdp.mdp.errors import locate_errors
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, moved_from, parameter_of
from exact_mdp.mdp.table import format_rational


class Scenario(ScenarioTables):
    """A care model as its tables state it: exact numbers, tasks and readings; see `ScenarioTables`.

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
            Of a shipped scenario (yuan2025, tea), or of a file.

        Returns
        -------
        Scenario

        Raises
        ------
        ModelError
            For an unknown name, or a file with a number or a name that does not belong there.

        Examples
        --------
        >>> Scenario.load("tea").name
        'tea'
        """
        with locate_errors(str(name)):
            return cls(**toml.read_scenario_parts(name))

    @cached_property
    def laws(self) -> Laws:
        """Its chances and weights by the rules, exact."""
        return Laws.of(self)

    def compile(self) -> MDP:
        """Return the explicit model: one exact row for every state and action.

        Raises
        ------
        ModelError
            Where its outcomes would take more than 10 GB.

        Warns
        -----
        ScenarioWarning
            Where numbers that add up to a chance pass 1, which is then cut off at 1.
        """
        mdp = compile_scenario(self.laws)
        warn_of_excess(self.laws)
        return mdp

    def parametric(self) -> ScenarioFamily:
        """Return the scenario as a family of models, one for each choice of its numbers."""
        return ScenarioFamily(scenario=self)


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

    def made(self, moved: Mapping[str, Fraction]) -> MDP:
        """See `Parametric.made`."""
        if not moved and self.base is not None:
            return self.base
        there = self.scenario.with_(parameters=moved)
        mdp = compile_scenario(there.laws)
        one = "".join(f" where {name} is {format_rational(value)}" for name, value in moved.items())
        self._warn_once(there, one if len(moved) < 2 else " at other values of its parameters")
        return mdp

    def warn_of_cutoffs(self, values: Mapping[str, object], *, where: str) -> None:
        """Warn of chances that are cut off at 1 at other values of some parameters.

        A family warns once, of the first such model; a copy of it in another process does not.
        `where` says in which part of an analysis.
        """
        self._warn_once(self.scenario.with_(parameters=moved_from(self, values)), where)

    def _warn_once(self, there: Scenario, where: str) -> None:
        if self.warned or describe_excess(there.laws) is None:
            return
        self.warned.append(there.name)
        # Today's values where they are enough, so that the words are those of `compile`.
        if describe_excess(self.scenario.laws) is not None:
            there, where = self.scenario, ""
        warn_of_excess(there.laws, where=where, stacklevel=4)

    def __getstate__(self) -> dict[str, object]:
        return {"scenario": self.scenario, "warned": [self.scenario.name], "asks": self.asks}

    def degree(self, name: str) -> int:
        """See `Parametric.degree`."""
        twice = self.scenario.readings["skip_onset"] == "base"
        twice &= self.scenario.readings["skip_timestep"] == "same"
        moves = parameter_of(self, name).name.startswith(("base.", "influence."))
        return 2 if twice and moves else 1

    def breakpoints(self, name: str) -> tuple[Fraction, ...]:
        """See `Parametric.breakpoints`."""
        value, laws = parameter_of(self, name).value, self.scenario.laws
        place = laws.rules.position.get(name, -1)
        sums = laws.sums[(laws.rules.terms == place).any(axis=1)].tolist()
        points = {1 - (Fraction(total, laws.one) - value) for total in sums}
        return tuple(sorted(point for point in points if 0 < point < 1))
