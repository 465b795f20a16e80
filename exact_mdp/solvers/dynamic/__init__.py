"""Dynamic programming and linear programming: one loop, and what each algorithm does in it.

To add a solver, write a frozen dataclass of its settings with

    name          its name in `solver.SOLVERS`; add it there and to `exact_mdp/__init__.pyi`
    solve(model)  the algorithm; it returns a `Solution`

The protocol is `iterate.Solver`, and `methods` has four examples. Where the algorithm improves
values step by step, `methods.Improving` has its settings and its loop, and it writes one step:

    def step(self, values, swept, goal):   # after a pass over all pairs: T V - V, and bounds
        values.take(swept)                 # V ← T V; then, for example, values.relax()

- What it gives back: values, a policy, and a bound on the error of both in every state, which holds
  with all rounding errors counted.
- Who bounds the error: not the solver. The loop does for values that are improved, and
  `solvers.bounds.bounds.verify(mdp, value)` does for values that come from anywhere else;
  `iterate.conclude` makes a solution of them.
- How it stops: where the proven bounds are as close as `tol` asks for, where double precision is at
  its limit, and at `max_iterations`, with a SolverError that holds the best solution reached. A
  small change between two sweeps proves nothing and is no reason to stop.
- What `solve(model, solver, tol=…)` does with it: it sets the setting `tol` where there is one.

The tests in `tests/solvers/test_solvers.py` run over all of `SOLVERS`. Name a solver that only
sweeps in `ONLY_SWEEPS` of `tests/support/solver_checks.py`: it solves no equations before a hundred
passes brought too little, so that where chains mix slowly it may reach the low limit of iterations
that the tests give it. They allow that to no other solver.
"""
