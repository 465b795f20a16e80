"""The numbers of the handwashing assistant, each with its source: published, or ours.

What was to be had is the reduced model, whole: its tables stand in problems/handwashing/cppo3.txt
of Symbolic Perseus (P. Poupart, 2007), of which two public copies agree (GitHub: pjdrm/Symbolic-
Perseus---Student-Modeling-AAMAS-15- and, as MOhandwashing.dat, kucars/symbolic_perseus). Of the
full model (J. Boger, P. Poupart, J. Hoey, C. Boutilier, G. Fernie and A. Mihailidis, IJCAI 2005,
1293-1299) the package's problems/README gives 50,181,120 states, 20 actions and 12 observations;
its tables were not to be had. Three levels of prompts for each step: A. Mihailidis, J. N. Boger,
T. Craig and J. Hoey, BMC Geriatrics 8:28, 2008, table 1, version 2. What is ours is a choice, made
so that each factor matters and one size gives the published count; vary it before resting on it.

Plan steps: a, nothing done; b, water on; c, hands wet; d, soapy; e, soapy with the water off;
g, rinsed; h, rinsed with the water off; j, dry with the water on; k, done.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction

FILE = "cppo3.txt"
OURS = "ours"


@dataclass(frozen=True, kw_only=True)
class Number:
    """One number of the model: where it comes from, and what it is.

    `moves` says what it is a number of: a "reward" moves values in a straight line, a "weight"
    moves probabilities as a quotient does.
    """

    name: str
    value: Fraction
    source: str
    moves: str
    about: str


def _numbers(text: str, source: str) -> list[Number]:
    """Return the numbers of lines "name value moves about"."""
    rows = (line.split(maxsplit=3) for line in text.strip().splitlines())
    return [
        Number(name=name, value=Fraction(value), source=source, moves=moves, about=about)
        for name, value, moves, about in rows
    ]


NUMBERS: Mapping[str, Number] = {
    number.name: number
    for number in (
        *_numbers(
            """
discount        9/10  reward  of the reduced model; the full one takes it over
reward.start    0     reward  each step in plan step a
reward.underway 1/5   reward  each step in b, c, d, e, g, h
reward.dried    1     reward  each step in j
reward.done     20    reward  each step in k
cost.aware      4/5   reward  of a prompt to a user who is aware
cost.unaware    1/5   reward  of a prompt to a user who is not
weight.any      2     weight  of every behaviour of an aware user
weight.right    1     weight  added where the behaviour is right at the plan step
weight.nothing  1/2   weight  of doing nothing, of a user who is not aware
weight.other    1/10  weight  of each other behaviour of that user
weight.prompted 2     weight  added to what a prompt asks for, where the user responds
""",
            FILE,
        ),
        *_numbers(
            """
cost.caregiver   6    reward  of calling a caregiver, who sees to the right behaviour
cost.repeat      1/5  reward  of a prompt for what the user has just done
price.minimal    1/2  reward  price of a minimal prompt, in prompts of the published kind
price.maximal    2    reward  price of a maximal prompt
price.each       1/20 reward  by how much each prompt so far makes the next one dearer
effect.minimal   1/2  weight  effect of a minimal prompt; a moderate one has the published effect
effect.maximal   3/2  weight  effect of a maximal prompt
effect.ignored   1/16 weight  share of the effect lost for each prompt ignored in a row
effect.repeated  1/8  weight  share of the effect lost for each repetition in a row
nothing.mild     1/2  weight  factor of doing nothing in mild dementia; moderate is as published
nothing.severe   2    weight  factor of doing nothing in severe dementia
nothing.waited   1/10 weight  by how much each step of waiting makes doing nothing likelier
""",
            OURS,
        ),
    )
}
"""Every number of the models by name, published or ours."""

BEHAVIOURS = ("nothing", "wet", "taps", "soap", "dry")
STEPS = "abcdeghjk"
NEXT = ("aabea", "bcbdb", "cccdb", "dgddb", "eedeb", "gghdj", "hhgek", "jgkdj", "kkjek")
"""The plan step (cppo3.txt) that each behaviour leads to, by plan step."""
RIGHT = ("taps soap", "wet soap", "soap", "wet", "taps", "taps dry", "dry", "taps", "nothing")
"""The behaviours that are right in each plan step (cppo3.txt); a caregiver sees to the first."""
EARNED = ("start", *("underway",) * 6, "dried", "done")
PROMPTS = {
    "wet_hands": "wet",
    "turnon_water": "taps",
    "turnoff_water": "taps",
    "use_soap": "soap",
    "dry_hands": "dry",
}
"""The prompts of cppo3.txt, and the behaviour that each asks for."""
RINSE = {"rinse_hands": "wet"}  # ours: the sixth prompt, so that 6 · 3 + 2 = 20 actions
LEVELS = ("minimal", "moderate", "maximal")  # published: three levels for each step (version 2)
DEMENTIA = ("mild", "moderate", "severe")
