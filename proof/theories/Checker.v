(* The checker: a function of a model, a certificate and hints, in integers, with a yes or a no.

   It recurs through no list of its own: all, some, those that, the first that, the images of, and a
   fold are functions of Coq's library. So a short translator makes Python of what is extracted, in
   which the comment before each definition becomes a docstring. *)
From Coq Require Import ZArith QArith List Bool.
From MDP Require Import Spec.
Import ListNotations.
Open Scope Z_scope.

(* ---- certificates --------------------------------------------------------------------------- *)

(* A ratio is its top over its below, an integer over a positive one; a level has one per state. *)
Definition ratio := (Z * Z)%type.
Definition level := Z -> ratio.
Definition value (x : level) (s : Z) : Q := (inject_Z (fst (x s)) / inject_Z (snd (x s)))%Q.

Inductive extended :=
  (* A number as start value. *)
  | Finite (number : Q)
  (* +∞ as start value. *)
  | Plus_infinity
  (* -∞ as start value. *)
  | Minus_infinity.

(* The claims, with the levels and ranks that prove it by the rules of the format *)
Inductive claim :=
  (* A total by its values; a rank shows that every run ends, at discount 1. *)
  | Values (h : level) (rank : option (Z -> Z))
  (* Bounds of a total, and of the value of a policy. *)
  | Bounds (low high : level) (rank : option (Z -> Z))
  (* An average, or a total at discount 1, by gain, bias and a third level. *)
  | Expansion (average : bool) (g h w : level)
  (* A total until a goal that a run may miss: `infinite` is 1 for +∞, -1 for -∞, else 0. *)
  | Reaching (h : level) (rank order infinite : Z -> Z).

(* A policy, by the action of each state, and the claims. *)
Record certificate := Certificate {
  actions : Z -> Z; claims : claim; start_value : extended; unique : bool }.

(* Results found without proof. They are tested, so that a wrong hint can only refuse. Which states
   are ends; which ones optimal pairs reach from the start; of states of +∞, the actions that
   lead to finite ones. If two pairs of a state are optimal: the number of steps to this target, or
   -1; the actions along the way; the state; both actions; and one that leaves the state or earns. *)
Record hints := Hints {
  ends : Z -> bool; reach : Z -> bool; way_out : Z -> Z;
  toward : Z -> Z; along : Z -> Z; target : Z; first : Z; second : Z; leaving : Z }.

(* ---- arithmetic ----------------------------------------------------------------------------- *)

(* Return a sum with one more term, which is a number of times a ratio. *)
Definition add_term (so_far : ratio) (term : Z * ratio) : ratio :=
  let (top, below) := so_far in
  let (times, x) := term in
  let (t, b) := x in
  if b =? below then (top + times * t, below)
  else
    let unit := Z.lcm below b in
    (top * (unit / below) + times * t * (unit / b), unit).

(* Return the sum of terms. *)
Definition sum_of (terms : list (Z * ratio)) : ratio := fold_left add_term terms (0, 1).

(* Return a fraction as a ratio. *)
Definition ratio_of (q : Q) : ratio := (Qnum q, Zpos (Qden q)).

(* Return whether a fraction is 1. *)
Definition is_one (q : Q) : bool := Qnum q =? Zpos (Qden q).

(* Return the sum of weight times reward over the outcomes of a pair. *)
Definition reward_sum (p : pair) : ratio :=
  sum_of (map (fun o => (weight o, ratio_of (reward o))) (outcomes p)).

(* Return a number of the model in numbers that are maximised: costs are negated. *)
Definition signed (m : model) (x : Z) : Z := if maximise m then x else - x.

(* Return r, the mean reward of a pair, in numbers that are maximised. *)
Definition earned (m : model) (p : pair) : ratio :=
  let (top, below) := reward_sum p in (signed m top, below * denominator p).

(* Return c + γ Σ p(s') x(s') - x(s), times a positive integer. *)
Definition surplus (gamma : Q) (c : ratio) (p : pair) (x : level) : Z :=
  let scale := Zpos (Qden gamma) * denominator p in
  let ahead := map (fun o => (Qnum gamma * weight o, x (next o))) (outcomes p) in
  let (top, below) := sum_of ((- scale, x (state p)) :: ahead) in
  fst c * scale * below + snd c * top.

(* ---- the model and the policy --------------------------------------------------------------- *)

(* Return whether a number is that of a state. *)
Definition in_range (m : model) (s : Z) : bool := (0 <=? s) && (s <? states m).

(* Return whether the weights of a row are positive and add up to its denominator. *)
Definition row_right (m : model) (p : pair) : bool :=
  in_range m (state p) && (0 <? denominator p) &&
  (fold_left Z.add (map weight (outcomes p)) 0 =? denominator p) &&
  forallb (fun o => (0 <? weight o) && in_range m (next o)) (outcomes p).

(* Return whether the first of two pairs comes before the second. *)
Definition before (both : pair * pair) : bool :=
  let (p, after) := both in
  (state p <? state after) || ((state p =? state after) && (action p <? action after)).

(* Return whether pairs are in the order of states and actions, each once. *)
Definition in_order (l : list pair) : bool := forallb before (combine l (tl l)).

(* Return whether a pair stays in its state and earns nothing. *)
Definition stays (p : pair) : bool :=
  (fst (reward_sum p) =? 0) && forallb (fun o => next o =? state p) (outcomes p).

(* Return whether the start is a distribution of states. *)
Definition start_right (m : model) : bool :=
  let (top, below) := sum_of (map (fun sq => (1, ratio_of (snd sq))) (start m)) in
  (top =? below) && forallb (fun sq => in_range m (fst sq) && (0 <=? Qnum (snd sq))) (start m).

(* Return whether the goal, if there is one, consists of ends, at discount 1. *)
Definition goal_right (m : model) : bool :=
  match goal m with
  | None => true
  | Some g => is_one (discount m) && forallb (fun p => negb (g (state p)) || stays p) (pairs m)
  end.

(* Return whether a model is one, and the ends of the hints are ends. *)
Definition model_right (m : model) (hs : hints) : bool :=
  (0 <=? Qnum (discount m)) && (Qnum (discount m) <=? Zpos (Qden (discount m))) &&
  forallb (row_right m) (pairs m) && in_order (pairs m) && start_right m && goal_right m &&
  forallb (fun p => negb (ends hs (state p)) || stays p) (pairs m).

(* Return whether a policy takes a pair. *)
Definition taken (act : Z -> Z) (p : pair) : bool := act (state p) =? action p.

(* Return how many states there were, and whether they were 0, 1 and so on: with one more. *)
Definition count (so_far : Z * bool) (s : Z) : Z * bool :=
  let (expected, right) := so_far in
  (expected + 1, right && (s =? expected)).

(* Return whether a policy takes a pair in each of the states 0, 1 and so on. *)
Definition policy_right (m : model) (act : Z -> Z) : bool :=
  let (number, right) := fold_left count (map state (filter (taken act) (pairs m))) (0, true) in
  right && (number =? states m).

(* Return whether the denominators of a level are positive. *)
Definition level_right (m : model) (x : level) : bool :=
  forallb (fun p => 0 <? snd (x (state p))) (pairs m).

(* Return whether ranks are 0 or more. *)
Definition rank_right (m : model) (rank : Z -> Z) : bool :=
  forallb (fun p => 0 <=? rank (state p)) (pairs m).

(* Return whether a pair leads to such states only. *)
Definition all_next (p : pair) (f : Z -> bool) : bool :=
  forallb (fun o => f (next o)) (outcomes p).

(* Return whether a pair may lead to such a state. *)
Definition some_next (p : pair) (f : Z -> bool) : bool :=
  existsb (fun o => f (next o)) (outcomes p).

(* Return whether a pair may lead to a state inside, of a lower rank than its own. *)
Definition falls (p : pair) (rank : Z -> Z) (inside : Z -> bool) : bool :=
  some_next p (fun s => (rank s <? rank (state p)) && inside s).

(* ---- values: U ≥ r + γ P U, of the policy L ≤ r + γ P L; and runs end ----------------------- *)

(* Return whether there is a goal, and a state is not in it. *)
Definition beside_goal (m : model) (s : Z) : bool :=
  match goal m with None => false | Some g => negb (g s) end.

(* Return whether the rank shows that runs end, where the values are those of an end. *)
Definition comes_to_an_end (m : model) (hs : hints) (low high : level) (rank : option (Z -> Z))
    (p : pair) : bool :=
  match rank with
  | None => true
  | Some rk =>
      if ends hs (state p)
      then negb (beside_goal m (state p)) && (fst (low (state p)) <=? 0) &&
        (0 <=? fst (high (state p)))
      else falls p rk (fun _ => true)
  end.

(* Return whether a pair satisfies its inequalities. *)
Definition values_pair (m : model) (hs : hints) (act : Z -> Z) (low high : level)
    (rank : option (Z -> Z)) (p : pair) : bool :=
  comes_to_an_end m hs low high rank p &&
  (surplus (discount m) (earned m p) p high <=? 0) &&
  (negb (taken act p) || (0 <=? surplus (discount m) (earned m p) p low)).

(* Return whether there is a rank at discount 1, and none below it. *)
Definition rank_fits (m : model) (rank : option (Z -> Z)) : bool :=
  match rank with
  | None => negb (is_one (discount m))
  | Some rk => is_one (discount m) && rank_right m rk
  end.

(* Return whether no policy is worth more than `high`, and this one at least `low`. *)
Definition values (m : model) (hs : hints) (act : Z -> Z) (low high : level)
    (rank : option (Z -> Z)) : bool :=
  rank_fits m rank && level_right m low && level_right m high &&
  forallb (values_pair m hs act low high rank) (pairs m).

(* ---- expansion: d(g), r - g + d(h), d(w) - h: the first that is not 0 is negative ----------- *)

(* Return the sign of d(g). *)
Definition g_surplus (g : level) (p : pair) : Z := surplus 1 (0, 1) p g.

(* Return the sign of r - g + d(h). *)
Definition h_surplus (m : model) (g h : level) (p : pair) : Z :=
  let (top, below) := earned m p in
  let (t, b) := g (state p) in
  surplus 1 (top * b - below * t, below * b) p h.

(* Return the sign of d(w) - h. *)
Definition w_surplus (h w : level) (p : pair) : Z :=
  let (t, b) := h (state p) in
  surplus 1 (- t, b) p w.

(* Return the first of the three that is not 0, or 0. *)
Definition first_surplus (m : model) (g h w : level) (p : pair) : Z :=
  let of_g := g_surplus g p in
  if of_g =? 0 then
    let of_h := h_surplus m g h p in
    if of_h =? 0 then w_surplus h w p else of_h
  else of_g.

(* Return whether a pair satisfies its inequalities, and the policy's are equations. *)
Definition expansion_pair (m : model) (act : Z -> Z) (g h w : level) (p : pair) : bool :=
  let sign := first_surplus m g h w p in
  (sign <=? 0) && (negb (taken act p) || (sign =? 0)).

(* Return whether all pairs do. *)
Definition expansion (m : model) (act : Z -> Z) (g h w : level) : bool :=
  level_right m g && level_right m h && level_right m w &&
  forallb (expansion_pair m act g h w) (pairs m).

(* ---- goals: `infinite` is 1 for states of +∞, -1 for states of -∞, and 0 for finite ones ---- *)

(* Return whether the value of a state is finite. *)
Definition finite (infinite : Z -> Z) (s : Z) : bool := infinite s =? 0.

(* Return whether the value of a state is -∞. *)
Definition never (infinite : Z -> Z) (s : Z) : bool := infinite s =? -1.

(* Return whether the value of a state is +∞. *)
Definition above (infinite : Z -> Z) (s : Z) : bool := infinite s =? 1.

(* Return whether a pair leads to no state of -∞. *)
Definition safe (infinite : Z -> Z) (p : pair) : bool :=
  all_next p (fun s => negb (never infinite s)).

(* Return whether the state of a pair, which is in the goal, is worth 0. *)
Definition of_goal (h : level) (infinite : Z -> Z) (p : pair) : bool :=
  finite infinite (state p) && (fst (h (state p)) =? 0).

(* Return whether a pair of a state of -∞ may lead to one of lower order, or keeps its order. *)
Definition of_never (order infinite : Z -> Z) (p : pair) : bool :=
  all_next p (fun s => never infinite s && (order s =? order (state p))) ||
  falls p order (never infinite).

(* Return whether a pair stays among states of +∞ and order 0, for a gain if one is needed. *)
Definition goes_round (m : model) (h : level) (order infinite : Z -> Z) (p : pair) : bool :=
  all_next p (fun s => above infinite s && (order s =? 0)) && (order (state p) =? 0) &&
  (negb (missing_is_least m) || (0 <? surplus 1 (earned m p) p h)).

(* Return whether the policy's pair of a state of +∞ proves it. *)
Definition of_above (m : model) (h : level) (order infinite : Z -> Z) (p : pair) : bool :=
  safe infinite p &&
  (goes_round m h order infinite p || falls p order (above infinite)).

(* Return whether a pair of a finite state satisfies its inequality, and may lower the rank. *)
Definition of_finite (m : model) (h : level) (rank infinite : Z -> Z) (by_policy : bool)
    (p : pair) : bool :=
  let inside := all_next p (finite infinite) in
  let gain := if inside then surplus 1 (earned m p) p h else -1 in
  finite infinite (state p) && (negb (safe infinite p) || inside) && (gain <=? 0) &&
  (negb by_policy || (gain =? 0)) &&
  ((missing_is_least m && negb by_policy) || falls p rank (finite infinite)).

(* Return whether a pair satisfies the rule of its state. *)
Definition reaching_pair (m : model) (h : level) (rank order infinite : Z -> Z) (g : Z -> bool)
    (act : Z -> Z) (p : pair) : bool :=
  if g (state p) then of_goal h infinite p
  else if never infinite (state p) && missing_is_least m then of_never order infinite p
  else if above infinite (state p) then negb (taken act p) || of_above m h order infinite p
  else of_finite m h rank infinite (taken act p) p.

(* Return whether a pair of a state of +∞ leads safely toward finite states. *)
Definition arrives (rank infinite : Z -> Z) (p : pair) : bool :=
  safe infinite p && (some_next p (finite infinite) || falls p rank (above infinite)).

(* Return the action that leads to the goal. *)
Definition arriving (infinite act out : Z -> Z) (s : Z) : Z :=
  if above infinite s then out s else act s.

(* Return whether a pair of the way out of +∞ leads toward finite states. *)
Definition way_pair (rank infinite act : Z -> Z) (p : pair) : bool :=
  negb (above infinite (state p) && taken act p) || arrives rank infinite p.

(* Return whether there is a safe way from all states of +∞. *)
Definition way_right (m : model) (rank infinite act out : Z -> Z) : bool :=
  policy_right m (arriving infinite act out) &&
  forallb (way_pair rank infinite (arriving infinite act out)) (pairs m).

(* Return whether all pairs satisfy the rules of a goal. *)
Definition reaching (m : model) (h : level) (rank order infinite : Z -> Z) (g : Z -> bool)
    (act out : Z -> Z) : bool :=
  level_right m h && rank_right m rank && rank_right m order &&
  forallb (reaching_pair m h rank order infinite g act) (pairs m) &&
  (negb (missing_is_least m) || way_right m rank infinite act out).

(* ---- the value of the start, in the model's own sign ---------------------------------------- *)

(* Return the term of one state in the mean of a level over the start. *)
Definition start_term (x : level) (sq : Z * Q) : Z * ratio :=
  let (t, b) := x (fst sq) in
  (Qnum (snd sq), (t, b * Zpos (Qden (snd sq)))).

(* Return whether a number is the mean of a level over the start. *)
Definition is_mean (m : model) (x : level) (v : extended) : bool :=
  match v with
  | Finite number =>
      let (top, below) := sum_of (map (start_term x) (start m)) in
      signed m (Qnum number) * below =? top * Zpos (Qden number)
  | _ => false
  end.

(* Return whether it is +∞ of rewards, -∞ of costs. *)
Definition is_most (m : model) (v : extended) : bool :=
  match v with
  | Finite _ => false
  | Plus_infinity => maximise m
  | Minus_infinity => negb (maximise m)
  end.

(* Return whether it is -∞ of rewards, +∞ of costs. *)
Definition is_least (m : model) (v : extended) : bool :=
  match v with
  | Finite _ => false
  | Plus_infinity => negb (maximise m)
  | Minus_infinity => maximise m
  end.

(* Return whether a run may begin in a state of the start. *)
Definition begins (sq : Z * Q) : bool := negb (Qnum (snd sq) =? 0).

(* Return whether the start value is that of the start states. *)
Definition start_value_right (m : model) (sign : Z -> Z) (x : level) (v : extended) : bool :=
  let up := existsb (fun sq => begins sq && (0 <? sign (fst sq))) (start m) in
  let down := existsb (fun sq => begins sq && (sign (fst sq) <? 0)) (start m) in
  if up then negb down && is_most m v
  else if down then is_least m v
  else is_mean m x v.

(* ---- optimal pairs, and whether states that these reach from the start have one each -------- *)

(* Return whether there is a goal, and a state is in it. *)
Definition in_goal (m : model) (s : Z) : bool :=
  match goal m with None => false | Some g => g s end.

(* Return whether a pair is optimal by g and h; of infinite totals, if it keeps the sign. *)
Definition expansion_optimal (m : model) (average : bool) (g h : level) (p : pair) : bool :=
  let (t, b) := g (state p) in
  if negb average && negb (t =? 0) then (t <? 0) || (0 <? surplus 1 (t, b) p g)
  else (g_surplus g p =? 0) && (h_surplus m g h p =? 0).

(* Return whether a pair is optimal on the way to a goal. *)
Definition reaching_optimal (m : model) (h : level) (infinite : Z -> Z) (p : pair) : bool :=
  if in_goal m (state p) || (never infinite (state p) && missing_is_least m) then true
  else if above infinite (state p) then safe infinite p && some_next p (above infinite)
  else all_next p (finite infinite) && (surplus 1 (earned m p) p h =? 0).

(* Return whether a pair is optimal. *)
Definition optimal (m : model) (c : claim) (p : pair) : bool :=
  match c with
  | Values h _ => surplus (discount m) (earned m p) p h =? 0
  | Bounds _ _ _ => false
  | Expansion average g h _ => expansion_optimal m average g h p
  | Reaching h _ _ infinite => reaching_optimal m h infinite p
  end.

(* Return whether the first of two pairs is of an earlier state than the second. *)
Definition apart (both : pair * pair) : bool := let (p, after) := both in state p <? state after.

(* Return whether a pair is optimal in a state that is reached and no end. *)
Definition matters (m : model) (c : claim) (hs : hints) (p : pair) : bool :=
  reach hs (state p) && negb (ends hs (state p)) && optimal m c p.

(* Return whether states that optimal pairs reach from the start have one each, or end. *)
Definition one_each (m : model) (c : claim) (hs : hints) : bool :=
  let chosen := filter (matters m c hs) (pairs m) in
  forallb (fun sq => negb (begins sq) || reach hs (fst sq)) (start m) &&
  forallb (fun p => negb (reach hs (state p) && optimal m c p) || all_next p (reach hs))
    (pairs m) &&
  forallb apart (combine chosen (tl chosen)).

(* Return whether a state is on the way to the target. *)
Definition on_way (hs : hints) (s : Z) : bool := 0 <=? toward hs s.

(* Return whether a pair that goes along is optimal and leads on, unless it is at the target. *)
Definition leads_on (m : model) (c : claim) (hs : hints) (p : pair) : bool :=
  if toward hs (state p) =? 0 then state p =? target hs
  else optimal m c p && falls p (toward hs) (on_way hs).

(* Return whether optimal pairs lead from the start to the target. *)
Definition target_reached (m : model) (c : claim) (hs : hints) : bool :=
  policy_right m (along hs) && existsb (fun sq => begins sq && on_way hs (fst sq)) (start m) &&
  forallb (fun p => negb (on_way hs (state p) && taken (along hs) p) || leads_on m c hs p)
    (pairs m).

(* Return the pair of a state with an action, if there is one. *)
Definition find_pair (m : model) (s a : Z) : option pair :=
  find (fun p => (state p =? s) && (action p =? a)) (pairs m).

(* Return whether there is such a pair, and it is optimal. *)
Definition optimal_at (m : model) (c : claim) (s a : Z) : bool :=
  match find_pair m s a with None => false | Some p => optimal m c p end.

(* Return whether there is such a pair, and it leaves the state or earns. *)
Definition leaves (m : model) (s a : Z) : bool :=
  match find_pair m s a with None => false | Some p => negb (stays p) end.

(* Return whether optimal pairs reach a state that is no end and has two of them. *)
Definition two_somewhere (m : model) (c : claim) (hs : hints) : bool :=
  target_reached m c hs && negb (first hs =? second hs) &&
  optimal_at m c (target hs) (first hs) && optimal_at m c (target hs) (second hs) &&
  leaves m (target hs) (leaving hs).

(* ---- the whole ------------------------------------------------------------------------------ *)

(* Return whether a model has no goal. *)
Definition no_goal (m : model) : bool := match goal m with None => true | Some _ => false end.

(* Return 0, the sign of a value that is finite. *)
Definition zero (s : Z) : Z := 0.

(* Return the sign of a level. *)
Definition sign_of (g : level) (s : Z) : Z := fst (g s).

(* Return whether there is a goal, its rules are satisfied, and the start value is right. *)
Definition reaching_goal (m : model) (c : certificate) (hs : hints) (h : level)
    (rank order infinite : Z -> Z) : bool :=
  match goal m with
  | None => false
  | Some g =>
      reaching m h rank order infinite g (actions c) (way_out hs) &&
      start_value_right m infinite h (start_value c)
  end.

(* Return whether the start value of an expansion is right. Totals need discount 1 and no goal. *)
Definition expansion_start (m : model) (average : bool) (g h : level) (v : extended) : bool :=
  if average then is_mean m g v
  else is_one (discount m) && no_goal m && start_value_right m (sign_of g) h v.

(* Return whether a claim satisfies the rules of its kind, and the start value is right. *)
Definition proves (m : model) (c : certificate) (hs : hints) : bool :=
  match claims c with
  | Values h rank =>
      values m hs (actions c) h h rank && start_value_right m zero h (start_value c)
  | Bounds low high rank => values m hs (actions c) low high rank
  | Expansion average g h w =>
      expansion m (actions c) g h w && expansion_start m average g h (start_value c)
  | Reaching h rank order infinite => reaching_goal m c hs h rank order infinite
  end.

(* Return whether it is said rightly that the optimum is unique, or is not. *)
Definition uniqueness_right (m : model) (c : certificate) (hs : hints) : bool :=
  match claims c with
  | Bounds _ _ _ => true
  | _ => if unique c then one_each m (claims c) hs else two_somewhere m (claims c) hs
  end.

(* Return whether a certificate holds of a model: if so, its claims are theorems. *)
Definition check (m : model) (c : certificate) (hs : hints) : bool :=
  model_right m hs && policy_right m (actions c) && proves m c hs && uniqueness_right m c hs.
