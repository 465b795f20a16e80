"""What commands about a scenario file do: write one to change, and say what is wrong with one."""

from __future__ import annotations

from collections import Counter
from importlib.resources import files
from pathlib import Path

from exact_mdp.analysis.cli.options import check_outputs
from exact_mdp.analysis.cli.render import Report, Table
from exact_mdp.analysis.pages.page import ADVICE
from exact_mdp.mdp.care import lint as linter
from exact_mdp.mdp.errors import ModelError
from exact_mdp.mdp.io.files import SMALL, read_text, write_atomically


def new(*, file: str) -> Report:
    """Write the template."""
    check_outputs((file, (".toml",)))
    if Path(file).exists():
        raise ModelError("the file is there already", where=file, fix="choose another name")
    template = (files("exact_mdp.mdp.care") / "template.toml").read_text(encoding="utf-8")
    write_atomically(file, template)
    return Report(result={"written": file}, facts={"written": file}, notes=[ADVICE])


def lint(*, file: str) -> Report:
    """List what is wrong with a scenario file; exit status 1 where anything is."""
    if Path(file).suffix.lower() != ".toml":
        raise ModelError("not a scenario file", where=file, fix="name a .toml file")
    problems = linter.lint(read_text(file, most=SMALL), Path(file).stem)
    counts = Counter(problem["severity"] for problem in problems)
    return Report(
        result={"file": file, "problems": problems},
        facts={"file": file, **{f"{name}s": counts[name] for name in ("error", "warning")}},
        tables=[
            Table(
                title="problems",
                rows=problems,
                columns={
                    "line": lambda problem: problem["line"],
                    "what": lambda problem: f"{problem['severity']}: {problem['what']}",
                    "fix": lambda problem: problem["fix"],
                },
                first=max(1, len(problems)),
            )
        ],
        notes=[ADVICE],
        status=1 if problems else 0,
    )
