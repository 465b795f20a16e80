"""Worst and best cases over sets of rows and over boxes of parameters."""
