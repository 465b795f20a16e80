"""Policies, and their reading from words, arrays and files."""
