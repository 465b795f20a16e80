"""Exchange with Storm: models as DRN, its explicit text format.

    @type: MDP                          sections of the head, each once
    @value_type: rational
    @reward_models
    cost steps
    @nr_states
    2
    @nr_choices
    2
    @model
    state 0 [0, 1/3] init               rewards of the state, then labels
        action go [5/2, 0]              rewards of the choice
            0 : 1/3                     next state : probability
            1 : 2/3
    state 1 [0, 0] goal "far away"
        action stay [0, 0]
            1 : 1

Numbers of a file of value type `rational`, or of none, are what they say; those of `double` are
floats. Storm writes what its variables are in a state as a comment behind it, `//[x=1 & ...]`: that
is the state's name. A chain (`DTMC`) has one choice in each state.

What is written is exact: rationals where the model's numbers are, else the shortest decimals that
give the floats back, or the rationals that these are where kinds are mixed. Outcomes to one state
are added up, and rewards are those of choices: expected values stay, returns by outcome do not. The
reward is the model `reward`; components follow, and words have underscores for spaces. A comment
holds the header of `mdp.io.npz` as JSON, so that discount, sense and names come back.

Source of the format: https://www.stormchecker.org/documentation/background/drn.html
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import accumulate
from pathlib import Path
from typing import Any

import numpy as np

from exact_mdp.mdp.errors import ModelError, located, shown_text
from exact_mdp.mdp.io.explicit import INITIAL, REWARD, Explicit, Ratios, actions_of, model_of
from exact_mdp.mdp.io.files import LARGEST, read_text, write_atomically
from exact_mdp.mdp.io.npz import as_header
from exact_mdp.mdp.io.own import component_key, label_key, restored
from exact_mdp.mdp.io.structured import json_of
from exact_mdp.mdp.model import MDP
from exact_mdp.mdp.table import MOST_DIGITS, exact, merged, ones

OURS = "// exact-mdp "
UNNAMED = "__NOLABEL__"
TYPES, VALUES = ("DTMC", "MDP"), ("double", "rational")
LIMIT = 10**MOST_DIGITS
LABELS = re.compile(r'"([^"]+)"|([^\s"]+)')


def load(
    path: str | Path,
    *,
    discount: object | None = None,
    reward: str | None = None,
    start: object = None,
) -> MDP:
    """Read a Markov chain or decision process from a DRN file, else as `mdp.io.umb.load` does."""
    with located(str(path)):
        text = read_text(path, most=LARGEST)
        return of_text(text, path, reward=reward, discount=discount, start=start)


def of_text(text: str, path: str | Path, **options: Any) -> MDP:
    """Return the model of a text in this format, which comes from `path`."""
    found = _Reader(name=Path(path).stem).read(text)
    if found.header is not None:
        return restored(found, found.header, **options)
    return model_of(found, shown_text(str(path)), **options)


@dataclass
class _Reader:
    """What the lines so far say: lists over states, choices and branches."""

    name: str
    head: dict[str, str] = field(default_factory=dict)
    known: dict[str, Any] = field(default_factory=dict)  # placeholders
    header: Mapping[str, Any] | None = None
    choices: list[int] = field(default_factory=list)  # of each state
    branches: list[int] = field(default_factory=list)  # of each choice
    target: list[int] = field(default_factory=list)
    chance: list[Any] = field(default_factory=list)
    action: list[str] = field(default_factory=list)
    of_states: list[list[Any]] = field(default_factory=list)
    of_choices: list[list[Any]] = field(default_factory=list)
    labels: dict[str, list[int]] = field(default_factory=dict)
    words: dict[int, str] = field(default_factory=dict)

    def read(self, text: str) -> Explicit:
        """Return what a file says."""
        lines = enumerate(text.splitlines(), start=1)
        for number, line in self._head(lines):
            try:
                self._line(line.strip())
            except (ValueError, IndexError) as error:
                if isinstance(error, ModelError):
                    raise ModelError(
                        error.what, where=f"line {number}", fix=error.fix or "correct it"
                    ) from error
                raise ModelError(
                    f"{line.strip()[:60]!r} is no part of a model",
                    where=f"line {number}",
                    fix="write 'state NUMBER', 'action NAME' or 'NEXT STATE : PROBABILITY'",
                ) from error
        return self._explicit()

    def _head(self, lines: Iterator[tuple[int, str]]) -> Iterator[tuple[int, str]]:
        """Read the sections up to the model, and yield its lines."""
        section, inside = "", False
        for number, line in lines:
            if line.startswith(OURS) and not inside:
                self.header = json_of(line.removeprefix(OURS), "header")
                if not isinstance(self.header, dict):
                    raise ModelError("the header is not a JSON object", fix="write the file again")
            elif inside:
                yield number, line
            elif line.strip() == "@model":
                inside = True
                self._check_head()
            elif line.startswith("@"):
                section, _, value = line[1:].partition(":")
                section = section.strip()
                if section in self.head:
                    raise ModelError(
                        f"@{section} comes twice", where=f"line {number}", fix="keep one"
                    )
                self.head[section] = value.strip()
            elif section == "placeholders" and ":" in line:
                name, _, value = line.partition(":")
                self.known[name.strip()] = self._number(value.strip())
            elif line.strip() and not line.startswith("//"):
                self.head[section] = f"{self.head.get(section, '')} {line}".strip()
        if not inside:
            raise ModelError("there is no line @model", fix="give a file in Storm's DRN format")

    def _check_head(self) -> None:
        for key, known in (("type", TYPES), ("value_type", VALUES)):
            value = self.head.get(key, known[-1])
            if value not in known:
                raise ModelError(
                    f"@{key} is {value!r}",
                    where="head",
                    fix=f"give {' or '.join(known)}: no continuous time, nothing hidden, no "
                    "intervals, no parameters",
                )

    def _line(self, line: str) -> None:
        if line.startswith("//["):
            if self.choices:
                self.words[len(self.choices) - 1] = re.sub(r"\s+", " ", line[3:].strip("] "))
        elif line.startswith("state "):
            self._state(line)
        elif line.startswith("action "):
            word, _, rest = line.removeprefix("action ").partition(" ")
            self._choice(word, self._rewards(rest)[0])
        elif line and not line.startswith("//"):
            target, colon, chance = line.partition(":")
            if not colon:
                raise ValueError
            if not self.choices[-1]:
                self._choice("0", [])  # a chain's only choice may go without a line
            self.target.append(int(target))
            self.chance.append(self._number(chance.strip()))
            self.branches[-1] += 1

    def _state(self, line: str) -> None:
        number, _, rest = line.removeprefix("state ").partition(" ")
        if int(number) != len(self.choices):
            raise ModelError(
                f"state {number} is out of order", fix=f"number it {len(self.choices)}, from 0 on"
            )
        rewards, rest = self._rewards(rest)
        self.of_states.append(rewards)
        for found in LABELS.finditer(rest):
            self.labels.setdefault(found[1] or found[2], []).append(int(number))
        self.choices.append(0)

    def _choice(self, word: str, rewards: list[Any]) -> None:
        self.choices[-1] += 1
        self.branches.append(0)
        self.action.append(word)
        self.of_choices.append(rewards)

    def _rewards(self, text: str) -> tuple[list[Any], str]:
        """Return the rewards in brackets, and the rest."""
        if not text.startswith("["):
            return [], text
        inside, bracket, rest = text[1:].partition("]")
        if not bracket:
            raise ModelError("a bracket is not closed", fix="add ]")
        return [self._number(each.strip()) for each in inside.split(",")], rest

    def _number(self, text: str) -> Any:
        if text.startswith("$"):
            if text not in self.known:
                raise ModelError(f"unknown placeholder {text}", fix="define it in @placeholders")
            return self.known[text]
        if self.head.get("value_type") == "double" and "/" not in text:
            return float(text)
        return exact(text)

    # ---- all of it ---------------------------------------------------------------------------

    def _explicit(self) -> Explicit:
        sizes = {"nr_states": len(self.choices), "nr_choices": len(self.branches)}
        for key, count in sizes.items():
            if self.head.get(key, str(count)) != str(count):
                raise ModelError(
                    f"@{key} is {self.head[key]}, the model has {count}",
                    where="head",
                    fix="complete the model, or correct the number",
                )
        states, choices = sizes.values()
        target = np.array(self.target, dtype=np.int64)
        if len(target) and not 0 <= target.min() <= target.max() < states:
            raise ModelError(
                f"a choice leads to state {target.max()} of {states}",
                where="model",
                fix="number the states from 0",
            )
        offsets = np.array([0, *accumulate(self.choices)], dtype=np.int64)
        flags = {name: np.isin(np.arange(states), on) for name, on in self.labels.items()}
        initial = flags.pop(INITIAL, np.zeros(states, dtype=bool))
        actions, names = self._actions(offsets)
        rewards, titles = self._reward_models(states, choices)
        header, own = self.header, dict[str, Any]()
        if header is not None:
            listed = header.get("labels")
            listed = listed if isinstance(listed, list) else []
            none = np.zeros(states, dtype=bool)
            flags = {label_key(k): flags.get(w, none) for k, w in enumerate(_words(listed))}
            if isinstance(header.get("goal"), list):
                own["goal"] = np.isin(np.arange(states), header["goal"])
        words = tuple(self.words.get(state, "") for state in range(states))
        return Explicit(
            name=self.name,
            state_to_choices=offsets,
            choice_to_branches=np.array([0, *accumulate(self.branches)], dtype=np.int64),
            target=target,
            probability=_ratios(self.chance),
            actions=actions,
            action_names=names,
            initial=initial,
            words=words if len({*words} - {""}) == states else (),
            rewards=rewards,
            labels=flags,
            titles={"rewards": titles, "aps": {name: name for name in flags}},
            listed_actions=names,
            own=own,
            header=header,
        )

    def _actions(self, offsets: np.ndarray) -> tuple[np.ndarray, tuple[str, ...]]:
        names = tuple(dict.fromkeys(self.action))
        if self.header is not None and isinstance(self.header.get("actions"), list):
            words = _words(self.header["actions"])
            if not set(names) <= set(words):
                raise ModelError(
                    "another program changed the names of the actions",
                    where="model",
                    fix=f"drop the line that begins with {OURS.strip()!r}",
                )
            place = {word: number for number, word in enumerate(words)}
            given = np.array([place[word] for word in self.action], dtype=np.int64)
            return given, tuple(self.header["actions"])
        place = {word: number for number, word in enumerate(names)}
        given = np.array([place[word] for word in self.action], dtype=np.int64)
        return actions_of(None if UNNAMED in names else given, names, offsets)

    def _reward_models(
        self, states: int, choices: int
    ) -> tuple[dict[str, dict[str, Ratios]], dict[str, str]]:
        """Return the reward models by identifier, and their names."""
        names = self.head.get("reward_models", "").split()
        count = max((len(each) for each in (*self.of_states, *self.of_choices)), default=0)
        names = [*names[:count], *(f"rew{k}" for k in range(len(names), count))]
        keys = names
        if self.header is not None:
            keys = [REWARD, *map(component_key, range(len(names) - 1))][: len(names)]
        found: dict[str, dict[str, Ratios]] = {}
        for number, key in enumerate(keys):
            found[key] = {
                over: _ratios([each[number] if number < len(each) else 0 for each in listed])
                for over, listed in (("states", self.of_states), ("choices", self.of_choices))
                if any(each[number:] and each[number] for each in listed)
            }
        return found, dict(zip(keys, names, strict=True))


def _ratios(values: Sequence[Any]) -> Ratios:
    """Return numbers as arrays: floats where one is, or integers over integers."""
    if any(isinstance(value, float) for value in values):
        return Ratios(np.array([float(value) for value in values]), ones(len(values)))
    both = [exact(value) for value in values]
    top, bottom = (
        np.array([(v.numerator, v.denominator) for v in both], dtype=object).reshape(-1, 2).T
    )
    return Ratios(_fitted(top), _fitted(bottom))


def _fitted(values: np.ndarray) -> np.ndarray:
    small = all(abs(value) < 2**62 for value in values)
    return values.astype(np.int64) if small else values


# ---- writing -------------------------------------------------------------------------------------


def save(model: MDP, path: str | Path) -> None:
    """Write a model as a DRN file; see the module for what the format does not hold."""
    write_atomically(path, "\n".join(_lines(model)) + "\n")


def _lines(model: MDP) -> Iterator[str]:
    table, parts = model.table, model.component_table
    offsets, following, weight, denominator = merged(table)
    kinds = {part.dtype for part in (table.weight, table.gain, *([parts.amount] if parts else ()))}
    # Sums of floats are no floats: they are written as the rationals that they are.
    summed = len(table.gain) != model.n_pairs or len(following) < len(table.next)
    floats = kinds == {np.dtype(np.float64)} and not summed
    header = as_header(model) | {"events": []}
    if model.goal is not None:
        header["goal"] = np.flatnonzero(model.goal).tolist()
    names = [REWARD, *(_words(model.component_names) if parts is not None else ())]
    yield from ("// Written by exact-mdp", OURS + json.dumps(header), "@type: MDP")
    yield from (f"@value_type: {VALUES[not floats]}", "@parameters", "", "@reward_models")
    yield from (" ".join(names), "@nr_states", str(model.n_states))
    yield from ("@nr_choices", str(model.n_pairs), "@model")
    columns = [table.expected_gain_exact()]
    if parts is not None:
        amount, below = parts.exact()
        columns += [(amount[:, number], below) for number in range(amount.shape[1])]
    actions, flags = _words(model.actions), model.labels.values()
    labels = list(zip(_words(model.labels), flags, strict=True))
    begins = {state for state, chance in model.start if chance > 0}
    shown = _shown(floats)
    for state in range(model.n_states):
        words = [f'"{word}"' if " " in word else word for word, on in labels if on[state]]
        yield " ".join([f"state {state}", *([INITIAL] if state in begins else []), *words])
        for pair in model.pairs_of(state):
            earned = ", ".join(shown(top[pair], below[pair]) for top, below in columns)
            yield f"\taction {actions[model.pair_action[pair]]} [{earned}]"
            for place in range(offsets[pair], offsets[pair + 1]):
                yield f"\t\t{following[place]} : {shown(weight[place], denominator[pair])}"


def _shown(floats: bool) -> Callable[[Any, Any], str]:
    """Return how a ratio of integers is written."""

    def text(top: Any, bottom: Any) -> str:
        value = exact(int(top)) / int(bottom)
        if max(abs(value.numerator), value.denominator) >= LIMIT:
            raise ModelError(
                f"a number of over {MOST_DIGITS:,} digits", where="DRN", fix="write .npz or .umb"
            )
        return repr(float(value)) if floats else str(value)

    return text


def _words(names: Sequence[object] | Mapping[str, Any]) -> list[str]:
    """Return a word for each name, no two alike, without spaces, quotes and brackets."""
    found: list[str] = []
    for name in names:
        word = re.sub(r'[\s"\[\]]', "_", str(name)) or "_"
        while word in found or word in (INITIAL, UNNAMED):
            word += "_"
        found.append(word)
    return found
