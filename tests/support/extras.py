"""The packages that an extra brings, by the names they are imported by."""

EXTRAS = {
    "certifi": "agents",
    "clarabel": "lp",
    "cvxpy": "lp",
    "gymnasium": "models",
    "httpcore": "agents",
    "matplotlib": "plots",
    "networkx": "plots",
    "pyarrow": "models",
    "stormpy": "models",
    "umbi": "models",
    "xllamacpp": "agents",
}
