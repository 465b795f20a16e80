(* The checker of verdicts on a policy: as Checker.v, a function in integers without recursion of
   its own.

   A policy that draws its actions is the only policy of a model in which each state has one pair,
   its draw. So a certificate of that model, by the rules of Checker.v, shows what the policy is
   worth; and what it loses is the difference from the optimum. *)
From Coq Require Import ZArith QArith List Bool.
From MDP Require Import Spec Checker LimitsChecker.
Import ListNotations.
Open Scope Z_scope.

(* An optimum, a policy, and what the policy loses. It takes each action of a state with its share.
   `own` is its value, as the optimum of the model in which its draws are the only pairs. *)
Record verdict := Verdict {
  optimum : certificate; share : Z -> Z -> Q; own : certificate; regret : extended }.

(* Return the probability with which the policy takes a pair. *)
Definition share_of (v : verdict) (p : pair) : Q := share v (state p) (action p).

(* Return whether this is 0 or more. *)
Definition share_right (v : verdict) (p : pair) : bool := 0 <=? Qnum (share_of v p).

(* Return whether the policy may take a pair. *)
Definition drawn (v : verdict) (p : pair) : bool := 0 <? Qnum (share_of v p).

(* Return the denominator of a pair times that of its share. *)
Definition below_of (v : verdict) (p : pair) : Z := denominator p * Zpos (Qden (share_of v p)).

(* Return a common multiple of a number and of this denominator. *)
Definition common (v : verdict) (so_far : Z) (p : pair) : Z := Z.lcm so_far (below_of v p).

(* Return an outcome of a pair as one of the draw, whose denominator is given. *)
Definition drawn_outcome (v : verdict) (unit : Z) (p : pair) (o : outcome) : outcome :=
  Outcome (next o) (weight o * (Qnum (share_of v p) * (unit / below_of v p))) (reward o).

(* Return all outcomes of a pair as those of the draw. *)
Definition drawn_outcomes (v : verdict) (unit : Z) (p : pair) : list outcome :=
  map (drawn_outcome v unit p) (outcomes p).

(* Return the draw among some pairs of a state, as a pair. *)
Definition draw (v : verdict) (s : Z) (among : list pair) : pair :=
  let unit := fold_left (common v) among 1 in
  Row s 0 unit (flat_map (drawn_outcomes v unit) among).

(* Return the model in which the draws of the policy are the only pairs. *)
Definition drawn_model (m : model) (v : verdict) : model :=
  let among := grouped (map (fun p => (state p, p)) (filter (drawn v) (pairs m))) in
  let once := filter (taken (actions (optimum v))) (pairs m) in
  Model (states m) (discount m) (maximise m) (start m)
    (map (fun p => draw v (state p) (among (state p))) once) (goal m) (missing_is_least m).

(* Return a number for the way in which a claim is proven; bounds are no such way. *)
Definition form_of (c : claim) : Z :=
  match c with
  | Values _ _ => 0
  | Bounds _ _ _ => -1
  | Expansion average _ _ _ => if average then 1 else 2
  | Reaching _ _ _ _ => 3
  end.

(* Return whether two claims are proven in the same way. *)
Definition same_form (a b : claim) : bool := (form_of a =? form_of b) && (0 <=? form_of a).

(* Return whether a state is said to be worth +∞ though missing the goal is worth the least. *)
Definition unbounded (m : model) (c : claim) (p : pair) : bool :=
  match c with
  | Reaching _ _ _ infinite => missing_is_least m && above infinite (state p)
  | _ => false
  end.

(* Return the first number less the second; of costs, the second less the first. *)
Definition difference (m : model) (a b : Q) : ratio :=
  let below := Zpos (Qden a) * Zpos (Qden b) in
  (signed m (Qnum a * Zpos (Qden b) - Qnum b * Zpos (Qden a)), below).

(* Return whether a value is a number, and the difference of another from it is `lost`. *)
Definition loses (m : model) (a : Q) (second : extended) (lost : Q) : bool :=
  match second with
  | Finite b =>
      let (top, below) := difference m a b in top * Zpos (Qden lost) =? Qnum lost * below
  | _ => false
  end.

(* Return whether two values are numbers, and their difference is `lost`. *)
Definition is_difference (m : model) (first second : extended) (lost : Q) : bool :=
  match first with
  | Finite a => loses m a second lost
  | _ => false
  end.

(* Return whether one of two start values is infinite, and the other is not the same. *)
Definition is_apart (m : model) (first second : extended) : bool :=
  (is_most m first && negb (is_most m second)) || (is_least m second && negb (is_least m first)).

(* Return whether the regret is what the policy loses at the start. *)
Definition regret_right (m : model) (v : verdict) : bool :=
  match regret v with
  | Finite lost => is_difference m (start_value (optimum v)) (start_value (own v)) lost
  | Plus_infinity => is_apart m (start_value (optimum v)) (start_value (own v))
  | Minus_infinity => false
  end.

(* Return whether a verdict holds of a model: if so, its claims are theorems. The hints are of the
   optimum, and of the model of the policy. *)
Definition check_regret (m : model) (v : verdict) (hs hs_own : hints) : bool :=
  check m (optimum v) hs && forallb (share_right v) (pairs m) &&
  check (drawn_model m v) (own v) hs_own && same_form (claims (optimum v)) (claims (own v)) &&
  forallb (fun p => negb (unbounded m (claims (own v)) p)) (pairs m) && regret_right m v.
