"""What a policy is worth: expectations, visits, the law of its return, and samples of it."""
