(* What a proof of an optimum under limits says. With Spec.v this is the statement to read. *)
From Coq Require Import ZArith QArith List Bool.
From MDP Require Import Spec Checker Claims LimitsChecker.
Import ListNotations.
Open Scope Q_scope.

(* What pairs count for a limit, and the expected total of c over n steps from the start *)
Definition amount (l : limit) (p : pair) : Q := counts l (state p) (action p).
Definition total (m : model) (c : pair -> Q) (pi : policy) (n : nat) : Q :=
  sumQ (fun sq => snd sq * run c (discount m) (fun _ => 0) pi n [] (fst sq)) (start m).

(* π keeps the limits, each less t, in the limit of many steps. *)
Definition keeps_less (m : model) (ls : list limit) (t : Q) (pi : policy) : Prop :=
  forall l, In l ls -> in_the_limit (fun eps n => least l - t - eps <= total m (amount l) pi n).

(* what the visits earn: Σ x(p) r(p) *)
Definition visits_earn (m : model) (c : limited) : Q :=
  sumQ (fun p => value (fun s => visits c s (action p)) (state p) * r m p) (pairs m).

(* If the limits can be kept: some policy keeps them and earns what the visits earn, and no policy
   that keeps them earns more. Otherwise: some policy keeps the limits less the shift, which is
   positive, and no policy keeps them less anything smaller. *)
Definition limits_hold (m : model) (c : limited) : Prop :=
  well_formed m /\ exists best, valid m best /\
  if feasible c
  then keeps_less m (limits c) 0 best /\
    in_the_limit (fun eps n => visits_earn m c - eps <= total m (r m) best n) /\
    forall pi, valid m pi -> keeps_less m (limits c) 0 pi ->
      in_the_limit (fun eps n => total m (r m) pi n <= visits_earn m c + eps)
  else 0 < shift c /\ keeps_less m (limits c) (shift c) best /\
    forall pi t, valid m pi -> keeps_less m (limits c) t pi -> shift c <= t.
