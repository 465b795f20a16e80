"""Every claim of the paper as one object: where it stands, what it says, what is true of it.

    from paper_repro.claims import all_claims, judge

`all_claims()` lists them in the order of the paper; `judge` works some of them out and holds those
that the text leaves open against other readings as well.
"""

from exact_mdp.paper_repro.claims.claim import Finding, PaperClaim, Verdict
from exact_mdp.paper_repro.claims.judge import Judged, all_claims, chosen, judge

__all__ = ["Finding", "Judged", "PaperClaim", "Verdict", "all_claims", "chosen", "judge"]
