"""Dynamic programming and linear programming: one algorithm a module.

To add a solver, write a module here with a frozen dataclass of its settings and

    name          its name in `solver.SOLVERS`; add it there and to `solvers.__all__`
    solve(model)  the algorithm; it returns a `Solution`

The protocol is `stopping.Solver`; `gauss_seidel` is a short example. Where the algorithm improves
values step by step, its settings are `tol` and `max_iterations`, checked by
`stopping.check_settings`, and `stopping.Run` is the frame around it:

    run = Run(model, self)
    for found in run:               # a pass over all pairs: T V - V, and bounds around V
        run.values.take(found)      # V ← T V; then, for example, run.values.relax(backward=False)
    return run.solution

- What it gives back: values, a policy, and a bound on the error of both in every state, which holds
  with all rounding errors counted.
- Who bounds the error: not the solver. `Run` does for values that are improved, and
  `solvers.bounds.bounds.bounds(mdp, value)` does for values that come from anywhere else;
  `stopping.conclude` makes a solution of them.
- How it stops: `Run` ends the loop where the proven bounds are as close as `tol` asks for, where
  double precision is at its limit, and at `max_iterations`, with a SolverError that holds the best
  solution reached. A small change between two sweeps proves nothing and is no reason to stop.
- How values move: first by `Iterate.take`, for the pass just made, then by `evaluate` or `relax`.
  `take` may shift all values to the middle between the bounds; after a `relax` it no longer does,
  as errors then differ from state to state and such shifts could go on for ever.
- What `solve(model, solver, tol=…)` does with it: it sets the setting `tol` where there is one.

The tests in `tests/solvers/test_solvers.py` run over all of `SOLVERS`. Name a solver that only
sweeps in `ONLY_SWEEPS` of `tests/support/solver_checks.py`: it solves no equations before a hundred
passes brought too little (`Run.hurry`), so that where chains mix slowly it may reach the low limit
of iterations that the tests give it. They allow that to no other solver.
"""
