"""Care scenarios: read from tables, compiled to an exact MDP, or taken as a parametric model.

Each probability of the tables enters the chance of one status alone, which makes every row of a
trial affine in it; a row that skips is a product of two laws, and where both have the number in
them (reading `skip_onset = base`) it is quadratic. Expected rewards are affine in each weight and
their squares quadratic. A chance is cut off at 1, and where that happens the polynomial changes:

    base_i + Σ_{j in J} influence_ij = 1     (and persistence_i, where influence adds to it)

for some set J of other statuses (Yuan et al., 2025, Section 2.1).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import combinations
from pathlib import Path

from exact_mdp.mdp.care import toml
from exact_mdp.mdp.care.compile import compile_scenario
from exact_mdp.mdp.care.laws import excess, warn_of_excess
from exact_mdp.mdp.care.operator import CareOperator, care_operator
from exact_mdp.mdp.care.tables import Tables
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.parameter import Parameter
from exact_mdp.mdp.parametric import DISCOUNT, Parametric, parameter_of, placed


class Scenario(Tables):
    """A care model as its tables state it: exact numbers, tasks and readings; see `Tables`.

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
        """Read a shipped scenario by name, or any scenario from a `.toml` file."""
        return toml.load(name, cls)

    def compile(self) -> MDP:
        """Return the explicit model: one exact row for every state and action.

        Warns
        -----
        ScenarioWarning
            Where numbers that add up to a chance pass 1, which is then cut off at 1.
        """
        mdp = compile_scenario(self)
        warn_of_excess(self)
        return mdp

    def operator(self) -> CareOperator:
        """Return the same model without its matrix, for scenarios of up to 14 statuses.

        Warns
        -----
        ScenarioWarning
            As `compile`.
        """
        operator = care_operator(self)
        warn_of_excess(self)
        return operator

    def parametric(self) -> ScenarioFamily:
        """Return the scenario as a family of models, one for each choice of its numbers."""
        return ScenarioFamily(scenario=self)


@dataclass(frozen=True, kw_only=True)
class ScenarioFamily:
    """See `mdp.parametric.Parametric`.

    Examples
    --------
    >>> family = ScenarioFamily(scenario=Scenario.load("yuan2025"))
    >>> family.at({"base.anger": "1/10"}).discount_exact, family.breakpoints("base.anger")
    (Fraction(1, 1), (Fraction(33, 50), ...))
    """

    scenario: Scenario
    told: list[str] = field(default_factory=list, compare=False, repr=False)

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

    def at(self, values: Mapping[str, object]) -> MDP:
        """See `Parametric.at`; raises ModelError for unknown names and values out of range."""
        there = self.scenario.with_(parameters=placed(self, values))
        mdp = compile_scenario(there)
        self._tell(there)
        return mdp

    def tell(self, values: Mapping[str, object], *, where: str = "") -> None:
        """Warn of chances that are cut off at 1 at other values of some parameters.

        A family warns once, of the first such model; a copy of it in another process does not.

        Parameters
        ----------
        values : {parameter name: value}
        where : str, optional
            In which part of an analysis.
        """
        self._tell(self.scenario.with_(parameters=placed(self, values)), where)

    def _tell(self, there: Scenario, where: str = "") -> None:
        if self.told or excess(there) is None:
            return
        self.told.append(there.name)
        # Today's values where they are enough, so that the words are those of `compile`.
        if excess(self.scenario) is not None:
            there, where = self.scenario, ""
        warn_of_excess(there, where=where, stacklevel=4)

    def __getstate__(self) -> dict[str, object]:
        return {"scenario": self.scenario, "told": [self.scenario.name]}

    def degree(self, name: str) -> int:
        """See `Parametric.degree`."""
        twice = self.scenario.readings["skip_onset"] == "base"
        twice &= self.scenario.readings["skip_timestep"] == "same"
        moves = parameter_of(self, name).name.startswith(("base.", "influence."))
        return 2 if twice and moves else 1

    def moment_degree(self, name: str) -> int:
        """See `Parametric.moment_degree`: probabilities and rewards do not move together."""
        return 2 if name.startswith("reward.") else self.degree(name)

    def breakpoints(self, name: str) -> tuple[Fraction, ...]:
        """See `Parametric.breakpoints`."""
        parameter_of(self, name)
        inside = (point for point in self._cuts(name) if 0 < point < 1)
        return tuple(sorted(set(inside)))

    def neighbours(self) -> Mapping[str, tuple[Parametric | None, Parametric]]:
        """The scenarios with one trial less and one trial more."""
        trials, below = self.scenario.max_trial, None
        if trials > 1:
            below = ScenarioFamily(
                scenario=self.scenario.with_(max_trial=trials - 1), told=self.told
            )
        above = ScenarioFamily(scenario=self.scenario.with_(max_trial=trials + 1), told=self.told)
        return {"max_trial": (below, above)}

    def _cuts(self, name: str) -> Iterator[Fraction]:
        scenario = self.scenario
        additive = scenario.readings["influence_on_present"] == "additive"
        by_row = scenario.readings["influence_orientation"] == "row-to-column"
        for target in scenario.statuses:
            added = []
            for origin in scenario.statuses:
                if origin != target:
                    first, second = (origin, target) if by_row else (target, origin)
                    added.append(f"influence.{first}.{second}")
            for alone in (f"base.{target}", *([f"persistence.{target}"] if additive else [])):
                if name != alone and name not in added:
                    continue
                for count in range(len(added) + 1):
                    for present in combinations(added, count):
                        terms = (alone, *present)
                        if name in terms:
                            held = (scenario[term] for term in terms if term != name)
                            yield 1 - sum(held, Fraction(0))
