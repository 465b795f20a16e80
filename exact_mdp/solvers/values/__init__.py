"""The value of a policy: expectations, visits, the distribution of its return, and samples."""
