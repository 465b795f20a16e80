"""What is traded for what: exact fronts, and the weights under which a policy is optimal."""
