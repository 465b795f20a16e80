"""Trade-offs between totals: exact fronts, and the weights under which a policy is optimal."""
