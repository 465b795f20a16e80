"""What the reproduction writes: report, tables, figures."""
