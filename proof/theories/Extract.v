(* The checker as JSON, for to_python.py. Functions of Coq's library on integers, booleans and lists
   are left to Python, each under a name that the translator knows. *)
From Coq Require Import ZArith List Bool Extraction.
From MDP Require Import Spec Checker LimitsChecker FrontsChecker RegretChecker.
Extraction Language JSON.
Unset Extraction AutoInline.
Extract Constant Z.add => "z_add".
Extract Constant Z.sub => "z_sub".
Extract Constant Z.mul => "z_mul".
Extract Constant Z.opp => "z_neg".
Extract Constant Z.eqb => "z_eq".
Extract Constant Z.leb => "z_le".
Extract Constant Z.ltb => "z_lt".
Extract Constant Z.lcm => "z_lcm".
Extract Constant Z.div => "z_div".
Extract Constant negb => "bool_not".
Extract Constant fst => "pair_fst".
Extract Constant snd => "pair_snd".
Extract Constant forallb => "list_all".
Extract Constant existsb => "list_any".
Extract Constant filter => "list_filter".
Extract Constant find => "list_find".
Extract Constant map => "list_map".
Extract Constant combine => "list_zip".
Extract Constant tl => "list_tail".
Extract Constant fold_left => "list_fold".
Extract Constant app => "list_app".
Extract Constant flat_map => "list_flat".
Extract Constant grouped => "list_grouped".
Extraction "extracted.json" check optimal stays arrives check_limits check_front check_regret.
