"""The picture of the rooms in ARCHITECTURE.md, made from the imports; a test compares the two.

    python docs/extensions/rooms.py        writes it again

A box is a folder. An arrow leads from a room to one whose modules it imports; what can be reached
over another room has no arrow of its own.
"""

from __future__ import annotations

import re
from pathlib import Path

import networkx as nx

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "ARCHITECTURE.md"
ROOMS = ("mdp", "solvers", "analysis", "paper_repro")
IMPORTED = re.compile(r"^(?:from |import |\w+ = later\(\")exact_mdp\.(\w+)", re.M)
PICTURE = re.compile(r"(?<=```mermaid\n).*?(?=```)", re.S)


def imports() -> nx.DiGraph:
    """Return which room imports which."""
    found = nx.DiGraph()
    found.add_nodes_from(ROOMS)
    for room in ROOMS:
        for path in (ROOT / "exact_mdp" / room).rglob("*.py"):
            names = IMPORTED.findall(path.read_text("utf-8"))
            found.add_edges_from((room, name) for name in names if name in ROOMS and name != room)
    return found


def picture() -> str:
    """Return the picture in Mermaid's words."""
    lines = ["flowchart BT"]
    for room in ROOMS:
        inside = sorted(
            path.parent.name for path in (ROOT / "exact_mdp" / room).glob("*/__init__.py")
        )
        lines += [f'  subgraph {room}["{room}/"]', "    direction LR"]
        lines += [f'    {room}_{name}["{name}"]' for name in inside]
        lines.append("  end")
    arrows = nx.transitive_reduction(imports()).edges
    lines += sorted(f"  {there} --> {here}" for there, here in arrows)
    return "\n".join(lines) + "\n"


def drawn() -> str:
    """Return the page with the picture as the imports are now."""
    return PICTURE.sub(lambda _: picture(), PAGE.read_text("utf-8"))


if __name__ == "__main__":
    PAGE.write_text(drawn(), "utf-8")
