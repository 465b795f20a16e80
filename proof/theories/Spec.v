(* Finite Markov decision processes, their policies, and what a policy earns in n steps.

   This file and Claims.v are all that a reader has to understand and believe. Every number is
   rational: there are no real numbers, no measures, and no limits as objects. *)
From Coq Require Import ZArith QArith List Bool.
Import ListNotations.
Open Scope Q_scope.

(* ---- models --------------------------------------------------------------------------------- *)

(* An outcome of a pair, of probability weight / denominator. It leads to the state `next` and earns
   `reward` on the way; the denominator is that of the pair. *)
Record outcome := Outcome { next : Z; weight : Z; reward : Q }.

(* A pair (s, a): the action a may be taken in the state s. *)
Record pair := Row { state : Z; action : Z; denominator : Z; outcomes : list outcome }.

(* A model as its file says, whose states are 0, 1, …, states - 1. *)
Record model := Model {
  states : Z;
  discount : Q;              (* γ *)
  maximise : bool;           (* true for "max", rewards; false for "min", costs *)
  start : list (Z * Q);      (* states in which a run may begin, with their probabilities *)
  pairs : list pair;
  goal : option (Z -> bool); (* the states that a run is meant to reach, if there is such a goal *)
  missing_is_least : bool    (* a run that never reaches the goal is worth -∞ (true) or +∞ (false),
                                in the numbers that are maximised *)
}.

Definition is_state (m : model) (s : Z) : Prop := (0 <= s < states m)%Z.

(* Sums over lists *)
Fixpoint sumQ {A} (f : A -> Q) (l : list A) : Q :=
  match l with [] => 0 | x :: l => f x + sumQ f l end.
Fixpoint sumZ {A} (f : A -> Z) (l : list A) : Z :=
  match l with [] => 0%Z | x :: l => (f x + sumZ f l)%Z end.

(* p(s'), the probability of an outcome *)
Definition prob (p : pair) (o : outcome) : Q := inject_Z (weight o) / inject_Z (denominator p).

(* Σ p(s') f(s'), the mean of f over the next state *)
Definition mean (p : pair) (f : Z -> Q) : Q := sumQ (fun o => prob p o * f (next o)) (outcomes p).

(* the mean reward of a pair in the model's own numbers, and r, the same in numbers that are
   maximised: costs are negated *)
Definition mean_reward (p : pair) : Q := sumQ (fun o => prob p o * reward o) (outcomes p).
Definition r (m : model) (p : pair) : Q :=
  if maximise m then mean_reward p else - mean_reward p.

(* The weights of a row are positive and add up to its denominator; it leads to states. *)
Definition row_ok (m : model) (p : pair) : Prop :=
  is_state m (state p) /\ (0 < denominator p)%Z /\ sumZ weight (outcomes p) = denominator p /\
  forall o, In o (outcomes p) -> (0 < weight o)%Z /\ is_state m (next o).

(* An end: all its pairs stay in it and earn nothing. *)
Definition is_end (m : model) (s : Z) : Prop :=
  forall p, In p (pairs m) -> state p = s ->
    mean_reward p == 0 /\ forall o, In o (outcomes p) -> next o = s.

Record well_formed (m : model) : Prop := {
  wf_discount : 0 <= discount m <= 1;
  wf_rows : forall p, In p (pairs m) -> row_ok m p;
  wf_once : NoDup (map (fun p => (state p, action p)) (pairs m));
  wf_start : sumQ snd (start m) == 1 /\ forall s q, In (s, q) (start m) -> is_state m s /\ 0 <= q;
  wf_goal : forall g, goal m = Some g ->
    discount m == 1 /\ forall s, is_state m s -> g s = true -> is_end m s
}.

(* ---- policies ------------------------------------------------------------------------------- *)

(* A policy sees the whole history, which is all earlier states and actions, the latest first, and
   the state. It answers with pairs and their probabilities, and may draw among several. *)
Definition history := list (Z * Z).
Definition policy := history -> Z -> list (pair * Q).

(* The policy π always answers with a distribution of pairs of the state, all of which have the
   property D. *)
Definition plays (m : model) (D : pair -> Prop) (pi : policy) : Prop :=
  forall hist s, is_state m s ->
    (forall p q, In (p, q) (pi hist s) -> In p (pairs m) /\ state p = s /\ 0 <= q /\ D p) /\
    sumQ snd (pi hist s) == 1.

(* Any policy at all: it may draw its actions, and may depend on the whole history. *)
Definition valid (m : model) (pi : policy) : Prop := plays m (fun _ => True) pi.

(* The stationary policy of a certificate: in the state s the pair with the action `act s`. *)
Definition stationary (m : model) (act : Z -> Z) : policy := fun _ s =>
  match find (fun p => (state p =? s)%Z && (action p =? act s)%Z) (pairs m) with
  | Some p => [(p, 1)] | None => [] end.

(* ---- runs ----------------------------------------------------------------------------------- *)

(* The expectation of n steps from the state s, after a history, under the policy π: the sum of
   rewards c, discounted by γ, and in the end f of the last state:

       run 0 s = f(s),   run (n + 1) s = Σ π(p) (c(p) + γ Σ p(s') run n s')                      *)
Fixpoint run (c : pair -> Q) (gamma : Q) (f : Z -> Q) (pi : policy) (n : nat) (hist : history)
    (s : Z) : Q :=
  match n with
  | O => f s
  | S k => sumQ (fun choice => snd choice * (c (fst choice) +
      gamma * mean (fst choice) (run c gamma f pi k ((s, action (fst choice)) :: hist))))
      (pi hist s)
  end.

(* the expected discounted reward of the first n steps *)
Definition earns (m : model) (gamma : Q) (pi : policy) (n : nat) (hist : history) (s : Z) : Q :=
  run (r m) gamma (fun _ => 0) pi n hist s.

(* the probability that after n steps the state is in a set *)
Definition chance (set : Z -> bool) (pi : policy) (n : nat) (hist : history) (s : Z) : Q :=
  run (fun _ => 0) 1 (fun t => if set t then 1 else 0) pi n hist s.

(* xⁿ *)
Fixpoint pow (x : Q) (n : nat) : Q := match n with O => 1 | S n => x * pow x n end.
