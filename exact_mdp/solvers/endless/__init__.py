"""Total and average rewards if some policy never ends."""
