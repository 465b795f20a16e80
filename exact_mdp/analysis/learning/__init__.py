"""The policies that learning ends with, judged by exact values."""
