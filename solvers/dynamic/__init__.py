"""Dynamic programming and linear programming: one algorithm a module.

To add a solver, write a module here with a frozen dataclass of its settings and

    name          its name in `solvers.SOLVERS`; add it there and to `solvers.__all__`
    solve(mdp)    the algorithm; it returns a `Solution`, by `stopping.conclude`

The protocol is `stopping.Solver`; `gauss_seidel` is a short example.

- What it gives back: values, a policy, and a bound on the error of both in every state, which holds
  with all rounding errors counted.
- Who bounds the error: not the solver. `stopping.Watch.verdict` and `Watch.bounds` do for iterates,
  and `solvers.bounds.bounds.bounds(mdp, value)` does for values that come from anywhere else.
- How it stops: at each iteration it calls `Iterate.improve`, shows the pass to `Watch.ready`, and
  ends where `Watch.verdict` returns a status. A small change between two sweeps proves nothing and
  is no reason to stop. At its iteration limit it ends with `Status.ITERATION_LIMIT`, for which
  `conclude` raises a SolverError that holds the best solution reached.
- How values move: first by `Iterate.take`, for the pass that `improve` just returned, then by
  `evaluate` or `relax`. `take` may shift all values to the middle between the bounds; after a
  `relax` it no longer does, as errors then differ from state to state and such shifts could go on
  for ever.

The tests in `tests/test_solvers.py` run over all of `SOLVERS`.
"""
