"""A page from a template, which fills the blocks `title`, `style`, `main` and `script` of the base.

Names come from models and files, so they stay text: jinja2 escapes what stands in elements and
attributes, `tojson` what a script reads, and characters that steer a terminal or turn the text
around them are written as `\\x1b`. The page's own security policy forbids whatever is not in it.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

from exact_mdp.mdp.errors import shown_text

ADVICE = "this is research software and no medical advice"
TEMPLATES = Path(__file__).parent / "templates"


def render(template: str, **data: Any) -> str:
    """Return the page of a template in the folder `templates`; an undefined name is an error."""
    import jinja2

    templates = jinja2.Environment(
        loader=jinja2.FileSystemLoader(TEMPLATES),
        undefined=jinja2.StrictUndefined,
        autoescape=True,
        finalize=lambda value: shown_text(value, lines=True) if type(value) is str else value,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    page: str = templates.get_template(template).render(data, advice=ADVICE)
    return page
