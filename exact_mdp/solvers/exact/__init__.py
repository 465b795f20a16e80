"""Exact linear algebra."""
