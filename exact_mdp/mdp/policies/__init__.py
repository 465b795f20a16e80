"""Policies: what to do, from words, arrays and files."""
