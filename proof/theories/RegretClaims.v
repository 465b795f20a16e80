(* What a verdict that the checker accepts says. With Spec.v and Claims.v this is the statement to
   read: Claims.v says what the optimum is, and here is what the policy is worth. *)
From Coq Require Import ZArith QArith List Bool.
From MDP Require Import Spec Checker Claims RegretChecker.
Import ListNotations.
Open Scope Q_scope.

(* The policy that takes each pair of a state with its share, whatever happened before *)
Definition randomised (m : model) (share : Z -> Z -> Q) : policy := fun _ s =>
  map (fun p => (p, share (state p) (action p))) (filter (fun p => (state p =? s)%Z) (pairs m)).

(* ---- what a policy is worth, from every state and after every history ----------------------- *)

(* It earns V: for some λ < 1 and C, up to λⁿ C in n steps. And if there is a goal, then it has not
   reached it after n steps with probability at most λⁿ C. *)
Definition earns_value (m : model) (pi : policy) (V : Z -> Q) : Prop :=
  exists lam C, 0 <= lam < 1 /\ 0 <= C /\ forall s n hist, is_state m s ->
    V s - pow lam n * C <= earns m (discount m) pi n hist s <= V s + pow lam n * C /\
    chance (beside_goal m) pi n hist s <= pow lam n * C.

(* It earns n g + h in n steps, up to some C, so that g is its average reward per step. *)
Definition earns_average (m : model) (pi : policy) (g h : Z -> Q) : Prop :=
  exists C, 0 <= C /\ forall s n hist, is_state m s ->
    inject_Z (Z.of_nat n) * g s + h s - C <= earns m 1 pi n hist s <=
      inject_Z (Z.of_nat n) * g s + h s + C.

(* Its total at discount 1, the limit of discounted values as γ tends to 1, is h where g = 0, +∞
   where g > 0, and -∞ where g < 0. *)
Definition earns_limit (m : model) (pi : policy) (g h : Z -> Q) : Prop :=
  forall s hist, is_state m s ->
    (g s == 0 -> forall eps, 0 < eps -> near_one (fun gamma =>
      eventually (fun n => h s - eps <= earns m gamma pi n hist s <= h s + eps))) /\
    (0 < g s -> forall B, near_one (fun gamma =>
      eventually (fun n => B <= earns m gamma pi n hist s))) /\
    (g s < 0 -> forall B, near_one (fun gamma =>
      eventually (fun n => earns m gamma pi n hist s <= B))).

(* From finite states it reaches the goal with probability 1, and earns V until then; from all others
   it may miss the goal, and is worth what missing it is worth. *)
Definition earns_until (m : model) (g : Z -> bool) (pi : policy) (V : Z -> Q)
    (infinite : Z -> Z) : Prop :=
  forall s hist, is_state m s ->
    (infinite s = 0%Z -> arrives_surely g pi hist s /\
      in_the_limit (fun eps n => V s - eps <= earns m 1 pi n hist s <= V s + eps)) /\
    (infinite s <> 0%Z -> may_miss g pi hist s /\
      infinite s = if missing_is_least m then (-1)%Z else 1%Z).

(* What levels say of the policy, and of its value at the start. *)
Definition is_worth (m : model) (pi : policy) (c : certificate) : Prop :=
  match claims c with
  | Values h _ => earns_value m pi (value h) /\ start_mean m (value h) (start_value c)
  | Bounds _ _ _ => False
  | Expansion true g h _ =>
      earns_average m pi (value g) (value h) /\ start_mean m (value g) (start_value c)
  | Expansion false g h _ =>
      discount m == 1 /\ earns_limit m pi (value g) (value h) /\
      start_is m (fun s => fst (g s)) (value h) (start_value c)
  | Reaching h _ _ infinite =>
      exists g, goal m = Some g /\ earns_until m g pi (value h) infinite /\
      start_is m infinite (value h) (start_value c)
  end.

(* ---- what it loses -------------------------------------------------------------------------- *)

(* the best of all values, and the worst *)
Definition the_most (m : model) : extended :=
  if maximise m then Plus_infinity else Minus_infinity.
Definition the_least (m : model) : extended :=
  if maximise m then Minus_infinity else Plus_infinity.

(* The regret is the optimum less the value; of costs, the value less the optimum. It is +∞ if the
   optimum alone is the best of all values, or the value alone the worst. *)
Definition regret_is (m : model) (most mine lost : extended) : Prop :=
  match lost with
  | Finite q => exists a b, most = Finite a /\ mine = Finite b /\ q == own_sign m (a - b)
  | Plus_infinity => (most = the_most m /\ mine <> the_most m) \/
      (mine = the_least m /\ most <> the_least m)
  | Minus_infinity => False
  end.

(* The optimum is what its certificate says: no policy is worth more. The policy, which draws its
   actions by the shares, is worth what its levels say, in the same sense of a total or an average.
   The regret is the difference at the start. *)
Definition verdict_holds (m : model) (v : verdict) : Prop :=
  let pi := randomised m (share v) in
  holds m (optimum v) /\ valid m pi /\ is_worth m pi (own v) /\
  form_of (claims (optimum v)) = form_of (claims (own v)) /\
  regret_is m (start_value (optimum v)) (start_value (own v)) (regret v).
