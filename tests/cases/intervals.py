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


def outcome(low: object, high: object, to: int, reward: object = 0) -> Outcome:
    return F(str(low)), F(str(high)), to, F(str(reward))


def sure(to: int, reward: object = 0) -> list[Outcome]:
    return [outcome(1, 1, to, reward)]


def games(*values: object, state: int = 0) -> dict[Game, dict[int, Fraction]]:
    """Answers in the order of Storm's tests: robust max, cooperative max, robust min, coop. min."""
    order = (ROBUST_MAX, COOPERATIVE_MAX, ROBUST_MIN, COOPERATIVE_MIN)
    return {game: {state: F(str(v))} for game, v in zip(order, values, strict=True)}


STORM = "moves-rwth/storm resources/examples/testfiles/imdp"
STORM_TESTS = "RobustMdpModelCheckerTest.cpp / RobustMDPModelCheckingTest"


def tiny_01() -> IntervalCase:
    return IntervalCase(
        name="storm-tiny-01",
        source=f"{STORM}/tiny-01.drn; {STORM_TESTS}, Tiny01maxmin",
        rows=(
            (0, 0, [outcome("0.4", "0.9", 1, 1), outcome("0.5", "0.8", 2)]),
            (1, 0, sure(1)),
            (2, 0, sure(2)),
        ),
        discount=F(1),
        values=games("0.4", "0.5", "0.5", "0.4"),
    )


def tiny_03() -> IntervalCase:
    row = [outcome("0.4", "0.9", 1, 1), outcome("0.5", "0.8", 2)]
    return IntervalCase(
        name="storm-tiny-03",
        source=f"{STORM}/tiny-03.drn; {STORM_TESTS}, Tiny03maxmin",
        rows=((0, 0, row), (0, 1, row), (1, 0, sure(1)), (2, 0, sure(2))),
        discount=F(1),
        values=games("0.4", "0.5", "0.5", "0.4"),
    )


def tiny_04() -> IntervalCase:
    """The self loop in state 1 goes to state 5 instead: whoever stays for ever earns nothing."""
    row = [outcome("0.4", "0.9", 3, 1), outcome("0.5", "0.8", 4)]
    return IntervalCase(
        name="storm-tiny-04",
        source=f"{STORM}/tiny-04.drn; {STORM_TESTS}, Tiny04maxmin",
        rows=(
            (
                0,
                0,
                [outcome("0.4", "0.4", 1), outcome("0.3", "0.3", 2), outcome("0.1", "0.6", 3, 1)],
            ),
            (1, 0, sure(5)),
            (1, 1, sure(2)),
            (2, 0, row),
            (2, 1, row),
            (2, 2, sure(0)),
            (3, 0, sure(3)),
            (4, 0, sure(4)),
            (5, 0, sure(5)),
        ),
        discount=F(1),
        values=games(1, 1, "0.42857", "0.42"),
        tolerance=1e-4,
    )


def tiny_05() -> IntervalCase:
    return IntervalCase(
        name="storm-tiny-05",
        source=f"{STORM}/tiny-05.drn; {STORM_TESTS}, Tiny05maxmin",
        rows=(
            (0, 0, sure(0)),
            (1, 0, sure(1)),
            (2, 0, [outcome("0.3", "0.4", 0, 1), outcome("0.4", "0.9", 1)]),
        ),
        discount=F(1),
        values=games("0.3", "0.4", "0.4", "0.3", state=2),
        start=2,
    )


def robot_storm() -> IntervalCase:
    """Reaching goal2 at δ = 0.1; states 4 and 5 form a loop and are one state here, 4."""
    p, q = F("0.4"), F("0.6")
    return IntervalCase(
        name="storm-robot-goal2",
        source=f"{STORM}/robot.prism, after prismmodelchecker/prism prism-examples/imdps/simple; "
        f"{STORM_TESTS}, RobotMinMaxTest",
        rows=(
            (0, 0, [outcome("0.6", "0.6", 1), outcome("0.4", "0.4", 0)]),
            (0, 1, [outcome("0.8", "0.8", 2, 1), *(outcome("0.1", "0.1", to) for to in (1, 4))]),
            (1, 0, [outcome("0.8", "0.9", 2, 1), outcome("0.1", "0.2", 1)]),
            (1, 1, [(p, q, 4, F(0)), (1 - q, 1 - p, 2, F(1))]),
            (2, 0, sure(2)),
            (3, 0, sure(3)),
            (4, 0, [outcome("0.6", "0.6", 2, 1), outcome("0.4", "0.4", 4)]),
            (4, 1, [outcome("0.9", "0.9", 2, 1), outcome("0.1", "0.1", 4)]),
            (4, 2, sure(3)),  # going round for ever
        ),
        discount=F(1),
        values=games(1, 1, "0.6", "0.4"),
        tolerance=1e-6,
    )


def robot_prism(delta: Fraction, *, time: bool) -> IntervalCase:
    """The probability of goal1, or the expected time to either goal; answers are closed forms."""
    p, q = F(1, 2) - delta, F(1, 2) + delta
    gain, step = (F(0), F(1)) if time else (F(1), F(0))

    def move(low: object, high: object, to: int) -> Outcome:
        return F(str(low)), F(str(high)), to, step + (gain if to == 5 else 0)

    rows = (
        (0, 0, [move("0.6", "0.6", 1), move("0.4", "0.4", 0)]),
        (0, 1, [move("0.8", "0.8", 3), move("0.1", "0.1", 1), move("0.1", "0.1", 4)]),
        (1, 0, [move("0.8", "0.9", 2), move("0.1", "0.2", 1)]),
        (1, 1, [move(p, q, 4), move(1 - q, 1 - p, 2)]),
        (2, 0, sure(2)),
        (3, 0, sure(3)),
        (4, 0, [move(1, 1, 5)]),
        (4, 1, [move("0.6", "0.6", 3), move("0.4", "0.4", 4)]),
        (5, 0, sure(5)),
    )
    if time:
        values = {
            COOPERATIVE_MIN: {0: min(F(109, 90), F(6, 5) + p / 10)},
            ROBUST_MIN: {0: F(98, 80)},
        }
    else:
        values = {ROBUST_MAX: {0: max(p, F(1, 10) + p / 10)}, COOPERATIVE_MAX: {0: q}}
    return IntervalCase(
        name=f"prism-robot-{'time' if time else 'goal1'}-{float(delta)}",
        source="prismmodelchecker/prism prism-tests/functionality/verify/imdps/robot.prism(.props)",
        rows=rows,
        discount=F(1),
        values=values,
    )


def total_reward(discount: Fraction) -> IntervalCase:
    """States 0 and 4; at discount 1 state 2 earns 5 for ever, so that values are infinite."""
    both = (F("0.3"), F("0.7"))

    def fork(*ends: tuple[int, int]) -> list[Outcome]:
        return [(*both, to, F(gain)) for to, gain in ends]

    return IntervalCase(
        name=f"prism-total-reward-{discount}",
        source="prismmodelchecker/prism "
        "prism-tests/functionality/verify/imdps/imdp_total_reward.prism(.props)",
        rows=(
            (0, 0, sure(1, 100)),
            (0, 1, fork((2, 1), (3, 1))),
            (0, 2, sure(4)),
            (1, 0, sure(1)),
            (2, 0, sure(2, 5)),
            (3, 0, sure(3)),
            (4, 0, fork((5, 0), (6, 0))),
            (5, 0, sure(7, 2000)),
            (6, 0, sure(7, 10_000)),
            (7, 0, sure(7)),
        ),
        discount=discount,
        values={
            COOPERATIVE_MIN: {0: F("14.5"), 4: F(3960)},
            ROBUST_MIN: {0: F("32.5"), 4: F(6840)},
            ROBUST_MAX: {0: F(3564), 4: F(3960)},
            COOPERATIVE_MAX: {0: F(6156), 4: F(6840)},
        },
    )


def one_backup() -> IntervalCase:
    """A Bellman backup of V = (1, 2, 3); states 3 to 5 are where the step leads, worth nothing."""

    def row(*bounds: tuple[object, object]) -> list[Outcome]:
        return [outcome(low, high, 3 + k, k + 1) for k, (low, high) in enumerate(bounds)]

    return IntervalCase(
        name="interval-mdp-jl-backup",
        source="Zinoex/IntervalMDP.jl test/base/imdp.jl, testset bellman",
        rows=(
            (0, 0, row((0, "0.5"), ("0.1", "0.6"), ("0.2", "0.7"))),
            (0, 1, row(("0.5", "0.7"), ("0.3", "0.5"), ("0.1", "0.3"))),
            (1, 0, row(("0.1", "0.6"), ("0.2", "0.5"), ("0.3", "0.4"))),
            (1, 1, row(("0.2", "0.6"), ("0.3", "0.5"), ("0.4", "0.4"))),
            (2, 0, [outcome(1, 1, 5, 3)]),
            *((state, 0, sure(state)) for state in (3, 4, 5)),
        ),
        discount=F(1),
        values={ROBUST_MAX: {0: F("1.7"), 1: F("2.1"), 2: F(3)}},
    )


INTERVAL_CASES = (
    tiny_01(),
    tiny_03(),
    tiny_04(),
    tiny_05(),
    robot_storm(),
    *(robot_prism(F(d), time=t) for d in ("1/10", "2/5", "1/4") for t in (False, True)),
    total_reward(F(9, 10)),
    one_backup(),
)
