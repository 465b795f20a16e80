"""Bring values close to those of a policy: by sweeps where its chain mixes, or by linear equations.

    V ← T_π V,   or, with d = T_π V - V,   V ← V + (I - γ P_π)⁻¹ d

Sweeps go on until the error within the policy falls to a goal. Where the rate at which it falls
says that they would take too many, what is missing is found from the linear equations instead,
solved only roughly each time: d is computed anew from V, so that the errors of one correction are
the next one's task (iterative refinement; Dembo, Eisenstat and Steihaug, SIAM J. Numer. Anal. 19,
1982, on how exactly to solve).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from exact_mdp.mdp.table import Floats
from exact_mdp.solvers.bounds.gains import COMPILED
from exact_mdp.solvers.bounds.linear import LinearSystem, policy_chain
from exact_mdp.solvers.bounds.sweeps import Judged, Pass, Sweeps

FIRST_SWEEPS = 12
CORRECTIONS = 30


@dataclass(eq=False)
class Iterate:
    """Values V = h + c w that are being improved.

    Attributes
    ----------
    sweeps : Sweeps
    value : (S,)
        h.
    shift : float
        c, which is 0 but where a shift of all values is only a shift.
    slow : bool
        Whether sweeps were found to be too slow for this model.
    relaxed : bool
        Whether states were ever improved one by one, by `relax`.
    """

    sweeps: Sweeps
    value: Floats
    shift: float = 0.0
    slow: bool = False
    relaxed: bool = False

    def improve(self) -> Pass:
        """Return a pass over all pairs, whose policy is the one to `evaluate`."""
        self._centre()
        return self.sweeps.improve(self.value, self.shift)

    def judge(self, found: Pass) -> Judged:
        """Return the proven bounds of a pass found here."""
        if isinstance(found, Judged):
            return found
        return self.sweeps.judge(self.value, self.shift)

    def _centre(self) -> None:
        """Hold what all values have in common as a shift, which costs no digits."""
        if self.sweeps.uniform:
            low, high = float(self.value.min()), float(self.value.max())
            middle = (low + high) / 2
            if abs(middle) > high - low:
                self.value -= middle
                self.shift += middle

    def take(self, found: Pass) -> None:
        """Move on to T V, and to the middle between the bounds where that is only a shift.

        Errors that are alike in all states stay alike under T, and the middle removes them. Once
        states were improved one by one, errors differ, and the shift to the middle could bring
        back more than a sweep removes: from then on T V is taken as it is.
        """
        if self.relaxed:
            self.value += found.step
        else:
            self._move(found.step, (found.low + found.high) / 2 - self.shift)

    def relax(self, *, backward: bool) -> None:
        """Improve each state in turn, upward or downward in number, by what others have become."""
        self.sweeps.relax(self.value, self.shift, backward=backward)
        self.relaxed = True

    def _move(self, step: Floats, middle: float) -> None:
        self.value += step
        if self.sweeps.uniform:
            self.shift += self.sweeps.mdp.discount * middle

    def evaluate(self, goal: float, most: int) -> None:
        """Move close to the values of the policy of the last pass, where it has one.

        Parameters
        ----------
        goal : float
            Error within the policy, in units of w, at which to stop; 0 for as little as possible.
        most : int
            Sweeps that are too many.
        """
        if self.sweeps.policy is None:
            return
        if not self.slow and self._sweep(goal, most):
            return
        self.slow = True
        self._correct(goal)
        if self.sweeps.mdp.n_transitions >= COMPILED and goal > 0:
            # Good news is carried along the whole model, up and down, before the next policy.
            self.sweeps.relax(self.value, self.shift, backward=False)
            self.sweeps.relax(self.value, self.shift, backward=True)

    def _sweep(self, goal: float, most: int) -> bool:
        """Follow the policy; return whether that came as close as asked for."""
        errors: list[float] = []
        while len(errors) < most:
            step, low, high = self.sweeps.follow(self.value, self.shift)
            error = (high - low) / 2
            if goal == 0 and errors and not error < min(errors):
                return True
            self._move(step, (low + high) / 2)
            if not error > goal:
                return True
            errors.append(error)
            if _slow(errors, goal, most):
                break
        return False

    def _correct(self, goal: float) -> None:
        pairs = self.sweeps.policy
        assert pairs is not None
        chain, _ = policy_chain(self.sweeps.mdp, pairs)
        system, error = LinearSystem(chain, self.sweeps.mdp.discount), np.inf
        kept, shift = self.value.copy(), self.shift
        for _ in range(CORRECTIONS):
            step, low, high = self.sweeps.follow(self.value, self.shift)
            before, error = error, (high - low) / 2
            if not error <= before:  # it went astray
                self.value[:], self.shift = kept, shift
                return
            if error <= goal or error > before / 2:
                return
            kept[:], shift = self.value, self.shift
            if self.sweeps.uniform:
                middle = (low + high) / 2
                self.shift += middle
                step -= middle * self.sweeps.weights.margin[pairs]
            self.value += system.roughly(step)


def _slow(errors: list[float], goal: float, most: int) -> bool:
    """Return whether errors that go on falling as they do miss the goal within `most` sweeps."""
    if len(errors) < FIRST_SWEEPS:
        return False
    rate = (errors[-1] / errors[-6]) ** (1 / 5)
    goal = max(goal, 1e-12 * errors[0])
    return bool(errors[-1] * rate ** (most - len(errors)) > goal)
