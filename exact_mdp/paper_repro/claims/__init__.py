"""Every claim of the paper as one entry: where it stands, what it says, what is true of it.

    from exact_mdp.paper_repro.claims import all_claims, judge

`all_claims()` lists them in the order of the paper; `judge` works some of them out, and tries those
that the text leaves open under other readings, too.

How to add a claim. It is one entry in the module of its part of the paper (`model`, `learning`,
`returns`, `policies`): a decorator on the function that works it out.

    @CLAIMS.add("policy.1100", "Section 4.1, Figure 10", "statement", open=True)
    def _both(reading: Reading) -> Finding:
        '''Forgetful and confused: directive assistance is best.'''
        best = optimal_actions(reading, "1100")
        right = sum(NUMBER["directive"] in each for each in best)
        return statement(right == len(best), f"optimal in {right} of {len(best)} states")

The decorator gives its name, its places in the paper (keys of `reported.PLACES`), the rule that
judges it (a key of `claim.RULES`), and whether the text leaves open what decides it, so that other
readings are tried as well. The docstring is what the paper says, in our words.

The function gets a `Reading` (model, optimum, policies, training runs) and returns a `Finding`,
made by the function of its rule in `claim`: statement, plotted, event, usual, undecided. A number
that the model has to hold exactly is an input, and shorter:

    CLAIMS.entry("table4.trial", "Table 4", "Weight trial.", -1, lambda reading: ...)

Then `python -m paper_repro --claim policy.1100` works it out alone. The result is pinned by an
entry with a reason in `expected.toml`; `--candidates` prints the entry.
"""

from exact_mdp.paper_repro.claims.claim import Finding, PaperClaim, Verdict
from exact_mdp.paper_repro.claims.judge import Judged, all_claims, chosen, judge

__all__ = ["Finding", "Judged", "PaperClaim", "Verdict", "all_claims", "chosen", "judge"]
