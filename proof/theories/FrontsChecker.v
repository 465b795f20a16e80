(* The checker of fronts of two objectives: as Checker.v, without recursion of its own. *)
From Coq Require Import ZArith QArith List Bool.
From MDP Require Import Spec Checker LimitsChecker.
Import ListNotations.
Open Scope Z_scope.

(* A vertex: a policy by its actions, and its values and totals of both objectives. *)
Record vertex := Vertex {
  acts : Z -> Z; first_value : level; second_value : level;
  first_total : Q; second_total : Q }.

(* Weights of both objectives, the first and 1 less it, and values that no policy exceeds. *)
Record corner := Corner { share : Q; most : level }.

(* A front: what pairs count for both objectives, its vertices, and corners by rising shares. *)
Record front := Front {
  first_count : Z -> Z -> Q; second_count : Z -> Z -> Q;
  vertices : list vertex; corners : list corner; front_rank : option (Z -> Z) }.

(* Return 1 less a fraction. *)
Definition rest_of (q : Q) : Q := Qmake (Zpos (Qden q) - Qnum q) (Qden q).

(* Return the weighted objectives as a proof about limits has them: as two, by their prices. *)
Definition weighted (f : front) (k : corner) : limited :=
  Limited
    [Limit (first_count f) 0%Q (share k); Limit (second_count f) 0%Q (rest_of (share k))]
    false (fun _ _ => (0, 1)) (most k) 0%Q (front_rank f).

(* Return whether values solve the equation of a pair that a policy takes, and are 0 at ends. *)
Definition value_pair (m : model) (hs : hints) (act : Z -> Z) (c : Z -> Z -> Q) (x : level)
    (p : pair) : bool :=
  if negb (taken act p) then true
  else if ends hs (state p) then fst (x (state p)) =? 0
  else surplus (discount m) (ratio_of (c (state p) (action p))) p x =? 0.

(* Return whether a total is the mean of values over the start. *)
Definition is_total (m : model) (x : level) (q : Q) : bool :=
  fst (sum_of [(1, sum_of (map (start_term x) (start m))); (-1, ratio_of q)]) =? 0.

(* Return whether the policy of a vertex has its values and totals. *)
Definition vertex_right (m : model) (hs : hints) (f : front) (v : vertex) : bool :=
  policy_right m (acts v) && level_right m (first_value v) && level_right m (second_value v) &&
  forallb (value_pair m hs (acts v) (first_count f) (first_value v)) (pairs m) &&
  forallb (value_pair m hs (acts v) (second_count f) (second_value v)) (pairs m) &&
  is_total m (first_value v) (first_total v) && is_total m (second_value v) (second_total v).

(* Return whether a share is from 0 to 1, and the values of a corner bound all policies. *)
Definition corner_right (m : model) (hs : hints) (f : front) (k : corner) : bool :=
  (0 <=? Qnum (share k)) && (Qnum (share k) <=? Zpos (Qden (share k))) &&
  dual_right m (weighted f k) hs.

(* Return whether a vertex attains the bound of a corner. *)
Definition attained (m : model) (k : corner) (v : vertex) : bool :=
  let at_start := sum_of (map (start_term (most k)) (start m)) in
  let first_one := priced (ratio_of (first_total v)) (share k) in
  let other := priced (ratio_of (second_total v)) (rest_of (share k)) in
  0 <=? fst (sum_of [(-1, at_start); first_one; other]).

(* Return whether the share of the first of two corners is less than that of the second. *)
Definition rising (both : corner * corner) : bool :=
  let (k, after) := both in
  Qnum (share k) * Zpos (Qden (share after)) <? Qnum (share after) * Zpos (Qden (share k)).

(* Return whether some vertex attains the bounds of two corners. *)
Definition meeting (m : model) (f : front) (both : corner * corner) : bool :=
  let (k, after) := both in
  existsb (fun v => attained m k v && attained m after v) (vertices f).

(* Return whether corners reach from share 0 to 1, and neighbours have a common vertex. *)
Definition covering (m : model) (f : front) : bool :=
  existsb (fun k => Qnum (share k) =? 0) (corners f) &&
  existsb (fun k => is_one (share k)) (corners f) &&
  forallb rising (combine (corners f) (tl (corners f))) &&
  forallb (meeting m f) (combine (corners f) (tl (corners f))).

(* Return whether a front of two objectives holds: if so, its claims are theorems. *)
Definition check_front (m : model) (f : front) (hs : hints) : bool :=
  model_right m hs && forallb (vertex_right m hs f) (vertices f) &&
  forallb (corner_right m hs f) (corners f) && covering m f.
