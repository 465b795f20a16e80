"""Writes a model and its certificate as data of Coq, and that it holds as a theorem.

    python to_coq.py model.json certificate.json NAME > NAME.v

The theorem follows from Soundness.v by computation inside Coq, so that neither the extraction nor
Python has to be believed: what the file states is what Coq has checked. It is stated for a total by
values alone, in which one state begins.
"""

import sys
from collections.abc import Iterable, Sequence
from importlib.util import module_from_spec, spec_from_file_location
from math import lcm
from pathlib import Path
from typing import Any

SOURCE = Path(__file__).resolve().parents[1] / "exact_mdp" / "solvers" / "exact" / "verified.py"
HEAD = """(* Made by proof/to_coq.py: the optimum of {name}, as a theorem. *)
From Coq Require Import ZArith QArith List FMapPositive.
From MDP Require Import Spec Checker Claims Soundness.
Import ListNotations.
Open Scope Z_scope.

(* Tables of numbers by state *)
Definition table {{A}} (l : list A) : PositiveMap.t A :=
  snd (fold_left (fun t x => (Pos.succ (fst t), PositiveMap.add (fst t) x (snd t))) l
    (1%positive, PositiveMap.empty A)).
Definition at_state {{A}} (t : PositiveMap.t A) (other : A) (s : Z) : A :=
  match PositiveMap.find (Z.to_pos (s + 1)) t with Some x => x | None => other end.
"""
THEOREM = """
Theorem accepted : holds {name} proof.
Proof. apply (sound {name} proof found). vm_cast_no_check (eq_refl true). Qed.

(* From the start no policy, of whatever kind, earns more in the limit than this. *)
Theorem optimum : forall pi, valid {name} pi ->
  in_the_limit (fun eps n => earns {name} {rate} pi n [] {first} <= {value} + eps)%Q.
Proof.
  destruct accepted as (_ & _ & _ & L & S & _). intros pi V.
  assert (E : (value h {first} == {value})%Q) by (vm_compute; reflexivity).
  destruct (L {first} [] ltac:(split; [discriminate|reflexivity])) as [U _].
  intros eps e0. destruct (U pi V eps e0) as [N H]. exists N. intros n Ln. rewrite <- E.
  exact (H n Ln).
Qed.
Print Assumptions optimum.
"""


def whole(n: int) -> str:
    """Return an integer as Coq reads it; long ones quickly, in hexadecimal."""
    digits = str(abs(n)) if abs(n) < 10**9 else hex(abs(n))
    return f"(-{digits})" if n < 0 else digits


def fraction(q: Any) -> str:
    """Return a fraction as Coq reads it."""
    return f"({whole(q[0])} # {whole(q[1])})"


def listed(items: Iterable[str]) -> str:
    """Return a list as Coq reads it."""
    return "[" + ";\n  ".join(items) + "]"


def table(name: str, items: Iterable[str], other: str) -> str:
    """Return the definition of a function of states."""
    return (
        f"Definition {name}_table := Eval vm_compute in table {listed(items)}.\n"
        f"Definition {name} := at_state {name}_table {other}."
    )


def main(words: Sequence[str]) -> None:
    """Print the file of Coq."""
    spec = spec_from_file_location("verified", SOURCE)
    assert spec
    assert spec.loader
    verified = module_from_spec(spec)
    spec.loader.exec_module(verified)
    model, certificate, name = *map(verified.read, words[:2]), words[2]
    m, _ = verified.model_of(model)
    c = verified.certificate_of(certificate, m)
    if not isinstance(c.claims, verified.Values) or len(m.start) > 1 or m.goal is not None:
        raise SystemExit("give a total by values alone, which begins in one state, without a goal")
    hints, states = verified.hints_of(m, c), range(m.states)
    values = [c.claims.h(s) for s in states]
    unit = lcm(*(below for _, below in values))  # one denominator: Coq then computes none
    rank, ((first, _),) = c.claims.rank, m.start
    rows = [
        f"Row {p.state} {p.action} {whole(p.denominator)} "
        + "[" + "; ".join(f"Outcome {o.next} {whole(o.weight)} {fraction(o.reward)}"
                          for o in p.outcomes) + "]"
        for p in m.pairs
    ]  # fmt: skip
    print(HEAD.format(name=name))
    print(f"Definition rows : list pair :=\n  {listed(rows)}.\n")
    print(f"Definition {name} : model :=\n  Model {m.states} {fraction(m.discount)} "
          f"{str(m.maximise).lower()} [({first}, 1%Q)] rows None {str(m.missing_is_least).lower()}."
          )  # fmt: skip
    print(table("policy_of", [str(c.actions(s)) for s in states], "0"))
    above = (f"({whole(t * (unit // b))}, {whole(unit)})" for t, b in values)
    print(table("h", above, "(0, 1)").replace("Definition h :=", "Definition h : level :="))
    if rank:
        print(table("ranks", [whole(rank(s)) for s in states], "0"))
    for part in ("ends", "reach"):
        flags = [str(getattr(hints, part)(s)).lower() for s in states]
        print(table(f"{part}_of", flags, "false"))
    for part in ("toward", "along"):
        print(table(f"{part}_of", [whole(getattr(hints, part)(s)) for s in states], "0"))
    value = c.start_value.number
    print(f"Definition proof : certificate := Certificate policy_of\n  (Values h "
          f"{'(Some ranks)' if rank else 'None'}) (Finite {fraction(value)}) "
          f"{str(c.unique).lower()}.")  # fmt: skip
    print(f"Definition found : hints := Hints ends_of reach_of policy_of toward_of along_of "
          f"{hints.target} {hints.first} {hints.second} {hints.leaving}.")  # fmt: skip
    # costs are negated in all levels
    best = fraction(value if m.maximise else (-value[0], value[1]))
    print(THEOREM.format(name=name, rate=fraction(m.discount), first=first, value=best))


if __name__ == "__main__":
    main(sys.argv[1:])
