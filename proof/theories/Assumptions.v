(* What the theorems assume: nothing. *)
From MDP Require Import Soundness LimitsProof FrontsProof.
Print Assumptions sound.
Print Assumptions limits_sound.
Print Assumptions front_sound.
