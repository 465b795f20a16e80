"""Exact linear algebra, proofs in exact numbers, and a checker of them that needs nothing else."""
