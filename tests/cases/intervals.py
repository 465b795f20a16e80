"""Published interval MDPs with their answers, in exact rationals; nothing of the project here."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

F = Fraction
Outcome = tuple[Fraction, Fraction, int, Fraction]  # lower, upper, next state, reward
Game = tuple[str, str]  # objective, nature

ROBUST_MAX, COOPERATIVE_MAX = ("max", "worst"), ("max", "best")
ROBUST_MIN, COOPERATIVE_MIN = ("min", "worst"), ("min", "best")


@dataclass(frozen=True, kw_only=True, eq=False)
class IntervalCase:
    """An interval MDP and published values of its states, by who chooses and who resolves.

    Published decimals hold within `tolerance`; where it is 0 they are exact.
    """

    name: str
    source: str
    rows: tuple[tuple[int, int, Sequence[Outcome]], ...]
    discount: Fraction
    values: Mapping[Game, Mapping[int, Fraction]]
    tolerance: float = 0.0
    start: int = 0

    def __str__(self) -> str:
        return self.name


def rows(text: str) -> tuple[tuple[int, int, Sequence[Outcome]], ...]:
    """Rows of "state action: outcome, …", each "low high next reward", the reward perhaps left out.

    An outcome of one number, or of two, is certain: the next state, and perhaps a reward.
    """
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


def games(*values: object, state: int = 0) -> dict[Game, dict[int, Fraction]]:
    """Answers in the order of Storm's tests: robust max, cooperative max, robust min, coop. min."""
    order = (ROBUST_MAX, COOPERATIVE_MAX, ROBUST_MIN, COOPERATIVE_MIN)
    return {game: {state: F(str(v))} for game, v in zip(order, values, strict=True)}


def storm(
    number: str, text: str, *answers: object, state: int = 0, near: float = 0.0
) -> IntervalCase:
    return IntervalCase(
        name=f"storm-tiny-{number}",
        source=f"moves-rwth/storm resources/examples/testfiles/imdp/tiny-{number}.drn; "
        f"RobustMdpModelCheckerTest.cpp / RobustMDPModelCheckingTest, Tiny{number}maxmin",
        rows=rows(text),
        discount=F(1),
        values=games(*answers, state=state),
        tolerance=near,
        start=state,
    )


FORK = ".4 .9 1 1, .5 .8 2"
# In the fourth, the self loop of state 1 goes to state 5: whoever stays for ever earns nothing.
TINY = (
    storm("01", f"0 0: {FORK}\n1 0: 1\n2 0: 2", ".4", ".5", ".5", ".4"),
    storm("03", f"0 0: {FORK}\n0 1: {FORK}\n1 0: 1\n2 0: 2", ".4", ".5", ".5", ".4"),
    storm(
        "04",
        """
        0 0: .4 .4 1, .3 .3 2, .1 .6 3 1
        1 0: 5
        1 1: 2
        2 0: .4 .9 3 1, .5 .8 4
        2 1: .4 .9 3 1, .5 .8 4
        2 2: 0
        3 0: 3
        4 0: 4
        5 0: 5
        """,
        *(1, 1, "0.42857", "0.42"),
        near=1e-4,
    ),
    storm("05", "0 0: 0\n1 0: 1\n2 0: .3 .4 0 1, .4 .9 1", ".3", ".4", ".4", ".3", state=2),
)


def robot_storm() -> IntervalCase:
    """Reaching goal2 at δ = 0.1; states 4 and 5 form a loop and are one state here, 4."""
    return IntervalCase(
        name="storm-robot-goal2",
        source="moves-rwth/storm resources/examples/testfiles/imdp/robot.prism, after "
        "prismmodelchecker/prism prism-examples/imdps/simple; "
        "RobustMdpModelCheckerTest.cpp / RobustMDPModelCheckingTest, RobotMinMaxTest",
        rows=rows(  # the last but one: going round for ever
            """
            0 0: .6 .6 1, .4 .4 0
            0 1: .8 .8 2 1, .1 .1 1, .1 .1 4
            1 0: .8 .9 2 1, .1 .2 1
            1 1: .4 .6 4, .4 .6 2 1
            2 0: 2
            3 0: 3
            4 0: .6 .6 2 1, .4 .4 4
            4 1: .9 .9 2 1, .1 .1 4
            4 2: 3
            """
        ),
        discount=F(1),
        values=games(1, 1, "0.6", "0.4"),
        tolerance=1e-6,
    )


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
    chance = {ROBUST_MAX: {0: max(p, F(1, 10) + p / 10)}, COOPERATIVE_MAX: {0: q}}
    least = min(F(109, 90), F(6, 5) + p / 10)
    return IntervalCase(
        name=f"prism-robot-{'time' if time else 'goal1'}-{float(delta)}",
        source="prismmodelchecker/prism prism-tests/functionality/verify/imdps/robot.prism(.props)",
        rows=rows(text),
        discount=F(1),
        values={COOPERATIVE_MIN: {0: least}, ROBUST_MIN: {0: F(98, 80)}} if time else chance,
    )


def total_reward(discount: Fraction) -> IntervalCase:
    """States 0 and 4; at discount 1 state 2 earns 5 for ever, so that values are infinite."""
    return IntervalCase(
        name=f"prism-total-reward-{discount}",
        source="prismmodelchecker/prism "
        "prism-tests/functionality/verify/imdps/imdp_total_reward.prism(.props)",
        rows=rows(
            """
            0 0: 1 100
            0 1: .3 .7 2 1, .3 .7 3 1
            0 2: 4
            1 0: 1
            2 0: 2 5
            3 0: 3
            4 0: .3 .7 5, .3 .7 6
            5 0: 7 2000
            6 0: 7 10000
            7 0: 7
            """
        ),
        discount=discount,
        values={
            COOPERATIVE_MIN: {0: F("14.5"), 4: F(3960)},
            ROBUST_MIN: {0: F("32.5"), 4: F(6840)},
            ROBUST_MAX: {0: F(3564), 4: F(3960)},
            COOPERATIVE_MAX: {0: F(6156), 4: F(6840)},
        },
    )


# A Bellman backup of V = (1, 2, 3); states 3 to 5 are where the step leads, worth nothing.
ONE_BACKUP = IntervalCase(
    name="interval-mdp-jl-backup",
    source="Zinoex/IntervalMDP.jl test/base/imdp.jl, testset bellman",
    rows=rows(
        """
        0 0: 0 .5 3 1, .1 .6 4 2, .2 .7 5 3
        0 1: .5 .7 3 1, .3 .5 4 2, .1 .3 5 3
        1 0: .1 .6 3 1, .2 .5 4 2, .3 .4 5 3
        1 1: .2 .6 3 1, .3 .5 4 2, .4 .4 5 3
        2 0: 5 3
        3 0: 3
        4 0: 4
        5 0: 5
        """
    ),
    discount=F(1),
    values={ROBUST_MAX: {0: F("1.7"), 1: F("2.1"), 2: F(3)}},
)

INTERVAL_CASES = (
    *TINY,
    robot_storm(),
    *(robot_prism(F(d), time=t) for d in ("1/10", "2/5", "1/4") for t in (False, True)),
    total_reward(F(9, 10)),
    ONE_BACKUP,
)
