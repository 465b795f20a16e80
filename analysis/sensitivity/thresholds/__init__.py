"""Every value of a parameter at which an optimal action changes."""
