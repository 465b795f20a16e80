"""The audit of a learned policy: its regret, the states where it errs, and the reasons."""
