"""Tabular learning from samples, and what it tends to."""
