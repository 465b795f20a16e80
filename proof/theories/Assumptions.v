(* What the theorems assume: nothing. *)
From MDP Require Import Soundness LimitsProof.
Print Assumptions sound.
Print Assumptions limits_sound.
