"""The program `exact-mdp`, as `python -m exact_mdp`."""

import sys

from exact_mdp.analysis.cli import main

sys.exit(main())
