"""Random models with names, labels and numbers of every kind, to be saved and read again."""

from __future__ import annotations

from hypothesis import strategies as st

from exact_mdp import MDP, Column, StateSpace

NAMES = st.text(
    st.characters(exclude_categories=("Cs", "Cc", "Cf", "Zl", "Zp", "Cn")), min_size=1, max_size=9
)

NUMBERS = st.one_of(
    st.fractions(),
    st.integers(-(10**60), 10**60),
    st.floats(-1e300, 1e300),
    st.sampled_from([0.0, -0.0, 5e-324, -5e-324, 2.2250738585072014e-308, 1e-310, 0.1]),
)


@st.composite
def models(draw: st.DrawFn) -> MDP:
    """Draw a model of exact numbers, of floats, or of both, with names and a start."""
    share = draw(st.one_of(st.fractions(0, 1), st.fractions(0, 1, max_denominator=2**200)))
    chances = draw(st.sampled_from([(0.5, 0.5), (0.1, 0.9), ("1/2", 0.5), (share, 1 - share)]))
    size = draw(st.integers(1, 4))
    rows = []
    for state in range(size):
        for action in range(draw(st.integers(1, 2))):
            then = draw(st.integers(0, size - 1))
            listed = [(chances[0], state, draw(NUMBERS)), (chances[1], then, draw(NUMBERS))]
            rows.append((state, action, listed))
    words = draw(st.lists(NAMES, min_size=size, max_size=size, unique=True))
    return MDP.from_outcomes(
        rows,
        draw(st.fractions(0, 1)),
        start=["1/3", *[0] * (size - 2), "2/3"] if size > 1 else None,
        actions=draw(st.lists(NAMES, min_size=2, max_size=2, unique=True)),
        space=StateSpace(columns=(Column(name=draw(NAMES), size=size, words=tuple(words)),)),
        name=draw(NAMES),
        component_names=(draw(NAMES),),
        sense=draw(st.sampled_from(["max", "min"])),
        labels=draw(
            st.dictionaries(
                NAMES, st.lists(st.booleans(), min_size=size, max_size=size), max_size=3
            )
        ),
    )
