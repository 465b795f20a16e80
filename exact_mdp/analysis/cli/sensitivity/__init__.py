"""The kinds of `exact-mdp sensitivity MODEL KIND`.

How to add a sensitivity kind:

1. Write the analysis in `exact_mdp.analysis.sensitivity`; it knows nothing of the command line.
2. Write a function of one argument, an `Asked` (`.options`), in a module of this package. It calls
   the analysis with what it needs of `asked.model` (the model with its parameters), `asked.policy`,
   `asked.ranges()`, `asked.seed`, `asked.work` (where draws are worked on) and `asked.options`, and
   gives back a `Report` (`exact_mdp.analysis.cli.render`): a mapping for JSON, facts, and tables
   made of rows and {heading: "key:format"}. Numbers with a claim are shown by their type.

       def slope(asked: Asked) -> Report:
           found = analysis.slope(asked.model, asked.policy)
           rows = [{"name": name, "slope": each} for name, each in found.items()]
           columns = {"parameter": "name", "slope": "slope:.4g"}
           table = Table(title="slopes", rows=rows, columns=columns)
           result = claimed("start_value", found.start) | {"slopes": found}
           return Report(result=result, facts={"start value": found.start}, tables=[table])

3. Name it in KINDS: its function, the options that it uses, and what its users should know of it.
   Every other option is refused. The module is imported when the kind is asked for.
4. A new option is declared once, in `exact_mdp.analysis.cli.commands`, and named in the kinds that
   use it. With `out` among them, the result is written into the folder of --out, with a record.

The command itself adds the model's name, the kind and the discount to every result.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of sensitivity analysis.

    Attributes
    ----------
    does : str
        "module:function" of this package.
    uses : frozenset of str
        The options that it uses, by the names of their values.
    about : str
        A sentence that helps where another option was given.
    """

    does: str
    uses: frozenset[str]
    about: str = ""


NAMES = frozenset({"parameters"})
RANGES = NAMES | {"ranges", "range_file", "relative", "whole"}
HELD = frozenset({"policy", "perception"})
DRAWN = frozenset({"n_jobs", "out", "samples", "seed"})

KINDS = MappingProxyType(
    {
        "gradient": Kind(
            does="one_way:gradient_report",
            uses=NAMES | HELD,
            about="a derivative is taken at today's value",
        ),
        "tornado": Kind(does="one_way:tornado_report", uses=RANGES | HELD),
        "threshold": Kind(
            does="one_way:threshold_report",
            uses=RANGES,
            about="thresholds are those of the optimal policy, re-optimised knowing the status; "
            "a perception makes another policy of one held fixed",
        ),
        "curve": Kind(
            does="curve:curve_report",
            uses=RANGES | HELD | {"max_regret", "max_relative_regret"},
            about="it follows the optimum over all that one parameter may be, unless given a range",
        ),
        "psa": Kind(
            does="psa:psa_report",
            uses=NAMES | HELD | DRAWN | {"range_file", "effective_sample_size"},
            about="the draws have distributions, not ranges: give --effective-sample-size, a "
            "number or a .toml file",
        ),
        "sobol": Kind(does="sobol:sobol_report", uses=RANGES | HELD | DRAWN),
        "robust": Kind(
            does="robust:robust_report",
            uses=RANGES | HELD | {"set_kind", "radius"},
        ),
    }
)
