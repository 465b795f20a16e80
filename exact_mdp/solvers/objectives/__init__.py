"""Several expected totals of one model, exactly: their weighted optima, and optima under limits."""
