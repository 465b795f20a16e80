"""Care scenarios: what they are, how they move, and what is perceived of them."""
