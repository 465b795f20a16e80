"""Write golden models, answers and certificates anew: `cd tests && python -m golden.write [ID …]`.

With IDs, only those. `--reproduction FOLDER` takes over the numbers of a quick run, and the answers
of the benchmark set are written where the variable QVBS names its folder.
"""

import json
import shutil
import sys
import tempfile
from pathlib import Path
from typing import Any

from golden import sources
from golden.runner import ANSWERS, CASES, CERTIFICATES, FOLDER, QVBS, answer, opened, run, trimmed


def save(path: Path, content: object) -> None:
    text = json.dumps(content, indent=1, sort_keys=True, ensure_ascii=False)
    path.write_text(text + "\n", "utf-8")


def certificates(chosen: list[str]) -> None:
    """Write the certificates; the checker's answer on each is pinned by a case of its own."""
    CERTIFICATES.mkdir(exist_ok=True)
    for name, (line, _) in CASES["certificates"].items():
        if not chosen or name in chosen:
            with tempfile.TemporaryDirectory() as tmp:
                path = Path(tmp) / f"{name}.json"
                assert run(line, Path(tmp), "--certificate", str(path)).status in (0, 1), line
                shutil.copy(path, CERTIFICATES)


def pinned(kind: str, name: str, case: Any) -> None:
    with tempfile.TemporaryDirectory() as tmp:
        folder = Path(tmp)
        save(ANSWERS / f"{name}.json", opened(answer(case, folder), case, folder))
    print(f"{kind}: {name}", flush=True)


def main(words: list[str]) -> None:
    if words[:1] == ["--reproduction"]:
        numbers = json.loads((Path(words[1]) / "numbers.json").read_text("utf-8"))
        save(FOLDER / "numbers.json", [trimmed(each) for each in numbers])
        return
    if not words:
        sources.write()
        shutil.rmtree(CERTIFICATES, ignore_errors=True)
        known = {name for kind in ("fast", "slow", "qvbs") for name in CASES[kind]}
        known |= {f"verify-{name}" for name in CASES["certificates"]}
        for path in ANSWERS.glob("*.json"):
            if path.stem not in known:
                path.unlink()
    ANSWERS.mkdir(exist_ok=True)
    certificates(words)
    for kind in ("fast", "slow", "qvbs"):
        for name, case in CASES[kind].items():
            if (not words or name in words) and (kind != "qvbs" or QVBS):
                pinned(kind, name, case)
    for name, (_, model) in CASES["certificates"].items():
        if not words or name in words:
            pinned("certificates", f"verify-{name}", f"verify certificates/{name}.json {model}")


if __name__ == "__main__":
    main(sys.argv[1:])
