"""What it costs to act on a perceived status."""
