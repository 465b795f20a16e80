"""Every reading of the paper's text, and what the reported numbers say of it."""
