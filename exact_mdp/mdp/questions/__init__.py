"""Questions about a model, as reductions: models whose optimal value is the answer, and ways back.

A reduction refuses what it does not apply to, makes its model, and tells which pairs and states of
that model stand for which of the given one; each module of this folder states its equation.
Policies of a model are also policies of its questions, so every analysis applies to them as it is.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Self

from exact_mdp.mdp.questions.horizon import ask_horizon
from exact_mdp.mdp.questions.origin import Origin as Origin
from exact_mdp.mdp.questions.origin import Question as Question
from exact_mdp.mdp.questions.origin import keep_origin, origin_of
from exact_mdp.mdp.questions.reaching import ask_reaching
from exact_mdp.mdp.questions.step_weights import ask_step_weights
from exact_mdp.mdp.questions.until import ask_component, ask_until
from exact_mdp.mdp.validate import Parts, require_count


class Questions(Parts):
    """The questions of a model: methods that return the model of the answer."""

    def reaching(self, label: str, allowed: str | None = None) -> Self:
        """Return the model whose value is the probability of reaching a labelled state.

        Steps into a labelled state lead to a new state `reached` instead; the labelled states keep
        the value 1. The optimum is the greatest probability, or the least if the sense is "min".
        The model has no discount. With `within(N)`, before or after, it is the probability of
        reaching a labelled state within N steps.

        Parameters
        ----------
        label : str
            One of `labels`, or an expression over labels and state variables, "x=3 & y>1": see
            `mdp.questions.ending`.
        allowed : str, optional
            The label of the states that a run may pass through; all by default. From any other
            state without the first label the probability is 0.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If a label is unknown.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> from exact_mdp import certify
        >>> walk = [["1/2", "1/6", "1/3"], [0, 1, 0], [0, 0, 1]]
        >>> mdp = MDP.from_arrays([walk], [0, 0, 0], labels={"home": [False, True, False]})
        >>> certify(mdp.reaching("home")).start_value
        Fraction(1, 3)
        """
        answer: Self = ask_reaching(self, label, allowed)
        return keep_origin(answer, self, "reaching", label=label, allowed=allowed)

    def until(self, label: str, reward: str | None = None) -> Self:
        """Return the model whose value is the expected reward until a labelled state is reached.

        At discount 1 a run that never reaches one has the value +∞. The optimum is infinite if such
        runs have a positive probability under some policy; for costs, under every policy. With
        `within(N)`, before or after, these are the runs that reach no labelled state in N steps.

        Parameters
        ----------
        label : str
            One of `labels`, or an expression as in `reaching`.
        reward : str, optional
            The reward component that counts; the whole reward by default.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If the label or the component is unknown.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> from exact_mdp import certify
        >>> walk = [["1/3", "2/3"], [0, 1]]
        >>> mdp = MDP.from_arrays([walk], [1, 1], labels={"home": [False, True]})
        >>> certify(mdp.until("home")).value.tolist()
        [Fraction(3, 2), Fraction(0, 1)]
        """
        model = self
        if reward is not None:
            model = self.earning(reward)
        answer: Self = ask_until(model, label)
        return keep_origin(answer, model, "until", label=label)

    def weigh_steps(self, weights: object) -> Self:
        """Return the model whose reward counts more or less by the step in which it is earned.

        Parameters
        ----------
        weights : "half-cycle", "simpson" or (N,) numbers
            Of a model of N steps, made by `within(N)` or `from_steps`. The rules correct
            cohort models, with a reward at each end of N - 1 cycles. "simpson" needs an odd N.
            All amounts are weighed: double a cost that is paid once, at the start, for half cycles.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If the model has no steps or a terminal value, or if there is another number of weights.

        Examples
        --------
        >>> from exact_mdp import MDP, certify
        >>> alive = MDP.from_arrays([[["4/5", "1/5"], [0, 1]]], [1, 0])
        >>> certify(alive.within(3).weigh_steps("half-cycle")).start_value  # 1/2 + 4/5 + 16/50
        Fraction(81, 50)
        """
        answer: Self = ask_step_weights(self, weights)
        return keep_origin(answer, self, "weigh_steps", weights=weights)

    def earning(self, component: str) -> Self:
        """Return the model that earns one component of the reward alone.

        Parameters
        ----------
        component : str
            One of `component_names`.

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If there is no such component.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> from exact_mdp import certify
        >>> parts = {"time": [1, 0], "toll": [3, 0]}
        >>> mdp = MDP.from_arrays([[[0, 1], [0, 1]]], [4, 0], components=parts)
        >>> certify(mdp).start_value, certify(mdp.earning("toll")).start_value
        (Fraction(4, 1), Fraction(3, 1))
        """
        answer: Self = ask_component(self, component)
        return answer

    def within(self, steps: int, *, terminal_value: object = None) -> Self:
        """Return the model of episodes that stop after N steps.

        The new model has a column `time` before the model's own columns: first all states at time
        0, then at time 1, and so on to time N, when every episode is over. Extra states, such as an
        end, have no time. A policy over the model's own states or columns is also a policy of the
        new model, the same at every time.

        Parameters
        ----------
        steps : int
            N, 0 or more. After 0 steps a value is the terminal one, and a probability is 1 or 0.
        terminal_value : (S,) numbers or {state: number}, optional
            The value of each state at time N; 0 by default, and for states that are not named. The
            last step earns it, discounted once, so the values of the states at time N themselves
            are 0. In a model with components it is a component of its own, "terminal value".

        Returns
        -------
        MDP

        Raises
        ------
        ModelError
            If `steps` is not a whole number from 0, a terminal value is not finite, the new model
            would not fit in memory, or the model already has a column `time`.

        Examples
        --------
        >>> from exact_mdp import MDP
        >>> wait, go = [["1/2", "1/2"], [0, 1]], [[0, 1], [0, 1]]
        >>> mdp = MDP.from_arrays([wait, go], [[1, "3/2"], [0, 0]]).within(3)
        >>> mdp.space.names, mdp.n_states, mdp.space.label(2)
        (('time', 'state'), 8, 'time 1, state 0')
        >>> mdp.table.row(mdp.pair(2, 0))
        [(Fraction(1, 2), 4, Fraction(1, 1)), (Fraction(1, 2), 5, Fraction(1, 1))]
        """
        steps, origin = require_count(steps, "horizon", least=0), origin_of(self)
        if not steps and terminal_value is None and origin is not None and origin.asks_for_chance:
            # A run that begins in a labelled state is there before the first step.
            begun: Self = replace(origin, model=origin.model.within(0)).rebuild_model()
            return begun
        answer: Self = ask_horizon(self, steps, terminal_value)
        return keep_origin(answer, self, "within", steps=steps, terminal_value=terminal_value)
