"""Dynamic programming and linear programming: one algorithm a module."""
