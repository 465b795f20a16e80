"""The value of a policy: expectations, visits, the law of its return, and samples of it."""
