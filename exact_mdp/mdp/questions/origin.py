"""The questions that a model answers, in order, and the model that they were asked about.

    origin  -- question -->  model  -- question -->  model that answers both

A question has the parameters of its origin: one row of the origin may be many rows of the
model of the question, such as one for each time. A study therefore changes the origin and asks its
questions again. The origin is kept beside the parts of a model, and in its copies and pickles.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import reduce
from typing import Any, TypeVar

Model = TypeVar("Model")


@dataclass(frozen=True)
class Question:
    """A question about a model: a method of `MDP` that returns another model, and its options."""

    method: str
    options: Mapping[str, Any]

    def __call__(self, model: Any) -> Any:
        """Return the model that answers the question about `model`."""
        return getattr(model, self.method)(**self.options)


@dataclass(frozen=True)
class Origin:
    """The model that questions were asked about, and the questions in order."""

    model: Any
    questions: tuple[Question, ...]

    @property
    def asks_for_chance(self) -> bool:
        """Whether the answer is the probability of a label."""
        return any(each.method == "reaching" for each in self.questions)

    @property
    def paid(self) -> bool:
        """Whether there are terminal values that count; they do not count in a probability."""
        if self.asks_for_chance:
            return False
        return any(each.options.get("terminal_value") is not None for each in self.questions)

    def without_terminal_value(self) -> Origin:
        """Return the same questions without terminal values."""
        asked = []
        for question in self.questions:
            options = dict(question.options)
            if "terminal_value" in options:
                options["terminal_value"] = None
            asked.append(replace(question, options=options))
        return replace(self, questions=tuple(asked))

    def rebuild_model(self) -> Any:
        """Return the model that answers all questions, one after the other."""
        return reduce(lambda model, ask: ask(model), self.questions, self.model)


def origin_of(model: Any) -> Origin | None:
    """Return the origin of the model of a question; None for any other model."""
    found: Origin | None = vars(model).get("origin")
    return found


def keep_origin(answer: Model, asked_of: Any, method: str, **options: Any) -> Model:
    """Record in `answer` the model and the question that it answers; return it."""
    before = origin_of(asked_of) or Origin(asked_of, ())
    question = Question(method, options)
    vars(answer)["origin"] = Origin(before.model, (*before.questions, question))
    return answer


def keep_origin_changed(
    answer: Any, asked_of: Any, discount: object | None, changes: Mapping[str, Any]
) -> None:
    """Record the origin of a copy with other parts, as `keep_origin` does.

    The discount is a parameter of the original model, so a new discount is set there. The model of
    a probability has no discount; a copy with one answers another question and has no origin.
    """
    before = origin_of(asked_of)
    assert before is not None
    if "discount_exact" in changes:
        return
    if discount is not None:
        if before.asks_for_chance:
            return
        before = replace(before, model=before.model.with_(discount=discount))
    if changes:
        question = Question("with_", dict(changes))
        before = replace(before, questions=(*before.questions, question))
    vars(answer)["origin"] = before
