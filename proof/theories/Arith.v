(* Sums, means and powers of rationals, and the two inductions over steps on which all theorems
   rest. Nothing here speaks of certificates. *)
From Coq Require Import ZArith QArith Qreduction Qfield Qabs Qround List Bool Lqa Lia.
From MDP Require Import Spec Checker.
Import ListNotations.
Open Scope Q_scope.

(* ---- sums -----------------------------------------------------------------------------------
  *)

Lemma sumQ_ext {A} (f g : A -> Q) l : (forall x, In x l -> f x == g x) -> sumQ f l == sumQ g l.
Proof. induction l; simpl; intro H; [reflexivity|]. rewrite (H a), IHl; auto. reflexivity. Qed.
Lemma sumQ_le {A} (f g : A -> Q) l : (forall x, In x l -> f x <= g x) -> sumQ f l <= sumQ g l.
Proof.
  induction l; simpl; intro H; [lra|].
  assert (f a <= g a) by auto. assert (sumQ f l <= sumQ g l) by auto. lra.
Qed.
Lemma sumQ_plus {A} (f g : A -> Q) l : sumQ (fun x => f x + g x) l == sumQ f l + sumQ g l.
Proof. induction l; simpl; [lra|]. rewrite IHl. lra. Qed.
Lemma sumQ_times {A} c (f : A -> Q) l : sumQ (fun x => c * f x) l == c * sumQ f l.
Proof. induction l; simpl; [lra|]. rewrite IHl. lra. Qed.
Lemma sumQ_times_right {A} c (f : A -> Q) l : sumQ (fun x => f x * c) l == sumQ f l * c.
Proof. induction l; simpl; [lra|]. rewrite IHl. lra. Qed.
Lemma sumQ_map {A B} (k : A -> B) f l : sumQ f (map k l) = sumQ (fun x => f (k x)) l.
Proof. induction l; simpl; [|rewrite IHl]; reflexivity. Qed.
Lemma sumQ_sumZ {A} (f : A -> Z) l : sumQ (fun x => inject_Z (f x)) l == inject_Z (sumZ f l).
Proof. induction l; simpl; [reflexivity|]. rewrite IHl, inject_Z_plus. reflexivity. Qed.
Lemma sumQ_pos {A} (f : A -> Q) l : (forall x, In x l -> 0 <= f x) -> 0 <= sumQ f l.
Proof.
  induction l; simpl; intro H; [lra|]. assert (0 <= f a) by auto. assert (0 <= sumQ f l) by auto.
  lra.
Qed.
Lemma sumQ_one {A} (f : A -> Q) l x : (forall y, In y l -> 0 <= f y) -> In x l -> f x <= sumQ f l.
Proof.
  induction l as [|a l IH]; simpl; intros H I; [easy|]. destruct I as [->|I].
  - assert (0 <= sumQ f l) by (apply sumQ_pos; auto). lra.
  - assert (0 <= f a) by auto. assert (f x <= sumQ f l) by auto. lra.
Qed.

Lemma inject_pos z : (0 < z)%Z -> 0 < inject_Z z.
Proof. intro. change 0 with (inject_Z 0). now rewrite <- Zlt_Qlt. Qed.
Lemma inject_nneg z : (0 <= z)%Z -> 0 <= inject_Z z.
Proof. intro. change 0 with (inject_Z 0). now rewrite <- Zle_Qle. Qed.
Lemma inject_ge1 z : (0 < z)%Z -> 1 <= inject_Z z.
Proof. intro. change 1 with (inject_Z 1). rewrite <- Zle_Qle. lia. Qed.

(* The probabilities of a row are positive and sum to 1; so its mean is monotone and linear. *)
Section Row.
  Variables (m : model) (p : pair).
  Hypothesis ok : row_ok m p.
  Lemma den_pos : 0 < inject_Z (denominator p).
  Proof. destruct ok as (_ & ? & _). now apply inject_pos. Qed.
  Lemma prob_pos o : In o (outcomes p) -> 0 < prob p o.
  Proof.
    destruct ok as (_ & _ & _ & H). intro I. destruct (H o I) as [W _]. unfold prob.
    apply Qlt_shift_div_l; [apply den_pos|]. rewrite Qmult_0_l. now apply inject_pos.
  Qed.
  Lemma prob_least o : In o (outcomes p) -> 1 / inject_Z (denominator p) <= prob p o.
  Proof.
    destruct ok as (_ & _ & _ & H). intro I. destruct (H o I) as [W _]. unfold prob.
    pose proof den_pos. apply Qmult_le_compat_r; [now apply inject_ge1|].
    apply Qlt_le_weak, Qinv_lt_0_compat, den_pos.
  Qed.
  Lemma prob_sum : sumQ (prob p) (outcomes p) == 1.
  Proof.
    destruct ok as (_ & D & S & _). unfold prob.
    rewrite (sumQ_ext _ (fun o => / inject_Z (denominator p) * inject_Z (weight o))) by (intros;
      unfold Qdiv; ring).
    rewrite sumQ_times, sumQ_sumZ, S. field. pose proof den_pos. lra.
  Qed.
  Lemma mean_le f g : (forall o, In o (outcomes p) -> f (next o) <= g (next o)) -> mean p f <=
    mean p g.
  Proof.
    intro H. apply sumQ_le. intros o I. pose proof (prob_pos o I). specialize (H o I). nra.
  Qed.
  Lemma mean_ext f g : (forall o, In o (outcomes p) -> f (next o) == g (next o)) -> mean p f ==
    mean p g.
  Proof. intro H. apply sumQ_ext. intros o I. now rewrite (H o I). Qed.
  Lemma mean_plus f g : mean p (fun s => f s + g s) == mean p f + mean p g.
  Proof. unfold mean. rewrite <- sumQ_plus. apply sumQ_ext. intros. ring. Qed.
  Lemma mean_times c f : mean p (fun s => c * f s) == c * mean p f.
  Proof. unfold mean. rewrite <- sumQ_times. apply sumQ_ext. intros. ring. Qed.
  Lemma mean_const c : mean p (fun _ => c) == c.
  Proof. unfold mean. rewrite sumQ_times_right, prob_sum. ring. Qed.
End Row.

(* A mixture is at most the greatest of what is mixed, and at least the least. *)
Lemma mix_le (v : pair -> Q) B l : (forall p q, In (p, q) l -> 0 <= q /\ v p <= B) ->
  sumQ snd l == 1 -> sumQ (fun c => snd c * v (fst c)) l <= B.
Proof.
  intros H S. assert (sumQ (fun c : pair * Q => snd c * v (fst c)) l <= sumQ (fun c => snd c * B)
    l).
  { apply sumQ_le. intros [p q] I. destruct (H p q I). simpl. nra. }
  rewrite sumQ_times_right, S in H0. lra.
Qed.
Lemma mix_ge (v : pair -> Q) B l : (forall p q, In (p, q) l -> 0 <= q /\ B <= v p) ->
  sumQ snd l == 1 -> B <= sumQ (fun c => snd c * v (fst c)) l.
Proof.
  intros H S. assert (sumQ (fun c => snd c * B) l <= sumQ (fun c : pair * Q => snd c * v (fst c))
    l).
  { apply sumQ_le. intros [p q] I. destruct (H p q I). simpl. nra. }
  rewrite sumQ_times_right, S in H0. lra.
Qed.

(* The two inductions over steps. Let a policy play pairs of a set D only, and stay in a set A of
   states from which these lead to states of A only.
   If X(0) is at least what a run is worth in the
   end, and X(n + 1) at least what any such pair and X(n) give, then X(n) is at least what n steps
   are worth. The same holds with at most. *)
Section Runs.
  Variables (m : model) (D : pair -> Prop) (A : Z -> Prop) (rew : pair -> Q) (gamma : Q) (f :
    Z -> Q)
    (X : nat -> Z -> Q) (pi : policy).
  Hypotheses (wf : well_formed m) (gamma0 : 0 <= gamma) (pl : plays m D pi).
  Hypothesis closed : forall p, In p (pairs m) -> D p -> A (state p) -> forall o,
    In o (outcomes p) -> A (next o).
  Lemma run_upper :
    (forall s, is_state m s -> A s -> f s <= X 0%nat s) ->
    (forall n p, In p (pairs m) -> D p -> A (state p) -> rew p + gamma * mean p (X n) <= X (S n)
      (state p)) ->
    forall n h s, is_state m s -> A s -> run rew gamma f pi n h s <= X n s.
  Proof.
    intros base step n. induction n; intros h s St As; [now apply base|]. cbn [run].
    destruct (pl h s St) as [H S1].
    apply (mix_le (fun p => rew p + gamma * mean p (run rew gamma f pi n ((s, action p) :: h))));
      [|exact S1].
    intros p q I. destruct (H p q I) as (Ip & <- & q0 & Dp). split; [exact q0|].
    apply Qle_trans with (2 := step n p Ip Dp As).
    pose proof (wf_rows m wf p Ip) as R.
    assert (mean p (run rew gamma f pi n ((state p, action p) :: h)) <= mean p (X n)).
    { apply (mean_le m p R). intros o Io. apply IHn.
      - destruct R as (_ & _ & _ & R). now apply R.
      - now apply (closed p). }
    nra.
  Qed.
  Lemma run_lower :
    (forall s, is_state m s -> A s -> X 0%nat s <= f s) ->
    (forall n p, In p (pairs m) -> D p -> A (state p) -> X (S n) (state p) <=
      rew p + gamma * mean p (X n)) ->
    forall n h s, is_state m s -> A s -> X n s <= run rew gamma f pi n h s.
  Proof.
    intros base step n. induction n; intros h s St As; [now apply base|]. cbn [run].
    destruct (pl h s St) as [H S1].
    apply (mix_ge (fun p => rew p + gamma * mean p (run rew gamma f pi n ((s, action p) :: h))));
      [|exact S1].
    intros p q I. destruct (H p q I) as (Ip & <- & q0 & Dp). split; [exact q0|].
    apply Qle_trans with (1 := step n p Ip Dp As).
    pose proof (wf_rows m wf p Ip) as R.
    assert (mean p (X n) <= mean p (run rew gamma f pi n ((state p, action p) :: h))).
    { apply (mean_le m p R). intros o Io. apply IHn.
      - destruct R as (_ & _ & _ & R). now apply R.
      - now apply (closed p). }
    nra.
  Qed.
End Runs.

(* There are finitely many states, so that any numbers of them have a bound. *)
Lemma bound_list (f : Z -> Q) (l : list Z) : exists C, 0 <= C /\ forall s, In s l -> - C <=
  f s <= C.
Proof.
  induction l as [|a l [C [C0 H]]]; [exists 0; split; [lra|easy]|].
  exists (C + Qabs.Qabs (f a)). pose proof (Qabs.Qabs_nonneg (f a)).
  pose proof (Qabs.Qle_Qabs (f a)). pose proof (Qabs.Qle_Qabs (- f a)).
  rewrite Qabs.Qabs_opp in H2. split; [lra|]. intros s [<-|I]; [lra|]. specialize (H s I). lra.
Qed.
Lemma states_list m : exists l, forall s, is_state m s -> In s l.
Proof.
  exists (map Z.of_nat (seq 0 (Z.to_nat (states m)))). intros s [H0 H1]. apply in_map_iff.
  exists (Z.to_nat s). split; [apply Z2Nat.id; lia|]. apply in_seq. lia.
Qed.
Lemma bounded m (f : Z -> Q) : exists C, 0 <= C /\ forall s, is_state m s -> - C <= f s <= C.
Proof.
  destruct (states_list m) as [l L]. destruct (bound_list f l) as [C [C0 H]]. exists C. auto.
Qed.

(* ---- powers ---------------------------------------------------------------------------------
  *)

Lemma pow_nneg x n : 0 <= x -> 0 <= pow x n.
Proof. intro. induction n; simpl; nra. Qed.
Lemma pow_pos x n : 0 < x -> 0 < pow x n.
Proof. intro. induction n; simpl; nra. Qed.
Lemma pow_le1 x n : 0 <= x <= 1 -> pow x n <= 1.
Proof. intro. induction n; simpl; [lra|]. pose proof (pow_nneg x n). nra. Qed.
Lemma pow_add x a b : pow x (a + b) == pow x a * pow x b.
Proof. induction a; simpl; [ring|]. rewrite IHa. ring. Qed.
Lemma pow_anti x a b : 0 <= x <= 1 -> (a <= b)%nat -> pow x b <= pow x a.
Proof.
  intros H L. replace b with (a + (b - a))%nat by lia. rewrite pow_add.
  pose proof (pow_le1 x (b - a) H). assert (0 <= pow x a) by (apply pow_nneg; lra). nra.
Qed.
(* Powers of λ < 1 vanish, by Bernoulli's inequality: λⁿ (1 + n (1 - λ)) ≤ 1. *)
Lemma pow_bernoulli x n : 0 <= x <= 1 -> pow x n * (1 + inject_Z (Z.of_nat n) * (1 - x)) <= 1.
Proof.
  intro H. induction n.
  { cbn [pow]. change (inject_Z (Z.of_nat 0)) with 0. lra. }
  cbn [pow]. rewrite Nat2Z.inj_succ, <- Z.add_1_r, inject_Z_plus.
  change (inject_Z 1) with 1. set (k := inject_Z (Z.of_nat n)) in *.
  assert (0 <= k) by (apply inject_nneg; lia).
  assert (P : 0 <= pow x n) by (apply pow_nneg; lra).
  assert (Y : x * (1 + (k + 1) * (1 - x)) <= 1 + k * (1 - x)).
  { assert (0 <= (k + 1) * ((1 - x) * (1 - x))) by (apply Qmult_le_0_compat; nra). nra. }
  apply Qle_trans with (2 := IHn).
  setoid_replace (x * pow x n * (1 + (k + 1) * (1 - x))) with (pow x n * (x * (1 + (k + 1)
    * (1 - x)))) by ring.
  set (u := x * _) in *. set (v := 1 + k * _) in *. nra.
Qed.
Lemma pow_vanishes x C eps : 0 <= x < 1 -> 0 <= C -> 0 < eps ->
  exists N, forall n, (N <= n)%nat -> pow x n * C <= eps.
Proof.
  intros [x0 x1] C0 e0. set (k := C / (eps * (1 - x))).
  assert (0 < eps * (1 - x)) by nra.
  assert (k0 : 0 <= k) by (apply Qle_shift_div_l; lra).
  exists (Z.to_nat (Qround.Qceiling k)). intros n L.
  assert (K : k <= inject_Z (Z.of_nat n)).
  { apply Qle_trans with (1 := Qround.Qle_ceiling k). rewrite <- Zle_Qle. lia. }
  assert (x01 : 0 <= x <= 1) by lra. pose proof (pow_bernoulli x n x01) as B.
  assert (P : 0 <= pow x n) by (apply pow_nneg; lra).
  assert (k * (eps * (1 - x)) == C) by (unfold k; field; split; lra).
  assert (C <= eps * (inject_Z (Z.of_nat n) * (1 - x))) by nra.
  assert (pow x n * (inject_Z (Z.of_nat n) * (1 - x)) <= 1) by lra.
  set (u := inject_Z (Z.of_nat n) * (1 - x)) in *.
  assert (pow x n * C <= pow x n * (eps * u)) by nra. nra.
Qed.
