"""The tables of docs/care_models.md: each is made here, and written there by running this file.

A table stands in the page between the comments `<!-- NAME -->` and `<!-- end -->`.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from fractions import Fraction
from functools import cache
from pathlib import Path

import numpy as np

from exact_mdp import MDP, PolicyLike, Scenario, check, solve
from exact_mdp.analysis.gate.column_policies import best_policy
from exact_mdp.mdp.coach.model import Coach
from exact_mdp.mdp.coach.numbers import NUMBERS, OURS, PROMPTS, RIGHT, STEPS

PAGE = Path(__file__).resolve().parents[2] / "docs/care_models.md"
F = Fraction
USERS = ("neither", "aware", "responds", "both")
SMALL = Coach.full(waited=2, prompted=2, ignored=2, repeated=2)


def table(head: Sequence[str], rows: Iterable[Sequence[object]]) -> str:
    """Return a table in Markdown."""
    lines = [head, ["---"] + ["---:"] * (len(head) - 1), *rows]
    return "\n".join(f"| {' | '.join(str(cell) for cell in line)} |" for line in lines)


@cache
def coach() -> MDP:
    return Coach().compile()


def rule(choose: Callable[[dict[str, str]], str]) -> np.ndarray:
    """Return the actions (S,) that a rule takes, from the state in words to an action's name."""
    states = (dict(coach().space.as_dict(state)) for state in range(coach().n_states))
    return np.array([coach().action(choose(at)) for at in states])


def next_step(at: dict[str, str]) -> str:
    """Return the prompt for the first behaviour that is right; none for doing nothing."""
    wanted = RIGHT[STEPS.index(at["step"])].split()[0]
    return next((prompt for prompt, asks in PROMPTS.items() if asks == wanted), "nothing")


def those_who(*who: str) -> Callable[[dict[str, str]], str]:
    """Return the rule that prompts users of these words for the next step, and leaves others."""

    def choose(at: dict[str, str]) -> str:
        fits = all(
            (at[word.removeprefix("not ")] == "yes") != word.startswith("not ") for word in who
        )
        return next_step(at) if fits else "nothing"

    return choose


def words_and_done(at: dict[str, str]) -> str:
    """Return what the file's words ask for, and for wetting the hands of users in step k."""
    done = at["step"] == "k" and at["responsive"] == "yes"
    return "wet_hands" if done else those_who("responsive", "not aware")(at)


POLICIES: dict[str, Callable[[], PolicyLike]] = {
    "never prompt": lambda: "always:nothing",
    "prompt at random": lambda: "random",
    "prompt every user for the next step": lambda: rule(next_step),
    "prompt users who respond": lambda: rule(those_who("responsive")),
    "prompt users who respond and are not aware": lambda: rule(
        those_who("responsive", "not aware")
    ),
    "the same, and those who respond to wet their hands in `k`": lambda: rule(words_and_done),
    "the best that sees the plan step alone": lambda: best_policy(coach(), ("step",)).policy,
    "optimal": lambda: "optimal",
}


def by_user(values: Sequence[float] | np.ndarray) -> list[str]:
    """Return the values of the four kinds of users at the start."""
    return [f"{values[state]:.2f}" for state, _ in coach().start]


def policies() -> str:
    """Return the regret of simple policies in the reduced model, and their values by user."""
    rows = []
    for name, make in POLICIES.items():
        regret = check(coach(), make()).regret
        values = by_user(regret.learned_value)
        rows.append(
            [
                name,
                *values,
                f"{float(regret.learned.value):.3f}",
                f"{float(regret.at_start.value):.3f}",
            ]
        )
    return table(["policy", *USERS, "mean", "regret"], rows)


def weights() -> str:
    """Return the optimal value by user for other weights of all behaviours of an aware user."""
    rows = []
    for any_, right in ((2, 1), (1, 1), ("1/2", 1), (0, 1), (2, 3), (2, 10)):
        changed = Coach().with_numbers({"weight.any": any_, "weight.right": right}).compile()
        alone = F(any_) + F(right)
        chance = alone / (alone + 4 * F(any_))
        solution = solve(changed)
        rows.append([any_, right, chance, *by_user(solution.value), f"{solution.start_value:.2f}"])
    head = ["any behaviour", "the right one, added", "chance of it in step c", *USERS, "mean"]
    return table(head, rows)


def problems() -> str:
    """Return what kind of decision problem each model is."""
    rows = []
    models = {name: Scenario.load(name).compile() for name in ("yuan2025", "tea")}
    for name, mdp in (models | {"coach": coach()}).items():
        best = solve(mdp)
        forms = ["random", *(f"always:{action}" for action in mdp.actions if action != "skip")]
        lost = {form: float(check(mdp, form).regret.at_start.value) for form in forms}
        single = min(forms[1:], key=lost.__getitem__)
        size = [f"`{name}`", f"{mdp.n_states:,}", mdp.n_actions, mdp.discount_exact]
        least = f"{lost[single]:.2f} ({single.removeprefix('always:')})"
        rows.append([*size, f"{best.start_value:.3f}", f"{lost['random']:.2f}", least])
    head = [
        "model",
        "states",
        "actions",
        "discount",
        "optimum",
        "regret of random",
        "least regret of a single action",
    ]
    return table(head, rows)


def ours() -> str:
    """Return the optimum of a model of 207,360 states at half and at double each number of ours."""
    rows: list[list[object]] = []
    for name, number in NUMBERS.items():
        if number.source == OURS:
            changed = (SMALL.with_numbers({name: number.value * by}) for by in (F(1, 2), F(2)))
            rows.append(
                [f"`{name}`", number.value, *(f"{solve(m).start_value:.3f}" for m in changed)]
            )
    rows.sort(key=lambda row: -abs(float(str(row[2])) - float(str(row[3]))))
    found = f"The optimum at the start is {solve(SMALL).start_value:.3f}."
    return f"{found}\n\n{table(['number', 'ours', 'at half', 'at double'], rows)}"


TABLES: dict[str, Callable[[], str]] = {
    "problems": problems,
    "policies": policies,
    "weights": weights,
    "ours": ours,
}


def shown(name: str) -> str:
    """Return the table that the page shows."""
    pattern = rf"<!-- {name} -->\n(.*?)<!-- end -->"
    found = re.search(pattern, PAGE.read_text("utf-8"), re.DOTALL)
    assert found, name
    return found[1].strip()


def write(page: Path = PAGE) -> None:
    """Write every table into the page."""
    text = page.read_text("utf-8")
    for name, make in TABLES.items():
        before, rest = text.split(f"<!-- {name} -->\n", 1)
        _, after = rest.split("<!-- end -->", 1)
        text = f"{before}<!-- {name} -->\n\n{make()}\n\n<!-- end -->{after}"
    page.write_text(text, "utf-8")


if __name__ == "__main__":
    write()
