(* What the theorem assumes: nothing. *)
From MDP Require Import Soundness.
Print Assumptions sound.
