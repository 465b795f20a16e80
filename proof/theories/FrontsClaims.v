(* What a front of two objectives says. With Spec.v this is the statement to read. *)
From Coq Require Import ZArith QArith List Bool.
From MDP Require Import Spec Checker Claims LimitsChecker LimitsClaims FrontsChecker.
Import ListNotations.
Open Scope Q_scope.

(* what a pair counts for an objective *)
Definition objective (c : Z -> Z -> Q) (p : pair) : Q := c (state p) (action p).

(* The total of an objective under a policy is q, in the limit of many steps. *)
Definition tends_to (m : model) (c : Z -> Z -> Q) (pi : policy) (q : Q) : Prop :=
  in_the_limit (fun eps n => q - eps <= total m (objective c) pi n <= q + eps).

(* The policy of each vertex has its totals. And for all weights w and 1 - w there is a vertex whose
   weighted totals no policy exceeds: nothing is beyond the vertices, and the lines between them. *)
Definition front_holds (m : model) (f : front) : Prop :=
  well_formed m /\
  (forall v, In v (vertices f) -> valid m (stationary m (acts v)) /\
    tends_to m (first_count f) (stationary m (acts v)) (first_total v) /\
    tends_to m (second_count f) (stationary m (acts v)) (second_total v)) /\
  (forall w, 0 <= w <= 1 -> exists v, In v (vertices f) /\
    forall pi, valid m pi -> in_the_limit (fun eps n =>
      w * total m (objective (first_count f)) pi n +
      (1 - w) * total m (objective (second_count f)) pi n <=
      w * first_total v + (1 - w) * second_total v + eps)).
