"""Every analysis of every question agrees with enumeration, or refuses in words; see `table`."""

import pytest

import exact_mdp

from . import table
from .analyses import ANALYSES
from .models import QUESTIONS

FEW = {"robust", "sobol", "psa", "gradient", "explore", "subject_to", "study", "one_way"}
KNOWN = table.read()
# What makes, reads, keeps and learns models and policies, and what another name in the table does:
# assert_policy_optimal is check, and solve_robust is what robust asks.
NOT_ASKED = {
    *("assert_policy_optimal", "check_trainer", "counted", "draw", "fingerprint", "frequencies"),
    *(
        "cohort_trace",
        "choose_once",
        "independent",
        "learning_curve",
        "load",
        "moving",
        "outcomes",
        "parametric",
        "perceived",
    ),
    *("plots", "save", "solve_robust", "train", "uncertainty"),
}


@pytest.mark.parametrize("analysis", ANALYSES)
def test_a_few_models_of_every_question(analysis: str) -> None:
    assert KNOWN[analysis].keys() == {question.name for question in QUESTIONS}
    for number, question in enumerate(QUESTIONS):
        answered, refused = KNOWN[analysis][question.name]
        for model in range(number, number + (1 if analysis in FEW else 2)):
            found = table.outcome(analysis, question, model)
            assert found == "answered" or refused, f"{question.name} was answered before"
            assert found == "refused" or answered, f"{question.name} was refused before"


@pytest.mark.slow
@pytest.mark.timeout(3600)
@pytest.mark.parametrize("question", QUESTIONS, ids=lambda question: question.name)
@pytest.mark.parametrize("analysis", ANALYSES)
def test_many_models_of_every_question(analysis: str, question) -> None:
    counted = KNOWN[analysis][question.name]
    assert list(table.cell(analysis, question.name, 0, sum(counted))) == counted


def test_every_analysis_with_a_model_is_in_the_table() -> None:
    functions = {name for name in dir(exact_mdp) if name[0].islower()}
    assert functions - {*ANALYSES} == NOT_ASKED
