"""Pages: one HTML file each, which loads nothing from elsewhere and needs no server.

A template fills the blocks `title`, `style`, `main` and `script` of the base. Names stay text: see
`mdp.report`. A page's own security policy forbids whatever is not in it.
"""

from pathlib import Path
from typing import Any

from exact_mdp.mdp.report import load_template

ADVICE = "this is research software and no medical advice"
TEMPLATES = Path(__file__).parent / "templates"


def render_page(name: str, **data: Any) -> str:
    """Return the page of a template in the folder `templates`."""
    return str(load_template(TEMPLATES / name).render(data, advice=ADVICE))
