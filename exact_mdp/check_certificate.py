"""Check a certificate: `python -m exact_mdp.check_certificate MODEL CERTIFICATE`.

MODEL is given as to the other commands. Exit status 0: the certificate holds, 1: it does not, 2:
one of the two cannot be read. `solvers/exact/checker.py` does the same without an installation.
"""

import sys
from collections.abc import Sequence
from typing import Any

from exact_mdp.mdp.io import model_json
from exact_mdp.mdp.io.load import load
from exact_mdp.solvers.exact import checker


def main(words: Sequence[str] | None = None) -> int:
    """Check a certificate file against a model, and say what does not hold."""

    def read_content(model: str) -> Any:
        return model_json.encode_model(load(model))

    return checker.main(sys.argv[1:] if words is None else words, read_content)


if __name__ == "__main__":
    sys.exit(main())
