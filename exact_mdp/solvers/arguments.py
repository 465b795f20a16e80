"""The arguments that most functions share, a model and a criterion; and what results say of it."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from exact_mdp.mdp.care.scenario import Scenario
from exact_mdp.mdp.errors import ModelError, require_known_name
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.questions.ending import ends_at_label
from exact_mdp.mdp.report import Shown
from exact_mdp.mdp.space import TIME

CRITERIA = ("total", "average")
Criterion = Literal["total", "average"]


def mdp_of(model: object) -> MDP:
    """Return a model as an MDP; a scenario is compiled, a file or an environment is read."""
    if isinstance(model, Scenario):
        return model.compile()
    if isinstance(model, MDP):
        return model
    if isinstance(model, str | Path):
        return MDP.load(model)
    if hasattr(model, "unwrapped"):  # an environment
        return MDP.from_gymnasium(model)
    raise ModelError(
        f"{type(model).__name__} is not a model",
        where="model",
        fix="give what MDP.from_arrays, MDP.from_gymnasium or another MDP.from_… returns, a "
        "Scenario, or family.at({}) of a Family; MDP.load reads a file",
    )


def is_average(criterion: str) -> bool:
    """Return whether the criterion is the average reward; raise ModelError for an unknown word."""
    return require_known_name(criterion, CRITERIA, "criterion", "criterion") == "average"


def require_average_applies(mdp: MDP) -> None:
    """Raise ModelError for an average reward of a model whose runs end at a label or a time."""
    if ends_at_label(mdp):
        raise ModelError(
            "an average reward per step has no target",
            where="criterion",
            fix="ask the model itself, without until or reaching, or leave out the criterion",
        )
    if mdp.space.names[:1] == (TIME,) and mdp.ends.is_acyclic:
        raise ModelError(
            "an average reward per step has no horizon",
            where="criterion",
            fix="ask a model without steps, or divide the total of N steps by N",
        )


def require_no_horizon(horizon: object) -> None:
    """Raise ModelError for a horizon beside an average reward."""
    if horizon is not None:
        raise ModelError(
            "an average reward per step has no horizon",
            where="horizon",
            fix="leave horizon out, or divide the total of N steps by N",
        )


class OfCriterion:
    """Base class of results whose values are total or average rewards."""

    criterion: str

    @property
    def measure(self) -> str:
        """What the values are, in words."""
        if is_average(self.criterion):
            return "average reward"
        return "value"

    @property
    def criterion_facts(self) -> dict[str, Shown]:
        """The facts of a report that say so; none for a total."""
        if is_average(self.criterion):
            return {"criterion": Shown(self.criterion, "average reward per step")}
        return {}
