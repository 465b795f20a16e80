(* What the theorems assume: nothing. *)
From MDP Require Import Soundness LimitsProof FrontsProof RegretProof.
Print Assumptions sound.
Print Assumptions limits_sound.
Print Assumptions front_sound.
Print Assumptions regret_sound.
