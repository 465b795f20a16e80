"""The origin of a question: asked again it gives the same model, also after changes."""

import pickle

from exact_mdp import MDP
from exact_mdp.mdp.questions.origin import Question, origin_of

ROWS = [(0, 0, [("1/3", 0, 4), ("2/3", 1, 7)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 0, "1/2")])]
MODEL = MDP.from_outcomes(ROWS, "1/2", labels={"there": [1]})


def methods(mdp: MDP) -> list[str]:
    origin = origin_of(mdp)
    assert origin is not None
    assert origin.rebuild_model() == mdp
    return [question.method for question in origin.questions]


def test_questions_are_kept_in_their_order() -> None:
    asked = MODEL.within(3, terminal_value={0: 1}).until("there").negated().with_(start=1)
    assert origin_of(MODEL) is None
    assert methods(asked) == ["within", "until", "negated", "with_"]
    assert methods(pickle.loads(pickle.dumps(asked))) == methods(asked)
    assert Question("within", {"steps": 3})(MODEL) == MODEL.within(3)


def test_terminal_values_count_but_for_a_probability() -> None:
    paid = origin_of(MODEL.within(3, terminal_value={0: 1}))
    assert paid is not None
    assert paid.paid
    assert paid.without_terminal_value().rebuild_model() == MODEL.within(3)
    for asked in (MODEL.within(3), MODEL.within(3, terminal_value={0: 1}).reaching("there")):
        origin = origin_of(asked)
        assert origin is not None
        assert not origin.paid


def test_a_discount_is_set_in_the_origin() -> None:
    asked = MODEL.until("there").with_(discount="3/4")
    origin = origin_of(asked)
    assert origin is not None
    assert origin.model.discount == 0.75
    assert methods(asked) == ["until"]
    assert origin_of(MODEL.reaching("there").with_(discount="3/4")) is None
    assert origin_of(MODEL.until("there").with_(discount_exact=MODEL.discount_exact)) is None
