"""Claims about the model: its states, actions, probabilities and rewards (Sections 2.1 and 3.2).

Every number is read back out of the compiled model, so that what the solvers use is compared and
not the scenario file: the chance that a status is 1 next is summed up from the outcomes of a
compiled row, as an exact rational.
"""

from __future__ import annotations

from collections.abc import Iterator
from fractions import Fraction
from functools import partial
from itertools import pairwise
from math import prod

import numpy as np

from exact_mdp.mdp.chain import is_acyclic
from exact_mdp.mdp.model import MDP
from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.claim import Claims, Finding, entry, statement, undecided
from exact_mdp.paper_repro.reading import Reading
from exact_mdp.solvers.solution import Certified

CLAIMS = Claims()
BITS = {"forgetfulness": 8, "confusion": 4, "anger": 2, "disengagement": 1}
CHARGED = ("forget", "confuse", "anger", "disengaged")  # the weight of each status, in order
NONE = reported.NUMBER["none"]


# ---- what the compiled rows say ----------------------------------------------------------------


def marginal(mdp: MDP, vector: int, action: int, status: str, *, trial: int = 0) -> Fraction:
    """Return the exact probability that a status is present next, from a status vector.

    >>> from exact_mdp import Scenario
    >>> marginal(Scenario.load("yuan2025").compile(), 0b0010, 0, "forgetfulness")
    Fraction(37, 100)
    """
    state = mdp.space.index(subtask=0, trial=trial, status=vector)
    pairs = mdp.pairs_of(state)
    pair = pairs[0] if len(pairs) == 1 else mdp.pair(state, action)
    rows = mdp.table.row(pair)
    following = np.maximum(mdp.space.values("status", np.array([s for _, s, _ in rows])), 0)
    present = following & BITS[status]
    return sum((row[0] for row, now in zip(rows, present, strict=True) if now), Fraction(0))


def effect(mdp: MDP, source: str, target: str) -> Fraction:
    """Return what a status that is present adds to the chance of another one."""
    return marginal(mdp, BITS[source], NONE, target) - marginal(mdp, 0, NONE, target)


def weights(mdp: MDP) -> dict[str, Fraction]:
    """Return the reward weights that a compiled model holds, by the names of Table 4."""
    return {parameter.name.removeprefix("reward."): parameter.value for parameter in mdp.parameters}


def _rewards(mdp: MDP, trials: int) -> Iterator[tuple[int, int, int, bool, Fraction]]:
    """Yield action, next status, subtask, whether it is completed, and the reward of outcomes.

    Those with positive probability from a trial before the last one, from which no subtask is
    skipped, so that the next status is that of the next state.
    """
    space = mdp.space
    trial, subtask, status = (space.values(name) for name in ("trial", "subtask", "status"))
    for state in np.flatnonzero(trial[: space.regular] < trials - 1).tolist():
        for pair in mdp.pairs_of(state):
            for probability, following, gain in mdp.table.row(pair):
                if probability:
                    ended = following >= space.regular
                    done = ended or subtask[following] != subtask[state]
                    after = 0 if ended else int(status[following])
                    yield int(mdp.pair_action[pair]), after, int(subtask[state]), bool(done), gain


# ---- the simulator, Tables 1 and 2 -------------------------------------------------------------


@CLAIMS.add("simulator.open-source", "Section 1", "open")
def _open_source(reading: Reading) -> Finding:
    """The simulator is open source."""
    return undecided(
        "the text gives no address for it. Earlier code of the same laboratory is public "
        "(github.com/ZhaoRobotLab/PLWDCareSim, last changed before the paper); whether it is the "
        "simulator of the paper is not stated. Nothing here is taken from it"
    )


@CLAIMS.add("table1.example", "Table 1", kind="input", open=True)
def _example(reading: Reading) -> Finding:
    """The example has a first task of three items, each identified and then picked up: six
    subtasks; and a second task, choosing the cash."""
    first, *rest = reading.scenario.tasks
    return statement(
        first == 6,
        f"subtasks of each task: {', '.join(map(str, (first, *rest)))}; the text does not say how "
        "many the experiments ran, nor how many the second task of the example has",
    )


@CLAIMS.add("table1.timesteps", "Table 1", kind="input", open=True)
def _timesteps(reading: Reading) -> Finding:
    """The timesteps of a scenario are the sum of the trials over all its subtasks."""
    mdp = reading.mdp
    trying = (mdp.space.values("trial") < reading.scenario.trials) & ~mdp.terminal
    found = [reading.evaluations[name] for name in ("optimal", "random")]
    far = max(abs(each.steps - float(each.visits[trying].sum())) for each in found)
    holds = far < 1e-9
    return statement(
        holds,
        "expected timesteps equal expected trials under the optimal and the random policy"
        if holds
        else f"a skip takes a timestep of its own: up to {far:.2f} more timesteps than trials",
    )


def _named(reading: Reading, number: int, action: str) -> Finding:
    found = reading.mdp.actions[number]
    return statement(found == action, f"action {number} of the model is {found}")


for _action, _number in reported.NUMBER.items():
    CLAIMS.add(
        f"table2.{_action}",
        "Table 2, Section 3.2.2",
        says=f"Assistance a{_number} is {_action.replace('none', 'no assistance')}.",
        kind="input",
    )(partial(_named, number=_number, action=_action))


# ---- Table 3 and what the text says of it ------------------------------------------------------


def _next(reading: Reading, vector: int, action: int, status: str) -> Fraction:
    return marginal(reading.mdp, vector, action, status)


def _influence(reading: Reading, row: str, column: str) -> Fraction:
    """Read one entry of Table 3 out of the compiled rows, whichever way they point."""
    forwards = reading.scenario.readings["influence_orientation"] == "row-to-column"
    source, target = (row, column) if forwards else (column, row)
    if row == column:
        return marginal(reading.mdp, BITS[source], NONE, target)
    return effect(reading.mdp, source, target)


for _row, (_base, _entries) in reported.TABLE_3.items():
    CLAIMS.entry(
        f"table3.base.{_row}",
        "Table 3",
        f"Base probability of {_row}.",
        Fraction(_base, 100),
        partial(_next, vector=0, action=NONE, status=_row),
        unit="%",
    )
    for _column, _entry in zip(reported.TABLE_3, _entries, strict=True):
        _same = _row == _column
        CLAIMS.entry(
            f"table3.persistence.{_row}" if _same else f"table3.influence.{_row}.{_column}",
            "Table 3",
            f"{_row.capitalize()} stays."
            if _same
            else f"Influence in row {_row}, column {_column}.",
            Fraction(_entry, 100),
            partial(_influence, row=_row, column=_column),
            unit="%",
        )


@CLAIMS.add("prose.no-recovery-alone", "Section 2.1", kind="input")
def _recovery(reading: Reading) -> Finding:
    """Without assistance a status hardly ever goes away by itself (almost probability 1 of
    staying)."""
    leaves = max(1 - marginal(reading.mdp, bit, NONE, status) for status, bit in BITS.items())
    return statement(
        leaves <= Fraction(1, 100),
        f"a status alone goes away with probability {float(leaves):.0%} at most",
        Certified(value=leaves),
        f"{float(leaves):.0%}",
    )


@CLAIMS.add("states.independent", "Section 2.1", "open", kind="input")
def _independent(reading: Reading) -> Finding:
    """The four statuses of the next timestep are drawn one by one."""
    mdp, rows, product = reading.mdp, 0, 0
    for vector in range(16):
        for action in reported.NUMBER.values():
            ones = {bit: _next(reading, vector, action, name) for name, bit in BITS.items()}
            rows += 1
            product += all(
                probability == prod(p if after & bit else 1 - p for bit, p in ones.items())
                for after, probability in _law(mdp, vector, action).items()
            )
    return undecided(
        "the text gives the probability of each status alone and does not say that the four are "
        f"independent given statuses and assistance; here they are, in {product} of {rows} rows"
    )


def _law(mdp: MDP, vector: int, action: int) -> dict[int, Fraction]:
    """Return the exact law of the next status vector in the first trial of the first subtask."""
    state = mdp.space.index(subtask=0, trial=0, status=vector)
    found = dict.fromkeys(range(16), Fraction(0))
    for probability, following, _ in mdp.table.row(mdp.pair(state, action)):
        found[max(int(mdp.space.values("status", np.array([following]))[0]), 0)] += probability
    return found


def _points(effects: dict[str, Fraction]) -> str:
    return ", ".join(f"{name} {float(100 * value):+g}" for name, value in effects.items())


@CLAIMS.add("prose.anger-weighs-most-on-forgetfulness", "Section 2.1.1", kind="input", open=True)
def _anger_on_forgetfulness(reading: Reading) -> Finding:
    """Confusion, anger and disengagement raise forgetfulness, anger the most."""
    sources = ("confusion", "anger", "disengagement")
    effects = {source: effect(reading.mdp, source, "forgetfulness") for source in sources}
    others = max(effects["confusion"], effects["disengagement"])
    holds = min(effects.values()) > 0 and effects["anger"] > others
    return statement(holds, f"percentage points: {_points(effects)}")


@CLAIMS.add("prose.anger-contributes-most", "Section 2.1.1", kind="input", open=True)
def _anger_contributes(reading: Reading) -> Finding:
    """Anger contributes more to the other statuses than they to each other."""
    effects = {
        source: sum((effect(reading.mdp, source, t) for t in BITS if t != source), Fraction(0))
        for source in BITS
    }
    rest = max(value for name, value in effects.items() if name != "anger")
    return statement(
        effects["anger"] > rest, f"percentage points on the other three: {_points(effects)}"
    )


@CLAIMS.add("prose.distress", "Section 2.1.1", kind="input", open=True)
def _distress(reading: Reading) -> Finding:
    """Forgetfulness and confusion lead to anger; these three lead to disengagement."""
    edges = [("forgetfulness", "anger"), ("confusion", "anger")]
    edges += [(name, "disengagement") for name in ("forgetfulness", "confusion", "anger")]
    effects = {f"{a} on {b}": effect(reading.mdp, a, b) for a, b in edges}
    return statement(min(effects.values()) > 0, f"percentage points: {_points(effects)}")


# ---- assistance and skipping -------------------------------------------------------------------

for _action, _stays in reported.ASSISTANCE.items():
    for _status, _persists in _stays.items():
        for _kind, _paper, _vector, _now in (
            ("persistence", _persists, BITS[_status], "present"),
            ("onset", 0, 0, "absent"),
        ):
            CLAIMS.entry(
                f"assistance.{_action}.{_status}.{_kind}",
                "Section 2.1.2",
                f"{_status.capitalize()} next under {_action} assistance, where it is {_now}.",
                Fraction(_paper, 100),
                partial(_next, vector=_vector, action=reported.NUMBER[_action], status=_status),
                unit="%",
            )


@CLAIMS.add("assistance.rest", "Section 2.1.2", kind="input")
def _rest(reading: Reading) -> Finding:
    """Statuses that an assistance does not name move as without assistance."""
    compared = wrong = 0
    for action, number in reported.NUMBER.items():
        for status in set(BITS) - set(reported.ASSISTANCE.get(action, {})):
            for vector in range(16):
                alone = marginal(reading.mdp, vector, NONE, status)
                wrong += marginal(reading.mdp, vector, number, status) != alone
                compared += 1
    return statement(wrong == 0, f"{compared - wrong} of {compared} probabilities are the same")


def _skipped(reading: Reading, vector: int, status: str) -> Fraction:
    trial = reading.scenario.trials
    return marginal(reading.skip_model, vector, NONE, status, trial=trial)


_PAIR = {"forgetfulness": "confusion", "confusion": "forgetfulness"}
for _status, _rates in reported.SKIP.items():
    for _kind, _paper in _rates.items():
        _other = _PAIR[_status] if _kind == "with-other" else ""
        CLAIMS.entry(
            f"skip.{_status}.{_kind}",
            "Section 2.1.3",
            f"{_status.capitalize()}{_other and f' together with {_other}'} persists when a "
            "subtask is skipped.",
            Fraction(_paper, 100),
            partial(_skipped, vector=BITS[_status] | BITS.get(_other, 0), status=_status),
            unit="%",
            open=True,
        )


@CLAIMS.add("prose.stress-on-memory", "Section 2.1.3", kind="input", open=True)
def _stress(reading: Reading) -> Finding:
    """What a skip leaves of forgetfulness and confusion reflects emotional stress."""
    stays = {
        vector: [_skipped(reading, vector, name) for name in _PAIR if vector & BITS[name]]
        for vector in range(16)
    }
    calm = [vector for vector in range(16) if not vector & (BITS["anger"] | BITS["disengagement"])]
    moved = [
        upset
        for vector in calm
        for upset in (vector | BITS["anger"], vector | BITS["disengagement"])
        if stays[upset] != stays[vector]
    ]
    return statement(
        bool(moved),
        "anger or disengagement changes them"
        if moved
        else "they persist with the same probability with anger or disengagement as without; what "
        "raises it is the other of the two, a cognitive status",
    )


# ---- spaces ------------------------------------------------------------------------------------

CLAIMS.entry(
    "states.statuses",
    "Section 3.2.1",
    "Four binary statuses make 16 status vectors.",
    16,
    lambda reading: Fraction(reading.mdp.space.column("status").size),
)


@CLAIMS.add("states.start", "Section 3.2.1", kind="input")
def _start(reading: Reading) -> Finding:
    """An episode starts with none of the four statuses present."""
    label = " and ".join(reading.mdp.space.label(state) for state, _ in reading.mdp.start)
    return statement("status 0000" in label, f"the start is {label}")


@CLAIMS.add("states.end", "Section 3.2.1", kind="input")
def _end(reading: Reading) -> Finding:
    """An episode ends when every subtask is completed or skipped."""
    mdp = reading.mdp
    ends = [mdp.space.label(state) for state in np.flatnonzero(mdp.terminal).tolist()]
    steps = sum(reading.scenario.tasks) * (reading.scenario.trials + 1)
    return statement(
        is_acyclic(mdp) and len(ends) == 1,
        f"no state can come again and only the state “{ends[0]}” is terminal, so that every "
        f"episode ends within {steps} timesteps",
    )


def _max_trial(reading: Reading) -> Finding:
    after = reading.scenario.trials
    return entry(Fraction(5), Fraction(after), f"a subtask is skipped on failed trial {after}")


CLAIMS.entry(
    "actions.max-trial",
    "Section 3.2.2, Section 2.1",
    "A subtask is skipped after 5 trials (MaxTrial).",
    5,
    _max_trial,
    open=True,
)


# ---- rewards -----------------------------------------------------------------------------------


@CLAIMS.add("equation1", "Equation 1, Section 3.2.3", kind="input")
def _equation_1(reading: Reading) -> Finding:
    """The immediate reward is the weighted sum of statuses, trial, completion, assistance, timestep
    and task completion."""
    # Compare every visible outcome of the compiled model with Equation 1, written out anew.
    w, last = reported.TABLE_4, np.cumsum(reading.scenario.tasks) - 1
    checked = wrong = 0
    for action, after, subtask, done, gain in _rewards(reading.mdp, reading.scenario.trials):
        present = zip(CHARGED, BITS.values(), strict=True)
        total = sum(w[name] for name, bit in present if after & bit) + w["trial"] + w["timestep"]
        if done:
            total += w["subtask-complete"] + w[f"assist.{reported.ACTIONS[action]}"]
            total += w["task-complete"] if subtask in last else 0
        checked += 1
        wrong += gain != total
    return statement(
        wrong == 0, f"{checked - wrong:,} of {checked:,} outcomes earn what the equation gives"
    )


def _weight(reading: Reading, weight: str) -> Fraction:
    return weights(reading.mdp)[weight]


for _name, _weighs in reported.TABLE_4.items():
    CLAIMS.entry(
        f"table4.{_name}", "Table 4", f"Weight {_name}.", _weighs, partial(_weight, weight=_name)
    )


@CLAIMS.add("prose.minimal-assistance", "Section 3.2.3", kind="input")
def _minimal(reading: Reading) -> Finding:
    """Completing a subtask costs more, the more intrusive the assistance."""
    found = [weights(reading.mdp)[f"assist.{action}"] for action in reported.ACTIONS]
    falls = all(a > b for a, b in pairwise(found))
    return statement(falls, "a0 to a3: " + ", ".join(str(value) for value in found))


@CLAIMS.add("prose.anger-first", "Section 3.2.3", kind="input")
def _anger_first(reading: Reading) -> Finding:
    """Anger is charged most of the four statuses."""
    held = weights(reading.mdp)
    anger, *rest = (held[name] for name in ("anger", "forget", "confuse", "disengaged"))
    return statement(anger < min(rest), f"anger {anger}, the others {', '.join(map(str, rest))}")
