(* What a certificate that the checker accepts says. With Spec.v this is the statement to read.

   All levels are in numbers that are maximised, so that of costs they are the negatives; the start
   value alone has the model's own sign. "Every policy" means each that draws its actions with
   rational probabilities and may depend on the whole history. A limit is said in words of bounds:
   for every ε > 0 there is a number of steps from which on the bound holds. *)
From Coq Require Import ZArith QArith List Bool.
From MDP Require Import Spec Checker.
Import ListNotations.
Open Scope Q_scope.

(* F(n) holds for all n from some N on; and that for every ε > 0. *)
Definition eventually (F : nat -> Prop) : Prop := exists N, forall n, (N <= n)%nat -> F n.
Definition in_the_limit (F : Q -> nat -> Prop) : Prop :=
  forall eps, 0 < eps -> eventually (F eps).

(* ---- values: kind "total" by h alone, and "bounds" ------------------------------------------ *)

(* From every state and after every history, in the limit of many steps, no policy earns more than
   `high`, and the policy `best` earns at least `low`. *)
Definition between_in_the_limit (m : model) (best : policy) (low high : Z -> Q) : Prop :=
  forall s hist, is_state m s ->
    (forall pi, valid m pi ->
      in_the_limit (fun eps n => earns m (discount m) pi n hist s <= high s + eps)) /\
    in_the_limit (fun eps n => low s - eps <= earns m (discount m) best n hist s).

(* The same with a rate: for some λ < 1 and C, the rest after n steps is at most λⁿ C. And if there
   is a goal, then the probability that n steps have not reached it is at most λⁿ C, too. *)
Definition between (m : model) (best : policy) (low high : Z -> Q) : Prop :=
  exists lam C, 0 <= lam < 1 /\ 0 <= C /\ forall s, is_state m s ->
    (forall pi n hist, valid m pi ->
      earns m (discount m) pi n hist s <= high s + pow lam n * C) /\
    (forall n hist, low s - pow lam n * C <= earns m (discount m) best n hist s) /\
    (forall pi n hist, valid m pi -> chance (beside_goal m) pi n hist s <= pow lam n * C).

(* The optimal pairs are those with r + γ Σ p(s') V(s') = V(s); the other pairs have less; and every
   policy that plays optimal pairs only earns V. *)
Definition optimal_pairs (m : model) (V : Z -> Q) (opt : pair -> Prop) : Prop :=
  (forall p, In p (pairs m) ->
    (opt p <-> r m p + discount m * mean p V == V (state p)) /\
    (~ opt p -> r m p + discount m * mean p V < V (state p))) /\
  (forall pi, plays m opt pi -> forall s hist, is_state m s ->
    in_the_limit (fun eps n => V s - eps <= earns m (discount m) pi n hist s)).

(* ---- expansion: kind "average", and "total" by g, h and w ----------------------------------- *)

(* g is the greatest average reward per step: for some C and from every state, no policy earns more
   than n g + C in n steps, and `best` earns n g + h, up to C. *)
Definition average_optimum (m : model) (best : policy) (g h : Z -> Q) : Prop :=
  exists C, 0 <= C /\ forall s n hist, is_state m s ->
    (forall pi, valid m pi -> earns m 1 pi n hist s <= inject_Z (Z.of_nat n) * g s + C) /\
    inject_Z (Z.of_nat n) * g s + h s - C <= earns m 1 best n hist s <=
      inject_Z (Z.of_nat n) * g s + h s + C.

(* The optimal pairs are those with d(g) = 0 and r - g + d(h) = 0; and every policy that plays
   optimal pairs only earns n g + h in n steps, up to C, whatever else it does. *)
Definition average_pairs (m : model) (g h : Z -> Q) (opt : pair -> Prop) : Prop :=
  (forall p, In p (pairs m) ->
    (opt p <-> mean p g == g (state p) /\ r m p + mean p h == g (state p) + h (state p))) /\
  exists C, 0 <= C /\ forall pi, plays m opt pi -> forall s n hist, is_state m s ->
    inject_Z (Z.of_nat n) * g s + h s - C <= earns m 1 pi n hist s <=
      inject_Z (Z.of_nat n) * g s + h s + C.

(* The optimum of discounted values is g / (1 - γ) + h, up to a term of order 1 - γ: for some K and
   δ, for all γ from 1 - δ to 1 and all n, no policy earns more in n discounted steps than

       g / (1 - γ) + h + K (1 - γ) + γⁿ K / (1 - γ),

   and `best` earns at least g / (1 - γ) + h less the same rest, whose last term vanishes with n. *)
Definition laurent (m : model) (best : policy) (g h : Z -> Q) : Prop :=
  exists K delta, 0 <= K /\ 0 < delta <= 1 # 2 /\
    forall gamma, 1 - delta <= gamma < 1 -> forall s n hist, is_state m s ->
      let rest := K * (1 - gamma) + pow gamma n * (K / (1 - gamma)) in
      (forall pi, valid m pi -> earns m gamma pi n hist s <= g s / (1 - gamma) + h s + rest) /\
      g s / (1 - gamma) + h s - rest <= earns m gamma best n hist s.

(* F(γ) holds for all γ < 1 that are close enough to 1. *)
Definition near_one (F : Q -> Prop) : Prop :=
  exists delta, 0 < delta /\ forall gamma, 1 - delta <= gamma < 1 -> F gamma.

(* The total reward at discount 1, which is the limit of discounted values as γ tends to 1. Where
   g = 0 it is h: no policy earns more, and `best` earns it. Where g > 0 it is +∞: what `best` earns
   exceeds every B. Where g < 0 it is -∞: what any policy earns falls below every B. *)
Definition limit_total (m : model) (best : policy) (g h : Z -> Q) : Prop :=
  forall s hist, is_state m s ->
    (g s == 0 -> forall eps, 0 < eps -> near_one (fun gamma =>
      (forall pi, valid m pi -> eventually (fun n => earns m gamma pi n hist s <= h s + eps)) /\
      eventually (fun n => h s - eps <= earns m gamma best n hist s))) /\
    (0 < g s -> forall B, near_one (fun gamma =>
      eventually (fun n => B <= earns m gamma best n hist s))) /\
    (g s < 0 -> forall B, near_one (fun gamma =>
      forall pi, valid m pi -> eventually (fun n => earns m gamma pi n hist s <= B))).

(* ---- goals ---------------------------------------------------------------------------------- *)

(* the probability that n steps have not reached the goal: it consists of ends, so that what has
   reached it stays there *)
Definition missed (g : Z -> bool) : policy -> nat -> history -> Z -> Q :=
  chance (fun s => negb (g s)).

(* The policy reaches the goal with probability 1; or misses it with a positive probability. *)
Definition arrives_surely (g : Z -> bool) (pi : policy) (hist : history) (s : Z) : Prop :=
  in_the_limit (fun eps n => missed g pi n hist s <= eps).
Definition may_miss (g : Z -> bool) (pi : policy) (hist : history) (s : Z) : Prop :=
  exists delta, 0 < delta /\ eventually (fun n => delta <= missed g pi n hist s).

(* What the total reward until the goal is, where a run that misses the goal is worth -∞
   (`missing_is_least`) or +∞:

   finite states: `best` arrives surely and earns V, and no policy that arrives surely earns more;
       if missing is worth +∞, then every policy arrives surely;
   -∞: missing is worth -∞, and every policy may miss;
   +∞: if missing is worth +∞, then `best` may miss; if it is worth -∞, then for every B there is a
       policy that arrives surely and earns B or more, though no policy may attain +∞.             *)
Definition goal_optimum (m : model) (g : Z -> bool) (best : policy) (V : Z -> Q)
    (infinite : Z -> Z) : Prop :=
  forall s hist, is_state m s ->
    (infinite s = 0 \/ infinite s = -1 \/ infinite s = 1)%Z /\
    (infinite s = 0%Z ->
      arrives_surely g best hist s /\
      in_the_limit (fun eps n => V s - eps <= earns m 1 best n hist s <= V s + eps) /\
      (forall pi, valid m pi -> arrives_surely g pi hist s ->
        in_the_limit (fun eps n => earns m 1 pi n hist s <= V s + eps)) /\
      (missing_is_least m = false -> forall pi, valid m pi -> arrives_surely g pi hist s)) /\
    (infinite s = (-1)%Z ->
      missing_is_least m = true /\ forall pi, valid m pi -> may_miss g pi hist s) /\
    (infinite s = 1%Z -> missing_is_least m = false -> may_miss g best hist s) /\
    (infinite s = 1%Z -> missing_is_least m = true -> forall B, exists pi, valid m pi /\
      arrives_surely g pi [] s /\ eventually (fun n => B <= earns m 1 pi n [] s)).

(* ---- the value of the start ----------------------------------------------------------------- *)

(* A run begins in s with a positive probability. *)
Definition may_begin (m : model) (s : Z) : Prop := exists q, In (s, q) (start m) /\ 0 < q.

(* The start value is the mean of x over the start: of costs, the negative of it. *)
Definition own_sign (m : model) (q : Q) : Q := if maximise m then q else - q.
Definition start_mean (m : model) (x : Z -> Q) (v : extended) : Prop :=
  match v with
  | Finite q => own_sign m q == sumQ (fun sq => snd sq * x (fst sq)) (start m)
  | _ => False
  end.

(* It is that mean, if no state in which a run may begin has an infinite value; otherwise it has the
   sign of those that have one. A start that mixes both signs has no value. *)
Definition start_is (m : model) (sign : Z -> Z) (x : Z -> Q) (v : extended) : Prop :=
  ((forall s, may_begin m s -> sign s = 0%Z) /\ start_mean m x v) \/
  ((exists s, may_begin m s /\ (0 < sign s)%Z) /\
    (forall s, may_begin m s -> (0 <= sign s)%Z) /\
    v = if maximise m then Plus_infinity else Minus_infinity) \/
  ((exists s, may_begin m s /\ (sign s < 0)%Z) /\
    (forall s, may_begin m s -> (sign s <= 0)%Z) /\
    v = if maximise m then Minus_infinity else Plus_infinity).

(* ---- whether the optimum is unique ---------------------------------------------------------- *)

(* the states that optimal pairs reach from the start *)
Inductive reached (m : model) (opt : pair -> Prop) : Z -> Prop :=
  | at_start s : may_begin m s -> reached m opt s
  | by_pair p o : reached m opt (state p) -> In p (pairs m) -> opt p -> In o (outcomes p) ->
      reached m opt (next o).

(* Unique: each of these states is an end, or has at most one optimal pair. Not unique: one of them
   is no end and has two. *)
Definition one_optimum (m : model) (opt : pair -> Prop) (is_unique : bool) : Prop :=
  if is_unique
  then forall s, reached m opt s -> is_end m s \/
    forall p q, In p (pairs m) -> In q (pairs m) -> state p = s -> state q = s ->
      opt p -> opt q -> p = q
  else exists s p q, reached m opt s /\ ~ is_end m s /\ In p (pairs m) /\ In q (pairs m) /\
    state p = s /\ state q = s /\ opt p /\ opt q /\ action p <> action q.

(* A run under the policy π may come to the state s with this history: every step of it has a
   positive probability. *)
Inductive meets (m : model) (pi : policy) : history -> Z -> Prop :=
  | meets_start s : may_begin m s -> meets m pi [] s
  | meets_next hist s p q o : meets m pi hist s -> In (p, q) (pi hist s) -> 0 < q ->
      In o (outcomes p) -> meets m pi ((s, action p) :: hist) (next o).

(* π earns V from the start: it is optimal, if V is the optimum. *)
Definition attains (m : model) (V : Z -> Q) (pi : policy) : Prop :=
  forall s, may_begin m s -> in_the_limit (fun eps n => V s - eps <= earns m (discount m) pi n [] s).

(* For totals by values alone, more is proven. Unique: whatever policy is optimal takes the actions
   `act` in each state that it meets and that is no end; at discount 0, where later rewards count
   for nothing, it may take others. Not unique: some optimal policy takes another one somewhere. *)
Definition one_policy (m : model) (V : Z -> Q) (act : Z -> Z) (is_unique : bool) : Prop :=
  if is_unique
  then 0 < discount m -> forall pi, valid m pi -> attains m V pi ->
    forall hist s, meets m pi hist s -> is_end m s \/
      forall p q, In (p, q) (pi hist s) -> 0 < q -> action p = act s
  else exists pi, valid m pi /\ attains m V pi /\
    exists hist s p q, meets m pi hist s /\ ~ is_end m s /\
      In (p, q) (pi hist s) /\ 0 < q /\ action p <> act s.

(* ---- the whole ------------------------------------------------------------------------------ *)

Definition holds (m : model) (c : certificate) : Prop :=
  let best := stationary m (actions c) in
  let opt p := optimal m (claims c) p = true in
  well_formed m /\ valid m best /\
  match claims c with
  | Values h _ =>
      between m best (value h) (value h) /\ between_in_the_limit m best (value h) (value h) /\
      start_mean m (value h) (start_value c) /\ optimal_pairs m (value h) opt /\
      one_optimum m opt (unique c) /\ one_policy m (value h) (actions c) (unique c)
  | Bounds low high _ =>
      between m best (value low) (value high) /\
      between_in_the_limit m best (value low) (value high)
  | Expansion true g h _ =>
      average_optimum m best (value g) (value h) /\ laurent m best (value g) (value h) /\
      start_mean m (value g) (start_value c) /\ one_optimum m opt (unique c) /\
      average_pairs m (value g) (value h) opt
  | Expansion false g h _ =>
      discount m == 1 /\ laurent m best (value g) (value h) /\
      limit_total m best (value g) (value h) /\
      start_is m (fun s => fst (g s)) (value h) (start_value c) /\ one_optimum m opt (unique c)
  | Reaching h _ _ infinite =>
      exists g, goal m = Some g /\ goal_optimum m g best (value h) infinite /\
      start_is m infinite (value h) (start_value c) /\ one_optimum m opt (unique c)
  end.
