"""The pages stand alone: a link into the repository is a path, and nothing comes from elsewhere.

A page may link a file of the repository that is no page, as it is read there, too. Among the built
pages there is no such file; its path is shown instead, but for a notebook, which is a tutorial. A
link to a file that does not exist, and a built page that would load a script, a style, a font or a
picture from another host, end the build.
"""

from __future__ import annotations

import re
from pathlib import Path

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.util import logging

LINK = re.compile(r"\[([^\]\n]+(?:\n[^\]\n]*)?)\]\(((?:\.\./)+[^)#\s]+)\)")
LOADS = re.compile(r"""<(?:script|link|img|iframe|source)\b[^>]*?\b(?:src|href)=["'](https?:)?//""")
logger = logging.getLogger(__name__)


def inside(app: Sphinx, page: str, source: list[str]) -> None:
    """Turn links to files beside the documentation into their paths."""
    root, file = Path(app.srcdir).parent, app.env.doc2path(page)
    here = Path(file).resolve().parent  # of a notebook, its own folder

    def shown(found: re.Match[str]) -> str:
        target = (here / found[2]).resolve()
        if not target.exists():
            logger.warning("no file %s", found[2], location=page, type="whole")
        if not target.is_relative_to(root) or target.is_relative_to(app.srcdir):
            return found[0]
        path = target.relative_to(root).as_posix()
        if target.suffix == ".ipynb":
            return f"{{doc}}`{found[1]} </tutorials/{path.removesuffix('.ipynb')}>`"
        return f"`{path}`" if found[1].strip("`") == path else f"{found[1]} (`{path}`)"

    source[0] = LINK.sub(shown, source[0])


def alone(app: Sphinx, error: Exception | None) -> None:
    """Refuse pages that load something from elsewhere."""
    if error or app.builder.format != "html":
        return
    pages = sorted(Path(app.outdir).rglob("*.html"))
    loading = [page.name for page in pages if LOADS.search(page.read_text("utf-8"))]
    if loading:
        raise ExtensionError(f"pages that load something from elsewhere: {', '.join(loading)}")


def setup(app: Sphinx) -> dict[str, bool]:
    """Watch over what is read and what is written."""
    app.connect("source-read", inside)
    app.connect("build-finished", alone)
    return {"parallel_read_safe": True}
