"""Acting on what is perceived, with memory: beliefs, bounds and their search."""
