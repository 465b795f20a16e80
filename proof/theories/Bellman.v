(* Values alone: below discount 1, and at discount 1 if ranks show that every run ends.

   The argument is one for both. There is a potential w ≥ 0 with γ P w ≤ λ w for some λ < 1, which
   is 1 with λ = γ below discount 1. What is bounded by C w in the end is bounded by λⁿ C w
     before n
   steps, so that U ≥ r + γ P U for all pairs bounds what any policy earns in n steps by
   U + λⁿ C w; and so from below. *)
From Coq Require Import ZArith QArith Qreduction Qfield List Bool Lqa Lia.
From MDP Require Import Spec Checker Arith Integers.
Import ListNotations.
Open Scope Q_scope.

(* If each step lowers w by the factor λ, then the error of a value vanishes like λⁿ w. *)
Section Weighted.
  Variables (m : model) (D : pair -> Prop) (A : Z -> Prop) (rew : pair -> Q) (gamma lam C : Q)
    (f w U : Z -> Q)
    (pi : policy).
  Hypotheses (wf : well_formed m) (gamma0 : 0 <= gamma) (lam0 : 0 <= lam) (C0 : 0 <= C) (pl :
    plays m D pi).
  Hypothesis closed : forall p, In p (pairs m) -> D p -> A (state p) -> forall o,
    In o (outcomes p) -> A (next o).
  Hypothesis shrinks : forall p, In p (pairs m) -> D p -> A (state p) -> gamma * mean p w <=
    lam * w (state p).
  Lemma weighted_upper :
    (forall p, In p (pairs m) -> D p -> A (state p) -> surplus_of gamma (rew p) p U <= 0) ->
    (forall s, is_state m s -> A s -> f s <= U s + C * w s) ->
    forall n h s, is_state m s -> A s -> run rew gamma f pi n h s <= U s + pow lam n * C * w s.
  Proof.
    intros up base. apply (run_upper m D A rew gamma f (fun n s => U s + pow lam n * C * w s)
      pi wf gamma0 pl closed).
    - intros s S As. cbn [pow]. specialize (base s S As). lra.
    - intros n p I Dp As. rewrite mean_plus, mean_times. specialize (up p I Dp As).
      unfold surplus_of in up.
      specialize (shrinks p I Dp As). cbn [pow]. pose proof (pow_nneg lam n lam0).
      assert (0 <= pow lam n * C) by nra. set (c := pow lam n * C) in *.
      setoid_replace (lam * pow lam n * C) with (lam * c) by (unfold c; ring).
      set (e := mean p w) in *. set (e' := mean p U) in *. nra.
  Qed.
  Lemma weighted_lower :
    (forall p, In p (pairs m) -> D p -> A (state p) -> 0 <= surplus_of gamma (rew p) p U) ->
    (forall s, is_state m s -> A s -> U s - C * w s <= f s) ->
    forall n h s, is_state m s -> A s -> U s - pow lam n * C * w s <= run rew gamma f pi n h s.
  Proof.
    intros lo base. apply (run_lower m D A rew gamma f (fun n s => U s - pow lam n * C * w s)
      pi wf gamma0 pl closed).
    - intros s S As. cbn [pow]. specialize (base s S As). lra.
    - intros n p I Dp As. specialize (lo p I Dp As). unfold surplus_of in lo.
      assert (X : mean p (fun s => U s - pow lam n * C * w s) ==
        mean p U - pow lam n * C * mean p w).
      { rewrite <- mean_times.
        assert (Y := mean_plus p (fun s => U s - pow lam n * C * w s)
          (fun s => pow lam n * C * w s)). cbv beta in Y.
        assert (Z : mean p (fun s => U s - pow lam n * C * w s + pow lam n * C * w s) ==
          mean p U).
        { apply mean_ext. intros. ring. }
        lra. }
      rewrite X.
      specialize (shrinks p I Dp As). cbn [pow]. pose proof (pow_nneg lam n lam0).
      assert (0 <= pow lam n * C) by nra. set (c := pow lam n * C) in *.
      setoid_replace (lam * pow lam n * C) with (lam * c) by (unfold c; ring).
      set (e := mean p w) in *. set (e' := mean p U) in *. nra.
  Qed.
End Weighted.

(* Ranks give such a potential.
Let p₀ be the least probability of an outcome, β = p₀ / 2, and K the
   highest rank. With w = 0 in a set T that is never left, and w = 2 - β^rank elsewhere, each pair
   that may lower the rank has P w ≤ (1 - β^K / 2) w. *)
Lemma least_prob m : well_formed m -> exists p0, 0 < p0 <= 1 /\
  forall p o, In p (pairs m) -> In o (outcomes p) -> p0 <= prob p o.
Proof.
  intro wf. assert (rows := wf_rows m wf).
  assert (X : forall l, (forall p, In p l -> row_ok m p) -> exists p0, 0 < p0 <= 1 /\
    forall p o, In p l -> In o (outcomes p) -> p0 <= prob p o).
  { induction l as [|p l IH]; intro R; [exists 1; split; [lra|easy]|].
    destruct IH as (q & q0 & H); [intros; apply R; now right|].
    assert (Rp := R p (or_introl eq_refl)). pose proof (den_pos m p Rp) as D.
    assert (d0 : 0 < 1 / inject_Z (denominator p)) by (apply Qlt_shift_div_l; lra).
    destruct (Qlt_le_dec q (1 / inject_Z (denominator p))) as [L|L].
    - exists q. split; [assumption|]. intros p' o [<-|I] Io; [|now apply H].
      pose proof (prob_least m p Rp o Io). lra.
    - exists (1 / inject_Z (denominator p)). split; [lra|].
      intros p' o [<-|I] Io; [now apply (prob_least m)|].
      specialize (H p' o I Io). lra. }
  apply X, rows.
Qed.
Lemma highest_rank m (rk : Z -> Z) : exists K, forall s, is_state m s -> (Z.to_nat (rk s) <=
  K)%nat.
Proof.
  destruct (states_list m) as [l L].
  assert (X : exists K, forall s, In s l -> (Z.to_nat (rk s) <= K)%nat).
  { clear L. induction l as [|a l [K H]]; [exists 0%nat; easy|].
    exists (K + Z.to_nat (rk a))%nat. intros s [<-|I]; [lia|]. specialize (H s I). lia. }
  destruct X as [K H]. exists K. auto.
Qed.
Lemma mean_drop m p w o : row_ok m p -> In o (outcomes p) -> (forall o, In o (outcomes p) ->
  w (next o) <= 2) ->
  mean p w <= 2 - prob p o * (2 - w (next o)).
Proof.
  intros R I B.
  assert (H : prob p o * (2 - w (next o)) <= sumQ (fun o => prob p o * (2 - w (next o)))
    (outcomes p)).
  { apply (sumQ_one (fun o => prob p o * (2 - w (next o)))); [|exact I]. intros y Iy.
    pose proof (prob_pos m p R y Iy). specialize (B y Iy). nra. }
  assert (S : sumQ (fun o => prob p o * (2 - w (next o))) (outcomes p) + mean p w == 2).
  { unfold mean. rewrite <- sumQ_plus.
    rewrite (sumQ_ext _ (fun o => prob p o * 2)) by (intros; ring).
    rewrite sumQ_times_right, (prob_sum m p R). lra. }
  lra.
Qed.

Record potential (w : Z -> Q) (T : Z -> bool) : Prop := {
  w_low : forall s, 0 <= w s; w_high : forall s, w s <= 2;
  w_in : forall s, T s = true -> w s == 0; w_out : forall s, T s = false -> 1 <= w s }.
Lemma rank_potential m (T : Z -> bool) (rk : Z -> Z) : well_formed m -> (forall s,
  is_state m s -> (0 <= rk s)%Z) ->
  exists lam w, 0 <= lam < 1 /\ potential w T /\
  forall p, In p (pairs m) ->
    (if T (state p) then forall o, In o (outcomes p) -> T (next o) = true
     else exists o, In o (outcomes p) /\ (rk (next o) < rk (state p))%Z) ->
    mean p w <= lam * w (state p).
Proof.
  intros wf rk0. destruct (least_prob m wf) as (p0 & P0 & least).
  destruct (highest_rank m rk) as [K HK]. set (be := p0 / 2).
  assert (be0 : 0 < be <= 1 # 2).
  { unfold be. split; [apply Qlt_shift_div_l; lra|apply Qle_shift_div_r; lra]. }
  assert (be1 : 0 <= be <= 1) by lra.
  set (w := fun s => if T s then 0 else 2 - pow be (Z.to_nat (rk s))).
  exists (1 - pow be K / 2), w.
  assert (BK : 0 < pow be K <= 1) by (split; [apply pow_pos; lra|now apply pow_le1]).
  assert (WW : potential w T).
  { assert (B : forall n, 0 < pow be n <= 1) by (split; [apply pow_pos; lra|now apply pow_le1]).
    split; intro s; unfold w; specialize (B (Z.to_nat (rk s))); destruct (T s); intros; lra ||
      discriminate. }
  assert (half : pow be K / 2 == pow be K * (1 # 2)) by (field).
  split; [rewrite half; lra|]. split; [exact WW|]. intros p I H. destruct (T (state p)) eqn:Ts.
  - rewrite (mean_ext p w (fun _ => 0)); [|intros o Io; apply (w_in w T WW); auto].
    rewrite (mean_const m p (wf_rows m wf p I)). rewrite (w_in w T WW _ Ts). lra.
  - destruct H as (o & Io & F). pose proof (wf_rows m wf p I) as R.
    destruct R as (Ss & Rd & Rs & Ro).
    assert (R : row_ok m p) by (repeat split; try assumption; try apply Ss; now apply Ro).
    pose proof (mean_drop m p w o R Io ltac:(intros; apply (w_high w T WW))) as X.
    destruct (Ro o Io) as [_ So]. pose proof (rk0 _ So) as r0. specialize (HK _ Ss).
    set (k := Z.to_nat (rk (state p))) in *. assert (k1 : (1 <= k)%nat) by lia.
    assert (Y : pow be (k - 1) <= 2 - w (next o)).
    { unfold w. destruct (T (next o)).
      - pose proof (pow_le1 be (k - 1) be1). lra.
      - assert (pow be (k - 1) <= pow be (Z.to_nat (rk (next o)))) by (apply pow_anti;
          [lra|lia]). lra. }
    assert (V : pow be k == be * pow be (k - 1)).
    { replace k with (S (k - 1))%nat at 1 by lia. reflexivity. }
    assert (W : w (state p) == 2 - pow be k) by (unfold w; rewrite Ts; reflexivity).
    pose proof (least p o I Io) as L. pose proof (pow_pos be (k - 1) ltac:(lra)) as Q0.
    pose proof (pow_anti be k K be1 HK) as KK.
    assert (p0 == 2 * be) by (unfold be; field).
    assert (p0 * pow be (k - 1) <= prob p o * (2 - w (next o))) by nra.
    pose proof (pow_pos be k ltac:(lra)). rewrite W, half.
    assert (0 <= pow be K * pow be k) by nra. nra.
Qed.

Lemma falls_ok p rk inside : falls p rk inside = true ->
  exists o, In o (outcomes p) /\ (rk (next o) < rk (state p))%Z /\ inside (next o) = true.
Proof.
  unfold falls, some_next. rewrite existsb_exists. intros (o & I & H). split_and. reflect. eauto.
Qed.
Lemma value_nneg x s : (0 < snd (x s))%Z -> (0 <= fst (x s))%Z -> 0 <= value x s.
Proof.
  intros. apply inject_pos in H. apply inject_nneg in H0. unfold value.
  apply Qle_shift_div_l; lra.
Qed.
Lemma value_npos x s : (0 < snd (x s))%Z -> (fst (x s) <= 0)%Z -> value x s <= 0.
Proof.
  intros. apply inject_pos in H. unfold value. apply Qle_shift_div_r; [lra|].
  rewrite Zle_Qle in H0. change (inject_Z 0) with 0 in H0. lra.
Qed.

(* What `values` shows; a policy of pairs with r + γ P low ≥ low earns `low`, too. *)
Theorem values_sound m hs a low high rank :
  model_right m hs = true -> policy_right m a = true -> values m hs a low high rank = true ->
  exists lam C, 0 <= lam < 1 /\ 0 <= C /\ forall s, is_state m s ->
    (forall pi n h, valid m pi -> earns m (discount m) pi n h s <= value high s + pow lam n * C)
      /\
    (forall pi n h, plays m (fun p => 0 <= surplus_of (discount m) (r m p) p (value low)) pi ->
      value low s - pow lam n * C <= earns m (discount m) pi n h s) /\
    (forall n h, value low s - pow lam n * C <= earns m (discount m) (stationary m a) n h s) /\
    (forall pi n h, valid m pi -> chance (beside_goal m) pi n h s <= pow lam n * C).
Proof.
  intros M P H. destruct (model_right_ok m hs M) as [wf ends_ok]. unfold values in H. split_and.
  rename H into fits.
  rename H0 into pairs_ok, H1 into high_pos, H2 into low_pos. rewrite forallb_forall in pairs_ok.
  apply (level_right_ok m a _ P) in high_pos, low_pos.
  destruct (bounded m (value high)) as (C1 & C10 & B1).
  destruct (bounded m (value low)) as (C2 & C20 & B2).
  set (C := C1 + C2 + 1).
  assert (up : forall p, In p (pairs m) -> surplus_of (discount m) (r m p) p (value high) <= 0).
  { intros p I. pose proof (wf_rows m wf p I) as R. specialize (pairs_ok p I).
    unfold values_pair in pairs_ok.
    split_and. reflect. destruct (earned_ok m p (proj1 (proj2 R))) as [r0 rq].
    now apply (surplus_le m _ _ (earned m p)). }
  assert (lo : forall p, In p (pairs m) -> taken a p = true -> 0 <= surplus_of (discount m)
    (r m p) p (value low)).
  { intros p I T. pose proof (wf_rows m wf p I) as R. specialize (pairs_ok p I).
    unfold values_pair in pairs_ok.
    apply andb_true_iff in pairs_ok. destruct pairs_ok as [_ G]. rewrite T in G. cbn in G.
    reflect.
    destruct (earned_ok m p (proj1 (proj2 R))) as [r0 rq].
    now apply (surplus_ge m _ _ (earned m p)). }
  assert (gamma0 : 0 <= discount m) by apply wf.
  assert (W : exists lam w, 0 <= lam < 1 /\ (forall s, 0 <= w s <= 2) /\
    (forall s, is_state m s -> 0 <= value high s + C * w s) /\
    (forall s, is_state m s -> value low s - C * w s <= 0) /\
    (forall p, In p (pairs m) -> discount m * mean p w <= lam * w (state p)) /\
    (forall s, is_state m s -> beside_goal m s = true -> discount m == 1 /\ 1 <= w s)).
  { unfold rank_fits in fits. destruct rank as [rk|].
    - apply andb_true_iff in fits. destruct fits as [one rk0]. apply is_one_ok in one.
      pose proof (rank_right_ok m a rk P rk0) as rk0'.
      destruct (rank_potential m (ends hs) rk wf rk0') as (lam & w & L & WW & step).
      assert (at_end : forall s, is_state m s -> ends hs s = true ->
        0 <= value high s /\ value low s <= 0 /\ beside_goal m s = false).
      { intros s Ss e. destruct (policy_pair m a s P Ss) as (p & I & <- & _).
        specialize (pairs_ok p I).
        unfold values_pair, comes_to_an_end in pairs_ok. rewrite e in pairs_ok.
        cbv iota in pairs_ok. rewrite !andb_true_iff in pairs_ok.
        destruct pairs_ok as [[[[G0 L0] U0] _] _]. reflect. split; [apply value_nneg; auto|].
        split; [apply value_npos; auto|]. now apply negb_true_iff. }
      exists lam, w. split; [exact L|]. split; [intro s; split; apply WW|].
      split; [|split; [|split]].
      + intros s Ss. destruct (ends hs s) eqn:e.
        * destruct (at_end s Ss e) as [? _]. rewrite (w_in w _ WW s e). lra.
        * pose proof (w_out w _ WW s e). specialize (B1 s Ss). unfold C. nra.
      + intros s Ss. destruct (ends hs s) eqn:e.
        * destruct (at_end s Ss e) as [_ [? _]]. rewrite (w_in w _ WW s e). lra.
        * pose proof (w_out w _ WW s e). specialize (B2 s Ss). unfold C. nra.
      + intros p I. rewrite one. rewrite Qmult_1_l. apply (step p I).
        destruct (ends hs (state p)) eqn:e.
        * intros o Io. destruct (ends_ok _ e p I eq_refl) as [_ stay]. rewrite (stay o Io).
          exact e.
        * specialize (pairs_ok p I). unfold values_pair, comes_to_an_end in pairs_ok.
          rewrite e in pairs_ok. cbv iota in pairs_ok. rewrite !andb_true_iff in pairs_ok.
          destruct pairs_ok as [[F _] _].
          apply falls_ok in F. destruct F as (o & ? & ? & _). eauto.
      + intros s Ss Ms. split; [exact one|]. apply (w_out w _ WW).
        destruct (ends hs s) eqn:e; [|reflexivity].
        destruct (at_end s Ss e) as (_ & _ & X). congruence.
    - exists (discount m), (fun _ => 1). apply negb_true_iff in fits.
      assert (discount m <= 1) by apply wf.
      assert (N : ~ discount m == 1) by (intro X; apply is_one_ok in X; congruence).
      assert (discount m < 1) by (destruct (Qlt_le_dec (discount m) 1); [assumption|]; exfalso;
        apply N; lra).
      repeat split; try lra.
      + intros s Ss. specialize (B1 s Ss). unfold C. lra.
      + intros s Ss. specialize (B2 s Ss). unfold C. lra.
      + intros p I. rewrite (mean_const m p (wf_rows m wf p I)). lra.
      + unfold beside_goal in H2. destruct (goal m) as [g|] eqn:G; [|discriminate].
        now destruct (wf_goal m wf g G). }
  destruct W as (lam & w & L & wb & hi0 & lo0 & step & mi). exists lam, (2 * C).
  assert (c0 : 0 <= C) by (unfold C; lra).
  split; [exact L|]. split; [lra|]. intros s Ss.
  assert (small : forall n, pow lam n * C * w s <= pow lam n * (2 * C)).
  { intro n. assert (0 <= pow lam n) by (apply pow_nneg; lra). specialize (wb s).
    assert (0 <= pow lam n * C) by nra. nra. }
  assert (lower : forall pi n h, plays m (fun p => 0 <= surplus_of (discount m) (r m p)
    p (value low)) pi ->
    value low s - pow lam n * C * 2 <= earns m (discount m) pi n h s).
  { intros pi n h pl.
    apply Qle_trans with (value low s - pow lam n * C * w s); [specialize (small n); lra|].
    apply (weighted_lower m (fun p => 0 <= surplus_of (discount m) (r m p) p (value low))
      (fun _ => True) (r m) (discount m) lam C
      (fun _ => 0) w (value low) pi); auto; lra. }
  assert (two : forall n, pow lam n * C * 2 == pow lam n * (2 * C)) by (intro; ring).
  split; [|split; [|split]].
  - intros pi n h V.
    apply Qle_trans with (value high s + pow lam n * C * w s); [|specialize (small n); lra].
    apply (weighted_upper m (fun _ => True) (fun _ => True) (r m) (discount m) lam C (fun _ => 0)
      w (value high) pi);
      auto; lra || (intros; auto).
  - intros pi n h pl. rewrite <- two. now apply lower.
  - intros n h. rewrite <- two. apply lower. intros h' t St.
    destruct (stationary_plays m a P h' t St) as [X Y]. split; [|exact Y].
    intros p q I. destruct (X p q I) as (? & ? & ? & ?). auto.
  - intros pi n h V.
    destruct (goal m) as [g|] eqn:G.
    + assert (g1 : discount m == 1) by now destruct (wf_goal m wf g G).
      apply Qle_trans with (0 + pow lam n * C * w s); [|specialize (small n); lra].
      apply (weighted_upper m (fun _ => True) (fun _ => True) (fun _ => 0)
        1 lam C _ w (fun _ => 0) pi); auto; try lra.
      * intros p I _ _. rewrite <- g1. auto.
      * intros p I _ _. unfold surplus_of. rewrite (mean_const m p (wf_rows m wf p I)). lra.
      * intros t St _. destruct (beside_goal m t) eqn:e.
        -- destruct (mi t St e). unfold C. nra.
        -- specialize (wb t). nra.
    + apply Qle_trans with 0.
      * apply (run_upper m (fun _ => True) (fun _ => True) (fun _ => 0) 1 _ (fun _ _ => 0) pi);
          auto; try lra.
        -- intros t _ _. unfold beside_goal. rewrite G. lra.
        -- intros k p I _ _. rewrite (mean_const m p (wf_rows m wf p I)). lra.
      * assert (0 <= pow lam n) by (apply pow_nneg; lra). nra.
Qed.
