"""Tabular learning from samples."""
