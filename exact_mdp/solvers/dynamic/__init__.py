"""Dynamic programming and linear programming: one class for each algorithm.

To add a solver, write a frozen dataclass of its settings that is a `base.Solver`: it has a `name`
in `total.SOLVERS` and in `exact_mdp/__init__.pyi`, and `maximise(model)`, which returns a
`Solution`. An algorithm that improves values step by step inherits its settings from
`methods.Improving`, and writes its loop:

    def maximise(self, model):
        started = perf_counter()
        values, stopping = self.begin(model)
        for _ in range(self.max_iterations):
            values.pass_over_pairs()            # T V - V, a greedy policy, bounds on V*
            if stopping.is_reached():
                break
            values.apply_backup()               # the step: V ← T V, and whatever else helps
        return stopping.conclude(self, started)

It need not bound its own error: the stopping rule proves the bounds. Values that come from anywhere
else are bounded by `bounds.bound_optimal_values(mdp, value)`. The tests of solvers run over all of
`SOLVERS`: laws, discounts next to 1, totals without end, published cases.
"""
