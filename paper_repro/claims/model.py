"""Claims about the model: its states, actions, probabilities and rewards (Sections 2.1 and 3.2).

Every number is read out of the compiled rows (`paper_repro.model_rows`) and compared as an exact
rational.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from functools import partial
from itertools import pairwise

from exact_mdp.paper_repro import reported
from exact_mdp.paper_repro.claims.claim import Finding, Kind, PaperClaim, entry, statement
from exact_mdp.paper_repro.model_rows import gains, marginal
from exact_mdp.paper_repro.view import View
from exact_mdp.solvers.solution import Certified

BITS = {"forgetfulness": 8, "confusion": 4, "anger": 2, "disengagement": 1}
CHARGED = ("forget", "confuse", "anger", "disengaged")  # the weight of each status, in order
NONE = 0


def claims() -> Iterator[PaperClaim]:
    """Yield the claims about the model, in the order of the paper.

    Numbers, names and definitions are inputs; what the prose concludes from them is a finding.
    """
    parts = (
        _table_1, _table_2, _table_3, _prose, _assistance, _skip, _spaces, _rewards
    )  # fmt: skip
    for part in parts:
        for claim in part():
            kind: Kind = "finding" if claim.id.startswith("prose.") else "input"
            yield replace(claim, kind=kind)


# ---- Tables 1 and 2 ----------------------------------------------------------------------------


def _table_1() -> Iterator[PaperClaim]:
    yield PaperClaim(
        id="table1.timesteps",
        places=("Table 1",),
        says="The timesteps of a scenario are the sum of the trials over all its subtasks.",
        rule="statement",
        find=_timesteps,
        open=True,
    )


def _timesteps(view: View) -> Finding:
    mdp = view.mdp
    trying = mdp.space.values("trial") < view.scenario.trials
    trying &= ~mdp.terminal
    apart = []
    for name in ("optimal", "random"):
        found = view.study.evaluations[name]
        apart.append(found.steps - float(found.visits[trying].sum()))
    far = max(map(abs, apart))
    holds = far < 1e-9
    why = (
        "expected timesteps equal expected trials under the optimal and the random policy"
        if holds
        else f"a skip takes a timestep of its own: up to {far:.2f} more timesteps than trials"
    )
    return statement(holds, why)


def _table_2() -> Iterator[PaperClaim]:
    for number, action in enumerate(reported.ACTIONS):
        yield PaperClaim(
            id=f"table2.{action}",
            places=("Table 2", "Section 3.2.2"),
            says=f"Assistance a{number} is {action.replace('none', 'no assistance')}.",
            rule="statement",
            find=partial(_named, number=number, action=action),
        )


def _named(view: View, *, number: int, action: str) -> Finding:
    found = view.mdp.actions[number]
    return statement(found == action, f"action {number} of the model is {found}")


# ---- Table 3 and what the text says of it ------------------------------------------------------


def _table_3() -> Iterator[PaperClaim]:
    for i, (status, (base, row)) in enumerate(reported.TABLE_3.items()):
        yield _per_cent(
            f"table3.base.{status}", f"Base probability of {status}.", base, (0, NONE, status)
        )
        for j, target in enumerate(reported.TABLE_3):
            if i == j:
                name, says = f"table3.persistence.{status}", f"{status.capitalize()} stays."
            else:
                name = f"table3.influence.{status}.{target}"
                says = f"Influence in row {status}, column {target}."
            yield PaperClaim(
                id=name,
                places=("Table 3",),
                says=says,
                rule="entry",
                paper=Fraction(row[j], 100),
                unit="%",
                find=partial(_influence, row=status, column=target, paper=row[j]),
            )


def _influence(view: View, *, row: str, column: str, paper: int) -> Finding:
    """Read one entry of Table 3 out of the compiled rows, whichever way they point."""
    mdp, forwards = view.mdp, view.scenario.readings["influence_orientation"] == "row-to-column"
    source, target = (row, column) if forwards else (column, row)
    with_it = marginal(mdp, BITS[source], NONE, BITS[target])
    found = with_it if row == column else with_it - marginal(mdp, 0, NONE, BITS[target])
    return entry(Fraction(paper, 100), found)


def _prose() -> Iterator[PaperClaim]:
    yield PaperClaim(
        id="prose.no-recovery-alone",
        places=("Section 2.1",),
        says="Without assistance a status hardly ever goes away by itself (almost probability 1 of "
        "staying).",
        rule="statement",
        find=_recovery,
    )
    yield PaperClaim(
        id="prose.anger-weighs-most-on-forgetfulness",
        places=("Section 2.1.1",),
        says="Confusion, anger and disengagement raise forgetfulness, anger the most.",
        rule="statement",
        find=_anger_on_forgetfulness,
        open=True,
    )
    yield PaperClaim(
        id="prose.anger-contributes-most",
        places=("Section 2.1.1",),
        says="Anger contributes more to the other statuses than they to each other.",
        rule="statement",
        find=_anger_contributes,
        open=True,
    )
    yield PaperClaim(
        id="prose.distress",
        places=("Section 2.1.1",),
        says="Forgetfulness and confusion lead to anger; these three lead to disengagement.",
        rule="statement",
        find=_distress,
        open=True,
    )


def _effect(view: View, source: str, target: str) -> Fraction:
    """Return what a status that is present adds to the chance of another one."""
    bit = BITS[target]
    return marginal(view.mdp, BITS[source], NONE, bit) - marginal(view.mdp, 0, NONE, bit)


def _recovery(view: View) -> Finding:
    leaves = max(1 - marginal(view.mdp, bit, NONE, bit) for bit in BITS.values())
    return statement(
        leaves <= Fraction(1, 100),
        f"a status alone goes away with probability {float(leaves):.0%} at most",
        Certified(value=leaves),
        f"{float(leaves):.0%}",
    )


def _points(effects: dict[str, Fraction]) -> str:
    return ", ".join(f"{name} {float(100 * value):+g}" for name, value in effects.items())


def _anger_on_forgetfulness(view: View) -> Finding:
    sources = ("confusion", "anger", "disengagement")
    effects = {source: _effect(view, source, "forgetfulness") for source in sources}
    others = max(effects["confusion"], effects["disengagement"])
    holds = min(effects.values()) > 0 and effects["anger"] > others
    return statement(holds, f"percentage points: {_points(effects)}")


def _anger_contributes(view: View) -> Finding:
    effects = {
        source: sum((_effect(view, source, t) for t in BITS if t != source), Fraction(0))
        for source in BITS
    }
    rest = max(value for name, value in effects.items() if name != "anger")
    return statement(
        effects["anger"] > rest, f"percentage points on the other three: {_points(effects)}"
    )


def _distress(view: View) -> Finding:
    edges = [("forgetfulness", "anger"), ("confusion", "anger")]
    edges += [(name, "disengagement") for name in ("forgetfulness", "confusion", "anger")]
    effects = {f"{a} on {b}": _effect(view, a, b) for a, b in edges}
    return statement(min(effects.values()) > 0, f"percentage points: {_points(effects)}")


# ---- assistance and skipping -------------------------------------------------------------------


def _assistance() -> Iterator[PaperClaim]:
    for action, stays in reported.ASSISTANCE.items():
        for status, per_cent in stays.items():
            for kind, paper, now in (("persistence", per_cent, True), ("onset", 0, False)):
                present = "present" if now else "absent"
                yield _per_cent(
                    f"assistance.{action}.{status}.{kind}",
                    f"{status.capitalize()} next under {action} assistance, where it is {present}.",
                    paper,
                    (BITS[status] if now else 0, reported.ACTIONS.index(action), status),
                    places=("Section 2.1.2",),
                )
    yield PaperClaim(
        id="assistance.rest",
        places=("Section 2.1.2",),
        says="Statuses that an assistance does not name move as without assistance.",
        rule="statement",
        find=_rest,
    )


def _rest(view: View) -> Finding:
    compared = wrong = 0
    for number, action in enumerate(reported.ACTIONS):
        named = reported.ASSISTANCE.get(action, {})
        for status in set(BITS) - set(named):
            for vector in range(16):
                alone = marginal(view.mdp, vector, NONE, BITS[status])
                wrong += marginal(view.mdp, vector, number, BITS[status]) != alone
                compared += 1
    return statement(wrong == 0, f"{compared - wrong} of {compared} probabilities are the same")


def _skip() -> Iterator[PaperClaim]:
    pair = {"forgetfulness": "confusion", "confusion": "forgetfulness"}
    for status, bit in BITS.items():
        for kind, paper in reported.SKIP[status].items():
            vector = bit | (BITS[pair[status]] if kind == "with-other" else 0)
            with_other = f" together with {pair[status]}" if kind == "with-other" else ""
            yield PaperClaim(
                id=f"skip.{status}.{kind}",
                places=("Section 2.1.3",),
                says=f"{status.capitalize()}{with_other} persists when a subtask is skipped.",
                rule="entry",
                paper=Fraction(paper, 100),
                unit="%",
                find=partial(_skipped, vector=vector, bit=bit, paper=Fraction(paper, 100)),
                open=True,
            )


def _skipped(view: View, *, vector: int, bit: int, paper: Fraction) -> Finding:
    trial = view.scenario.trials
    return entry(paper, marginal(view.skip_model, vector, NONE, bit, trial=trial))


# ---- spaces ------------------------------------------------------------------------------------


def _spaces() -> Iterator[PaperClaim]:
    yield PaperClaim(
        id="states.statuses",
        places=("Section 3.2.1",),
        says="Four binary statuses make 16 status vectors.",
        rule="entry",
        paper=Fraction(16),
        find=lambda view: entry(Fraction(16), Fraction(view.mdp.space.column("status").size)),
    )
    yield PaperClaim(
        id="states.start",
        places=("Section 3.2.1",),
        says="An episode starts with none of the four statuses present.",
        rule="statement",
        find=_start,
    )
    yield PaperClaim(
        id="states.end",
        places=("Section 3.2.1",),
        says="An episode ends when every subtask is completed or skipped.",
        rule="statement",
        find=_end,
    )
    yield PaperClaim(
        id="actions.max-trial",
        places=("Section 3.2.2", "Section 2.1"),
        says="A subtask is skipped after 5 trials (MaxTrial).",
        rule="entry",
        paper=Fraction(5),
        find=_max_trial,
        open=True,
    )


def _start(view: View) -> Finding:
    label = " and ".join(view.mdp.space.label(state) for state, _ in view.mdp.start)
    return statement("status 0000" in label, f"the start is {label}")


def _end(view: View) -> Finding:
    from exact_mdp.mdp.chain import is_acyclic

    mdp = view.mdp
    ends = [mdp.space.label(state) for state in range(mdp.n_states) if mdp.terminal[state]]
    steps = sum(view.scenario.tasks) * (view.scenario.trials + 1)
    return statement(
        is_acyclic(mdp) and len(ends) == 1,
        f"no state can come again and only the state “{ends[0]}” is terminal, so that every "
        f"episode ends within {steps} timesteps",
    )


def _max_trial(view: View) -> Finding:
    after = view.scenario.trials
    return entry(Fraction(5), Fraction(after), f"a subtask is skipped on failed trial {after}")


# ---- rewards -----------------------------------------------------------------------------------


def _rewards() -> Iterator[PaperClaim]:
    yield PaperClaim(
        id="equation1",
        places=("Equation 1", "Section 3.2.3"),
        says="The immediate reward is the weighted sum of statuses, trial, completion, assistance, "
        "timestep and task completion.",
        rule="statement",
        find=_equation_1,
    )
    for weight, paper in reported.TABLE_4.items():
        yield PaperClaim(
            id=f"table4.{weight}",
            places=("Table 4",),
            says=f"Weight {weight}.",
            rule="entry",
            paper=Fraction(paper),
            find=partial(_weight, weight=weight, paper=paper),
        )
    yield PaperClaim(
        id="prose.minimal-assistance",
        places=("Section 3.2.3",),
        says="Completing a subtask costs more, the more intrusive the assistance.",
        rule="statement",
        find=_minimal,
    )
    yield PaperClaim(
        id="prose.anger-first",
        places=("Section 3.2.3",),
        says="Anger is charged most of the four statuses.",
        rule="statement",
        find=_anger_first,
    )


def _equation_1(view: View) -> Finding:
    """Hold every visible outcome of the compiled model against Equation 1, written out anew."""
    w, size, last = reported.TABLE_4, 0, set()
    for count in view.scenario.tasks:
        size += count
        last.add(size - 1)
    checked = wrong = 0
    for action, _, after, subtask, done, _, gain in gains(view.mdp, view.scenario.trials):
        costs = sum(
            w[name] for name, bit in zip(CHARGED, BITS.values(), strict=True) if after & bit
        )
        total = costs + w["trial"] + w["timestep"]
        if done:
            total += w["subtask-complete"] + w[f"assist.{reported.ACTIONS[action]}"]
            total += w["task-complete"] if subtask in last else 0
        checked += 1
        wrong += gain != total
    return statement(
        wrong == 0, f"{checked - wrong:,} of {checked:,} outcomes earn what the equation gives"
    )


def _weight(view: View, *, weight: str, paper: int) -> Finding:
    held = {parameter.name: parameter.value for parameter in view.mdp.parameters}
    return entry(Fraction(paper), held[f"reward.{weight}"])


def _held(view: View, names: list[str]) -> list[Fraction]:
    held = {parameter.name: parameter.value for parameter in view.mdp.parameters}
    return [held[f"reward.{name}"] for name in names]


def _minimal(view: View) -> Finding:
    found = _held(view, [f"assist.{action}" for action in reported.ACTIONS])
    falls = all(a > b for a, b in pairwise(found))
    return statement(falls, "a0 to a3: " + ", ".join(str(value) for value in found))


def _anger_first(view: View) -> Finding:
    anger, *rest = _held(view, ["anger", "forget", "confuse", "disengaged"])
    return statement(anger < min(rest), f"anger {anger}, the others {', '.join(map(str, rest))}")


def _per_cent(
    name: str,
    says: str,
    paper: int,
    row: tuple[int, int, str],
    places: tuple[str, ...] = ("Table 3",),
) -> PaperClaim:
    vector, action, status = row

    def find(view: View) -> Finding:
        return entry(Fraction(paper, 100), marginal(view.mdp, vector, action, BITS[status]))

    return PaperClaim(
        id=name,
        places=places,
        says=says,
        rule="entry",
        paper=Fraction(paper, 100),
        unit="%",
        find=find,
    )
