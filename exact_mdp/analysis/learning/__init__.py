"""What learning ends with, judged by exact values."""
