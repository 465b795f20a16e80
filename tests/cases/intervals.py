"""Published interval MDPs with their answers, in exact rationals; nothing of the project here."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

F, ONE = Fraction, Fraction(1)
Outcome = tuple[Fraction, Fraction, int, Fraction]  # lower, upper, next state, reward
Game = tuple[str, str]  # objective, nature
STORM = (
    "moves-rwth/storm resources/examples/testfiles/imdp/{}; "
    "RobustMdpModelCheckerTest.cpp / RobustMDPModelCheckingTest"
)


@dataclass(frozen=True, kw_only=True, eq=False)
class IntervalCase:
    """An interval MDP and published values of its states, by who chooses and who resolves.

    Published decimals hold within `tolerance`; where it is 0 they are exact.
    """

    name: str
    source: str
    rows: tuple[tuple[int, int, Sequence[Outcome]], ...]
    values: Mapping[Game, Mapping[int, Fraction]]
    discount: Fraction = ONE
    tolerance: float = 0.0
    start: int = 0

    def __str__(self) -> str:
        return self.name


def rows(text: str) -> tuple[tuple[int, int, Sequence[Outcome]], ...]:
    """Read the rows of intervals.toml."""
    listed = []
    for line in filter(None, map(str.strip, text.splitlines())):
        head, _, tail = line.partition(":")
        outcomes = []
        for words in (part.split() for part in tail.split(",")):
            low, high, to, *reward = words if len(words) > 2 else ["1", "1", *words]
            outcomes.append((F(low), F(high), int(to), F(reward[0] if reward else 0)))
        state, action = map(int, head.split())
        listed.append((state, action, outcomes))
    return tuple(listed)


def games(values: Mapping[str, Mapping[str, str]]) -> dict[Game, dict[int, Fraction]]:
    return {
        (game[:3], game[4:]): {int(state): F(value) for state, value in own.items()}
        for game, own in values.items()
    }


LISTED = {
    name: IntervalCase(
        name=name,
        source=STORM.format(spec["source"]) if name.startswith("storm") else spec["source"],
        rows=rows(spec["rows"]),
        values=games(spec["values"]),
        discount=F(spec.get("discount", 1)),
        tolerance=spec.get("tolerance", 0.0),
        start=spec.get("start", 0),
    )
    for name, spec in tomllib.loads(Path(__file__).with_suffix(".toml").read_text("utf-8")).items()
}


def total_reward(discount: Fraction) -> IntervalCase:
    """The model of PRISM's test of total rewards; its values are those of discount 9/10."""
    return replace(LISTED["prism-total-reward"], discount=discount)


def robot_prism(delta: Fraction, *, time: bool) -> IntervalCase:
    """The probability of goal1, or the expected time to either goal; answers are closed forms."""
    p, q = F(1, 2) - delta, F(1, 2) + delta
    step, gain = (1, 1) if time else (0, 1)  # of a step, and of that to the goal
    text = f"""
        0 0: .6 .6 1 {step}, .4 .4 0 {step}
        0 1: .8 .8 3 {step}, .1 .1 1 {step}, .1 .1 4 {step}
        1 0: .8 .9 2 {step}, .1 .2 1 {step}
        1 1: {p} {q} 4 {step}, {1 - q} {1 - p} 2 {step}
        2 0: 2
        3 0: 3
        4 0: 1 1 5 {gain}
        4 1: .6 .6 3 {step}, .4 .4 4 {step}
        5 0: 5
        """
    chance = {("max", "worst"): {0: max(p, F(1, 10) + p / 10)}, ("max", "best"): {0: q}}
    least = min(F(109, 90), F(6, 5) + p / 10)
    times = {("min", "best"): {0: least}, ("min", "worst"): {0: F(98, 80)}}
    return IntervalCase(
        name=f"prism-robot-{'time' if time else 'goal1'}-{float(delta)}",
        source="prismmodelchecker/prism prism-tests/functionality/verify/imdps/robot.prism(.props)",
        rows=rows(text),
        values=times if time else chance,
    )


INTERVAL_CASES = (
    *LISTED.values(),
    *(robot_prism(F(d), time=t) for d in ("1/10", "2/5", "1/4") for t in (False, True)),
)
