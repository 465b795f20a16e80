(* The checker of optima under limits on other totals: as Checker.v, a function in integers without
   recursion of its own. *)
From Coq Require Import ZArith QArith List Bool.
From MDP Require Import Spec Checker.
Import ListNotations.
Open Scope Z_scope.

(* A limit on the total of what pairs count, by state and action: it is at least a number. At most
   is at least of the negatives. The price is what a unit of the limit costs. *)
Record limit := Limit { counts : Z -> Z -> Q; least : Q; price : Q }.

(* A policy, by the expected visits of pairs from the start, and what proves that it is best. If no
   policy keeps the limits, `shift` is the least step by which all of them must move. *)
Record limited := Limited {
  limits : list limit; feasible : bool; visits : Z -> Z -> ratio; dual : level; shift : Q;
  end_rank : option (Z -> Z) }.

(* Return the amount of a pair that a limit counts, as a ratio. *)
Definition counted (p : pair) (l : limit) : ratio := ratio_of (counts l (state p) (action p)).

(* Return a number times a price, as a term of a sum. *)
Definition priced (x : ratio) (q : Q) : Z * ratio :=
  let (t, b) := x in (Qnum q, (t, b * Zpos (Qden q))).

(* Return the priced amounts of a pair, and its reward unless no policy keeps the limits. *)
Definition lagrangian (m : model) (c : limited) (p : pair) : ratio :=
  sum_of ((if feasible c then 1 else 0, earned m p) ::
    map (fun l => priced (counted p l) (price l)) (limits c)).

(* Return whether a pair of an end counts for nothing, and another satisfies its inequality. *)
Definition dual_pair (m : model) (hs : hints) (c : limited) (p : pair) : bool :=
  if ends hs (state p)
  then forallb (fun l => fst (counted p l) =? 0) (limits c) && (0 <=? fst (dual c (state p)))
  else surplus (discount m) (lagrangian m c p) p (dual c) <=? 0.

(* Return whether the rank shows that a pair comes to an end. *)
Definition ends_by_rank (hs : hints) (rank : option (Z -> Z)) (p : pair) : bool :=
  match rank with
  | None => true
  | Some rk => ends hs (state p) || falls p rk (fun _ => true)
  end.

(* Return whether no run ends beside the goal: of all states that are reached. *)
Definition goal_kept (m : model) (hs : hints) : bool :=
  no_goal m ||
  (forallb (fun sq => negb (begins sq) || reach hs (fst sq)) (start m) &&
   forallb (fun p => negb (reach hs (state p)) ||
     (all_next p (reach hs) && negb (ends hs (state p) && beside_goal m (state p)))) (pairs m)).

(* Return the visits of a pair. *)
Definition visits_of (c : limited) (p : pair) : ratio := visits c (state p) (action p).

(* Return the visits to a state from an outcome of a pair that is visited so often. *)
Definition given (m : model) (p : pair) (often : ratio) (o : outcome) : Z * (Z * ratio) :=
  let (t, b) := often in
  (next o, (Qnum (discount m) * weight o, (t, b * denominator p * Zpos (Qden (discount m))))).

(* Return the visits that a pair takes from its state, and gives to the next ones. *)
Definition moved (m : model) (c : limited) (p : pair) : list (Z * (Z * ratio)) :=
  (state p, (-1, visits_of c p)) :: map (given m p (visits_of c p)) (outcomes p).

(* Return the arrivals in each state: from the start, and from the pairs that are visited. *)
Definition flow_terms (m : model) (c : limited) : list (Z * (Z * ratio)) :=
  map (fun sq => (fst sq, (1, ratio_of (snd sq)))) (start m) ++ flat_map (moved m c)
    (filter (fun p => negb (fst (visits_of c p) =? 0)) (pairs m)).

(* Return the terms of each state. *)
Definition grouped {A} (terms : list (Z * A)) (s : Z) : list A :=
  map snd (filter (fun x => fst x =? s) terms).

(* Return whether visits are those of a policy: in each state that is no end they balance. *)
Definition flow_right (m : model) (hs : hints) (c : limited) : bool :=
  let by_state := grouped (flow_terms m c) in
  forallb (fun p => (0 <=? fst (visits_of c p)) && (0 <? snd (visits_of c p))) (pairs m) &&
  forallb (fun p => ends hs (state p) || (fst (sum_of (by_state (state p))) =? 0)) (pairs m).

(* Return a term of what the visits of a pair count. *)
Definition visited_term (x y : ratio) : Z * ratio :=
  let (t, b) := x in
  let (top, below) := y in
  (top, (t, below * b)).

(* Return the total of a limit over the visits. *)
Definition flow_count (m : model) (c : limited) (l : limit) : ratio :=
  sum_of (map (fun p => visited_term (counted p l) (visits_of c p)) (pairs m)).

(* Return the total reward of the visits. *)
Definition flow_reward (m : model) (c : limited) : ratio :=
  sum_of (map (fun p => visited_term (earned m p) (visits_of c p)) (pairs m)).

(* Return whether the visits keep a limit, less the shift. *)
Definition keeps (m : model) (c : limited) (l : limit) : bool :=
  0 <=? fst (sum_of [(1, flow_count m c l); (-1, ratio_of (least l)); (1, ratio_of (shift c))]).

(* Return whether prices and shift are 0 or more; without a policy, that prices add up to 1. *)
Definition prices_right (c : limited) : bool :=
  forallb (fun l => 0 <=? Qnum (price l)) (limits c) && (0 <=? Qnum (shift c)) &&
  (if feasible c then Qnum (shift c) =? 0
   else negb (Qnum (shift c) =? 0) &&
     (fst (sum_of ((-1, (1, 1)) :: map (fun l => (1, ratio_of (price l))) (limits c))) =? 0)).

(* Return whether the dual bounds all policies by what the visits earn, or by the shift. *)
Definition bound_right (m : model) (c : limited) : bool :=
  let at_start := sum_of (map (start_term (dual c)) (start m)) in
  let reward := if feasible c then flow_reward m c else ratio_of (shift c) in
  let sign := if feasible c then 1 else -1 in
  let terms := map (fun l => priced (ratio_of (least l)) (price l)) (limits c) in
  0 <=? fst (sum_of ((-1, at_start) :: (sign, reward) :: terms)).

(* Return whether the dual of a proof satisfies its inequalities, and every run ends. *)
Definition dual_right (m : model) (c : limited) (hs : hints) : bool :=
  policy_right m (way_out hs) && rank_fits m (end_rank c) &&
  forallb (ends_by_rank hs (end_rank c)) (pairs m) && goal_kept m hs &&
  level_right m (dual c) && forallb (dual_pair m hs c) (pairs m).

(* Return whether a proof of an optimum under limits holds: if so, its claims are theorems. *)
Definition check_limits (m : model) (c : limited) (hs : hints) : bool :=
  model_right m hs && dual_right m c hs && flow_right m hs c && forallb (keeps m c) (limits c) &&
  prices_right c && bound_right m c.
