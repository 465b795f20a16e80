"""Dynamic programming and linear programming: one loop, and what each algorithm does in it.

To add a solver, write a frozen dataclass of its settings that is an `iterate.Solver`: it has a
`name` in `solver.SOLVERS` and in `exact_mdp/__init__.pyi`, and `best(model)`, which returns a
`Solution`. Where it improves values step by step, `methods.Improving` has the settings and the
loop, and it writes one step:

    def step(self, values, goal):   # after a pass over all pairs: T V - V, and bounds
        values.take()               # V ← T V; then, for example, values.relax()

It does not bound its own error: the loop does, or `bounds.verify(mdp, value)` for values that come
from anywhere else. The tests of solvers run over all of `SOLVERS`: laws, discounts next to 1,
totals without end, published cases.
"""
