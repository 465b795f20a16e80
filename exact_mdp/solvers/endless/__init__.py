"""The total reward at discount 1, where some policy never ends."""
