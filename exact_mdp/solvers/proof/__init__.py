"""Proofs: certificates, who makes them, who checks them, and their files."""
