(* The checker: a function of a model, a certificate and hints, in integers, with a yes or a no.

   It recurs through no list of its own: all, some, those that, the first that, the images of, and a
   fold are functions of Coq's library, so that what is extracted from it is easily Python. *)
From Coq Require Import ZArith QArith List Bool.
From MDP Require Import Spec.
Import ListNotations.
Open Scope Z_scope.

(* ---- certificates --------------------------------------------------------------------------- *)

(* A ratio is its top and its below, an integer and a positive one; a level has one of each state. *)
Definition ratio := (Z * Z)%type.
Definition level := Z -> ratio.
Definition value (x : level) (s : Z) : Q := (inject_Z (fst (x s)) / inject_Z (snd (x s)))%Q.

Inductive extended := Finite (number : Q) | Plus_infinity | Minus_infinity.

(* What is claimed, with the levels and ranks that prove it, by the rules of the format *)
Inductive claim :=
  | Values (h : level) (rank : option (Z -> Z))
  | Bounds (low high : level) (rank : option (Z -> Z))
  | Expansion (average : bool) (g h w : level)
  | Reaching (h : level) (rank order infinite : Z -> Z).
Record certificate := Certificate {
  actions : Z -> Z; claims : claim; start_value : extended; unique : bool }.

(* What a program without proof finds, and this one tests, so that a wrong hint can only refuse:
   which states are ends; which ones optimal pairs reach from the start; for states of +∞, the
   actions that lead to finite ones; and the way to a state with two optimal actions: a state of the
   start, actions and next states from there, the two, and one that leaves the state or earns. *)
Record hints := Hints {
  ends : Z -> bool; reach : Z -> bool; way_out : Z -> Z;
  from : Z; way : list (Z * Z); first : Z; second : Z; leaving : Z }.

(* ---- arithmetic ----------------------------------------------------------------------------- *)

(* Σ times · (top / below), over one denominator *)
Definition add_term (sum : ratio) (term : Z * ratio) : ratio :=
  let (top, below) := sum in
  let (times, x) := term in
  let (t, b) := x in
  if b =? below then (top + times * t, below)
  else
    let unit := Z.lcm below b in
    (top * (unit / below) + times * t * (unit / b), unit).
Definition sum_of (terms : list (Z * ratio)) : ratio := fold_left add_term terms (0, 1).

Definition ratio_of (q : Q) : ratio := (Qnum q, Zpos (Qden q)).
Definition is_one (q : Q) : bool := Qnum q =? Zpos (Qden q).

(* the sum of weight · reward, and r, in numbers that are maximised *)
Definition reward_sum (p : pair) : ratio :=
  sum_of (map (fun o => (weight o, ratio_of (reward o))) (outcomes p)).
Definition signed (m : model) (x : Z) : Z := if maximise m then x else - x.
Definition earned (m : model) (p : pair) : ratio :=
  let (top, below) := reward_sum p in (signed m top, below * denominator p).

(* c + γ Σ p(s') x(s') - x(s), times a positive integer *)
Definition surplus (gamma : Q) (c : ratio) (p : pair) (x : level) : Z :=
  let scale := Zpos (Qden gamma) * denominator p in
  let ahead := map (fun o => (Qnum gamma * weight o, x (next o))) (outcomes p) in
  let (top, below) := sum_of ((- scale, x (state p)) :: ahead) in
  fst c * scale * below + snd c * top.

(* ---- the model and the policy --------------------------------------------------------------- *)

Definition in_range (m : model) (s : Z) : bool := (0 <=? s) && (s <? states m).

Definition row_right (m : model) (p : pair) : bool :=
  in_range m (state p) && (0 <? denominator p) &&
  (fold_left Z.add (map weight (outcomes p)) 0 =? denominator p) &&
  forallb (fun o => (0 <? weight o) && in_range m (next o)) (outcomes p).

(* pairs are in the order of states and actions, each once *)
Definition before (both : pair * pair) : bool :=
  let (p, q) := both in
  (state p <? state q) || ((state p =? state q) && (action p <? action q)).
Definition in_order (l : list pair) : bool := forallb before (combine l (tl l)).

Definition stays (p : pair) : bool :=
  (fst (reward_sum p) =? 0) && forallb (fun o => next o =? state p) (outcomes p).

Definition start_right (m : model) : bool :=
  let (top, below) := sum_of (map (fun sq => (1, ratio_of (snd sq))) (start m)) in
  (top =? below) && forallb (fun sq => in_range m (fst sq) && (0 <=? Qnum (snd sq))) (start m).
Definition goal_right (m : model) : bool :=
  match goal m with
  | None => true
  | Some g => is_one (discount m) && forallb (fun p => negb (g (state p)) || stays p) (pairs m)
  end.
Definition model_right (m : model) (hs : hints) : bool :=
  (0 <=? Qnum (discount m)) && (Qnum (discount m) <=? Zpos (Qden (discount m))) &&
  forallb (row_right m) (pairs m) && in_order (pairs m) && start_right m && goal_right m &&
  forallb (fun p => negb (ends hs (state p)) || stays p) (pairs m).

(* every state has a pair with the action of the policy: their states are 0, 1, …, in this order *)
Definition taken (act : Z -> Z) (p : pair) : bool := act (state p) =? action p.
Definition count (expected : option Z) (s : Z) : option Z :=
  match expected with
  | None => None
  | Some i => if s =? i then Some (i + 1) else None
  end.
Definition policy_right (m : model) (act : Z -> Z) : bool :=
  match fold_left count (map state (filter (taken act) (pairs m))) (Some 0) with
  | None => false
  | Some n => n =? states m
  end.

(* for all states, since each has a pair *)
Definition level_right (m : model) (x : level) : bool :=
  forallb (fun p => 0 <? snd (x (state p))) (pairs m).
Definition rank_right (m : model) (rank : Z -> Z) : bool :=
  forallb (fun p => 0 <=? rank (state p)) (pairs m).

(* a pair leads to such states only, may lead to one, and may lead to one of a lower rank *)
Definition all_next (p : pair) (f : Z -> bool) : bool :=
  forallb (fun o => f (next o)) (outcomes p).
Definition some_next (p : pair) (f : Z -> bool) : bool :=
  existsb (fun o => f (next o)) (outcomes p).
Definition falls (p : pair) (rank : Z -> Z) (inside : Z -> bool) : bool :=
  some_next p (fun s => (rank s <? rank (state p)) && inside s).

(* ---- values: U ≥ r + γ P U for all pairs, L ≤ r + γ P L for the policy's; every run ends ----- *)

Definition beside_goal (m : model) (s : Z) : bool :=
  match goal m with None => false | Some g => negb (g s) end.
Definition comes_to_an_end (m : model) (hs : hints) (low high : level) (rank : option (Z -> Z))
    (p : pair) : bool :=
  match rank with
  | None => true
  | Some rank =>
      if ends hs (state p)
      then negb (beside_goal m (state p)) && (fst (low (state p)) <=? 0) &&
        (0 <=? fst (high (state p)))
      else falls p rank (fun _ => true)
  end.
Definition values_pair (m : model) (hs : hints) (act : Z -> Z) (low high : level)
    (rank : option (Z -> Z)) (p : pair) : bool :=
  comes_to_an_end m hs low high rank p &&
  (surplus (discount m) (earned m p) p high <=? 0) &&
  (negb (taken act p) || (0 <=? surplus (discount m) (earned m p) p low)).
Definition rank_fits (m : model) (rank : option (Z -> Z)) : bool :=
  match rank with
  | None => negb (is_one (discount m))
  | Some rank => is_one (discount m) && rank_right m rank
  end.
Definition values (m : model) (hs : hints) (act : Z -> Z) (low high : level)
    (rank : option (Z -> Z)) : bool :=
  rank_fits m rank && level_right m low && level_right m high &&
  forallb (values_pair m hs act low high rank) (pairs m).

(* ---- expansion: d(g), r - g + d(h), d(w) - h: the first that is not 0 is negative ------------- *)

Definition g_surplus (g : level) (p : pair) : Z := surplus 1 (0, 1) p g.
Definition h_surplus (m : model) (g h : level) (p : pair) : Z :=
  let (top, below) := earned m p in
  let (t, b) := g (state p) in
  surplus 1 (top * b - below * t, below * b) p h.
Definition w_surplus (h w : level) (p : pair) : Z :=
  let (t, b) := h (state p) in
  surplus 1 (- t, b) p w.
Definition first_surplus (m : model) (g h w : level) (p : pair) : Z :=
  let of_g := g_surplus g p in
  if of_g =? 0 then
    let of_h := h_surplus m g h p in
    if of_h =? 0 then w_surplus h w p else of_h
  else of_g.
Definition expansion_pair (m : model) (act : Z -> Z) (g h w : level) (p : pair) : bool :=
  let first := first_surplus m g h w p in
  (first <=? 0) && (negb (taken act p) || (first =? 0)).
Definition expansion (m : model) (act : Z -> Z) (g h w : level) : bool :=
  level_right m g && level_right m h && level_right m w &&
  forallb (expansion_pair m act g h w) (pairs m).

(* ---- goals: `infinite` is 1 for states of +∞, -1 for states of -∞, and 0 for finite ones ------ *)

Definition finite (infinite : Z -> Z) (s : Z) : bool := infinite s =? 0.
Definition never (infinite : Z -> Z) (s : Z) : bool := infinite s =? -1.
Definition above (infinite : Z -> Z) (s : Z) : bool := infinite s =? 1.

(* The pair leads to no state of -∞. *)
Definition safe (infinite : Z -> Z) (p : pair) : bool :=
  all_next p (fun s => negb (never infinite s)).

Definition of_goal (h : level) (infinite : Z -> Z) (p : pair) : bool :=
  finite infinite (state p) && (fst (h (state p)) =? 0).
Definition of_never (order infinite : Z -> Z) (p : pair) : bool :=
  all_next p (fun s => never infinite s && (order s =? order (state p))) ||
  falls p order (never infinite).
Definition goes_round (m : model) (h : level) (order infinite : Z -> Z) (p : pair) : bool :=
  all_next p (fun s => above infinite s && (order s =? 0)) && (order (state p) =? 0) &&
  (negb (missing_is_least m) || (0 <? surplus 1 (earned m p) p h)).
Definition of_above (m : model) (h : level) (order infinite : Z -> Z) (p : pair) : bool :=
  safe infinite p &&
  (goes_round m h order infinite p || falls p order (above infinite)).
Definition of_finite (m : model) (h : level) (rank infinite : Z -> Z) (by_policy : bool)
    (p : pair) : bool :=
  let inside := all_next p (finite infinite) in
  let gain := if inside then surplus 1 (earned m p) p h else -1 in
  finite infinite (state p) && (negb (safe infinite p) || inside) && (gain <=? 0) &&
  (negb by_policy || (gain =? 0)) &&
  ((missing_is_least m && negb by_policy) || falls p rank (finite infinite)).
Definition reaching_pair (m : model) (h : level) (rank order infinite : Z -> Z) (g : Z -> bool)
    (act : Z -> Z) (p : pair) : bool :=
  if g (state p) then of_goal h infinite p
  else if never infinite (state p) && missing_is_least m then of_never order infinite p
  else if above infinite (state p) then negb (taken act p) || of_above m h order infinite p
  else of_finite m h rank infinite (taken act p) p.

(* Where missing the goal is worth -∞, there is a safe way from states of +∞ to finite ones. *)
Definition arrives (rank infinite : Z -> Z) (p : pair) : bool :=
  safe infinite p && (some_next p (finite infinite) || falls p rank (above infinite)).
Definition arriving (infinite act out : Z -> Z) (s : Z) : Z :=
  if above infinite s then out s else act s.
Definition way_right (m : model) (rank infinite act out : Z -> Z) : bool :=
  policy_right m (arriving infinite act out) &&
  forallb (fun p => negb (above infinite (state p) && taken (arriving infinite act out) p) ||
    arrives rank infinite p) (pairs m).
Definition reaching (m : model) (h : level) (rank order infinite : Z -> Z) (g : Z -> bool)
    (act out : Z -> Z) : bool :=
  level_right m h && rank_right m rank && rank_right m order &&
  forallb (reaching_pair m h rank order infinite g act) (pairs m) &&
  (negb (missing_is_least m) || way_right m rank infinite act out).

(* ---- the value of the start, in the model's own sign ------------------------------------------ *)

Definition start_term (x : level) (sq : Z * Q) : Z * ratio :=
  let (t, b) := x (fst sq) in
  (Qnum (snd sq), (t, b * Zpos (Qden (snd sq)))).
Definition is_mean (m : model) (x : level) (v : extended) : bool :=
  match v with
  | Finite q =>
      let (top, below) := sum_of (map (start_term x) (start m)) in
      signed m (Qnum q) * below =? top * Zpos (Qden q)
  | _ => false
  end.
Definition is_most (m : model) (v : extended) : bool :=
  match v with Finite _ => false | Plus_infinity => maximise m | Minus_infinity => negb (maximise m) end.
Definition is_least (m : model) (v : extended) : bool :=
  match v with Finite _ => false | Plus_infinity => negb (maximise m) | Minus_infinity => maximise m end.
Definition begins (sq : Z * Q) : bool := negb (Qnum (snd sq) =? 0).
Definition start_right_with (m : model) (sign : Z -> Z) (x : level) (v : extended) : bool :=
  let up := existsb (fun sq => begins sq && (0 <? sign (fst sq))) (start m) in
  let down := existsb (fun sq => begins sq && (sign (fst sq) <? 0)) (start m) in
  if up then negb down && is_most m v
  else if down then is_least m v
  else is_mean m x v.

(* ---- optimal pairs, and whether states that these reach from the start have one each ---------- *)

Definition in_goal (m : model) (s : Z) : bool :=
  match goal m with None => false | Some g => g s end.
Definition expansion_optimal (m : model) (average : bool) (g h : level) (p : pair) : bool :=
  let (t, b) := g (state p) in
  if negb average && negb (t =? 0) then (t <? 0) || (0 <? surplus 1 (t, b) p g)
  else (g_surplus g p =? 0) && (h_surplus m g h p =? 0).
Definition reaching_optimal (m : model) (h : level) (infinite : Z -> Z) (p : pair) : bool :=
  if in_goal m (state p) then true
  else if never infinite (state p) && missing_is_least m then true
  else if above infinite (state p) then safe infinite p && some_next p (above infinite)
  else all_next p (finite infinite) && (surplus 1 (earned m p) p h =? 0).
Definition optimal (m : model) (c : claim) (p : pair) : bool :=
  match c with
  | Values h _ => surplus (discount m) (earned m p) p h =? 0
  | Bounds _ _ _ => false
  | Expansion average g h _ => expansion_optimal m average g h p
  | Reaching h _ _ infinite => reaching_optimal m h infinite p
  end.

Definition apart (both : pair * pair) : bool := let (p, q) := both in state p <? state q.
Definition one_each (m : model) (c : claim) (hs : hints) : bool :=
  let several := filter (fun p => reach hs (state p) && negb (ends hs (state p)) &&
    optimal m c p) (pairs m) in
  forallb (fun sq => negb (begins sq) || reach hs (fst sq)) (start m) &&
  forallb (fun p => negb (reach hs (state p) && optimal m c p) || all_next p (reach hs)) (pairs m) &&
  forallb apart (combine several (tl several)).

Definition pair_at (m : model) (s a : Z) : option pair :=
  find (fun p => (state p =? s) && (action p =? a)) (pairs m).
Definition leads (m : model) (c : claim) (s a t : Z) : bool :=
  match pair_at m s a with
  | None => false
  | Some p => optimal m c p && some_next p (fun s' => s' =? t)
  end.
Definition follow (m : model) (c : claim) (here : option Z) (step : Z * Z) : option Z :=
  match here with
  | None => None
  | Some s => if leads m c s (fst step) (snd step) then Some (snd step) else None
  end.
Definition optimal_at (m : model) (c : claim) (s a : Z) : bool :=
  match pair_at m s a with None => false | Some p => optimal m c p end.
Definition leaves (m : model) (s a : Z) : bool :=
  match pair_at m s a with None => false | Some p => negb (stays p) end.
Definition two_somewhere (m : model) (c : claim) (hs : hints) : bool :=
  match fold_left (follow m c) (way hs) (Some (from hs)) with
  | None => false
  | Some s =>
      existsb (fun sq => begins sq && (fst sq =? from hs)) (start m) &&
      negb (first hs =? second hs) && optimal_at m c s (first hs) &&
      optimal_at m c s (second hs) && leaves m s (leaving hs)
  end.

(* ---- the whole ------------------------------------------------------------------------------ *)

Definition no_goal (m : model) : bool := match goal m with None => true | Some _ => false end.
Definition zero (s : Z) : Z := 0.
Definition sign_of (g : level) (s : Z) : Z := fst (g s).
Definition reaching_goal (m : model) (c : certificate) (hs : hints) (h : level)
    (rank order infinite : Z -> Z) : bool :=
  match goal m with
  | None => false
  | Some g => reaching m h rank order infinite g (actions c) (way_out hs)
  end.
Definition proves (m : model) (c : certificate) (hs : hints) : bool :=
  match claims c with
  | Values h rank =>
      values m hs (actions c) h h rank && start_right_with m zero h (start_value c)
  | Bounds low high rank => values m hs (actions c) low high rank
  | Expansion average g h w =>
      expansion m (actions c) g h w &&
      (if average then is_mean m g (start_value c)
       else is_one (discount m) && no_goal m && start_right_with m (sign_of g) h (start_value c))
  | Reaching h rank order infinite =>
      reaching_goal m c hs h rank order infinite &&
      start_right_with m infinite h (start_value c)
  end.
Definition uniqueness_right (m : model) (c : certificate) (hs : hints) : bool :=
  match claims c with
  | Bounds _ _ _ => true
  | claim => if unique c then one_each m claim hs else two_somewhere m claim hs
  end.
Definition check (m : model) (c : certificate) (hs : hints) : bool :=
  model_right m hs && policy_right m (actions c) && proves m c hs && uniqueness_right m c hs.
