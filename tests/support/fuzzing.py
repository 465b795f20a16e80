"""Ways to spoil a valid file, and what a reader may then do: return an object, or ModelError."""

from __future__ import annotations

from collections.abc import Callable

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from exact_mdp.mdp import MDP, ModelError, Scenario

SMALL = Scenario.load("yuan2025").with_(tasks=[1], max_trial=1)
CARE = SMALL.compile()
STATUSES = [format(number, "04b") for number in range(16)]
TOY = MDP.from_outcomes(
    [(0, 0, [("1/3", 0, 1), ("2/3", 1, "1/7")]), (0, 1, [(1, 1, 5)]), (1, 0, [(1, 1, 0)])],
    "9/10", name="toy", states=["here", "there"], actions=["stay", "go"],
)  # fmt: skip

EXAMPLES = 120
fuzz = settings(
    max_examples=EXAMPLES,
    deadline=None,
    suppress_health_check=[HealthCheck.too_slow, HealthCheck.function_scoped_fixture],
)


@st.composite
def spoiled(draw: st.DrawFn, content: bytes) -> bytes:
    """The content after one to four cuts, copies, insertions and changes of bytes."""
    data = bytearray(content)
    for _ in range(draw(st.integers(1, 4))):
        first = draw(st.integers(0, len(data)))
        last = draw(st.integers(first, min(len(data), first + draw(st.sampled_from([1, 4, 60])))))
        match draw(st.sampled_from(["change", "cut", "copy", "insert", "end"])):
            case "change":
                data[first:last] = draw(st.binary(min_size=last - first, max_size=last - first))
            case "cut":
                del data[first:last]
            case "copy":
                place = draw(st.integers(0, len(data)))
                data[place:place] = data[first:last]
            case "insert":
                data[first:first] = draw(st.binary(max_size=12))
            case "end":
                del data[first:]
    return bytes(data)


def survives(read: Callable[[], object]) -> bool:
    """True where reading gives an object, False where it is refused in so many words."""
    try:
        read()
    except ModelError:
        return False
    return True


AWKWARD = [
    *(
        "none",
        "skip",
        "",
        " none",
        "0000",
        "1/0",
        "-1",
        "1e400",
        "nan",
        "\0",
        '"',
        "😀",
        "9" * 5000,
    ),
    *("0110", "2", "0.5", "status", "action", "1e9999999999", "none\n", "=1", "٣"),
]
json_values = st.recursive(
    st.one_of(
        st.none(), st.booleans(), st.integers(), st.floats(), st.sampled_from(AWKWARD), st.text()
    ),
    lambda inner: st.one_of(
        st.lists(inner, max_size=3),
        st.dictionaries(
            st.sampled_from(["none", "directive", "x", ""]) | st.text(max_size=3), inner, max_size=3
        ),
    ),
    max_leaves=5,
)
