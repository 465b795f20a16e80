(* The model of two states of docs/reference/certificates.md, computed inside Coq: what its policy
   earns in n steps, which certificate of it is accepted, and what this proves. *)
From Coq Require Import ZArith QArith List.
From MDP Require Import Spec Checker Claims Soundness.
From MDP Require Import RegretChecker RegretClaims RegretProof.
Import ListNotations.
Open Scope Z_scope.

(* In state 0, wait earns 1 and stays with probability 1/2; stop earns 1 and ends in state 1. *)
Definition wait := Row 0 0 2 [Outcome 0 1 1; Outcome 1 1 1].
Definition stop := Row 0 1 1 [Outcome 1 1 1].
Definition rest := Row 1 0 1 [Outcome 1 1 0].
Definition example : model := Model 2 (1 # 2) true [(0, 1%Q)] [wait; stop; rest] None false.
Definition waiting : Z -> Z := fun _ => 0.

(* 4/3 in state 0, and 0 at the end *)
Definition h : level := fun s => if s =? 0 then (4, 3) else (0, 1).
Definition stated (start : Q) (is_unique : bool) : certificate :=
  Certificate waiting (Values h None) (Finite start) is_unique.
Definition found : hints :=
  Hints (fun s => s =? 1) (fun _ => true) waiting (fun _ => -1) waiting 0 0 0 0.

(* Waiting earns 0, 1, 5/4, 21/16 in so many steps, and 4/3 (1 - 4⁻⁶) in six. *)
Example earned_by_waiting :
  map (fun n => Qred (earns example (1 # 2) (stationary example waiting) n [] 0)) [0; 1; 2; 3; 6]%nat
  = [0; 1; 5 # 4; 21 # 16; 1365 # 1024]%Q.
Proof. vm_compute. reflexivity. Qed.

(* A policy that throws a coin in the first step, and then stops, earns 9/8. *)
Definition throwing : policy := fun hist s =>
  if s =? 1 then [(rest, 1%Q)]
  else match hist with [] => [(wait, 1 # 2); (stop, 1 # 2)] | _ => [(stop, 1%Q)] end%Q.
Example earned_by_throwing : Qred (earns example (1 # 2) throwing 2 [] 0) = 9 # 8.
Proof. vm_compute. reflexivity. Qed.

(* 4/3 is accepted, 5/4 is not, nor that there were a second optimal policy. *)
Example accepted : check example (stated (4 # 3) true) found = true.
Proof. vm_compute. reflexivity. Qed.
Example refused : check example (stated (5 # 4) true) found = false /\
  check example (stated (4 # 3) false) found = false.
Proof. vm_compute. split; reflexivity. Qed.

(* So no policy earns more than 4/3 in the limit. *)
Example optimum pi : valid example pi ->
  in_the_limit (fun eps n => earns example (1 # 2) pi n [] 0 <= (4 # 3) + eps)%Q.
Proof.
  intro V. destruct (sound _ _ _ accepted) as (_ & _ & _ & L & _).
  refine (proj1 (L 0 [] _) pi V). unfold is_state. cbn. split; [discriminate|reflexivity].
Qed.

(* A policy that waits with probability 1/4 each time earns 0, 1, 17/16 in so many steps, and 16/15
   in the limit: it loses 4/15. *)
Definition often (s a : Z) : Q := if s =? 0 then if a =? 0 then 1 # 4 else 3 # 4 else 1%Q.
Definition h_own : level := fun s => if s =? 0 then (16, 15) else (0, 1).
Definition drawing (lost : Q) : verdict :=
  Verdict (stated (4 # 3) true) often
    (Certificate waiting (Values h_own None) (Finite (16 # 15)) true) (Finite lost).
Example earned_by_drawing :
  map (fun n => Qred (earns example (1 # 2) (randomised example often) n [] 0)) [0; 1; 2; 3]%nat
  = [0; 1; 17 # 16; 273 # 256]%Q.
Proof. vm_compute. reflexivity. Qed.
Example verdict_accepted : check_regret example (drawing (4 # 15)) found found = true.
Proof. vm_compute. reflexivity. Qed.
Example verdict_refused : check_regret example (drawing 0) found found = false.
Proof. vm_compute. reflexivity. Qed.

(* So what it earns comes as close to 16/15 as one likes. *)
Example worth_of_drawing : exists lam C, (0 <= lam < 1 /\ forall n,
  (16 # 15) - pow lam n * C <= earns example (1 # 2) (randomised example often) n [] 0 <=
    (16 # 15) + pow lam n * C)%Q.
Proof.
  destruct (regret_sound _ _ _ _ verdict_accepted) as (_ & _ & ((lam & C & L & _ & X) & _) & _).
  exists lam, C. split; [exact L|]. intro n. refine (proj1 (X 0 n [] _)). unfold is_state. cbn.
  split; [discriminate|reflexivity].
Qed.
