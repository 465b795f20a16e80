(* What the checker accepts, holds *)
From Coq Require Import ZArith QArith Qreduction Qabs Qminmax Qfield List Bool Lqa Lia.
From MDP Require Import Spec Checker Claims Arith Integers Bellman Laurent Goals.
Import ListNotations.
Open Scope Q_scope.

Lemma between_limits m best low high : between m best low high -> limits m best low high.
Proof.
  intros (lam & C & L & C0 & X) s h Ss. destruct (X s Ss) as (U & Lo & _). split; [intros pi V|]; intros eps e0;
    destruct (pow_vanishes lam C eps L C0 e0) as [N HN]; exists N; intros n Ln; specialize (HN n Ln).
  - specialize (U pi n h V). lra.
  - specialize (Lo n h). lra.
Qed.

Lemma rest_vanishes K gamma eps : 0 <= K -> 0 < eps -> 1 # 2 <= gamma < 1 -> K * (1 - gamma) * 2 <= eps ->
  eventually (fun n => K * (1 - gamma) + pow gamma n * (K / (1 - gamma)) <= eps).
Proof.
  intros K0 e0 G Hs. assert (c0 : 0 <= K / (1 - gamma)) by (apply Qle_shift_div_l; lra).
  assert (half : 0 < eps * (1 # 2)) by lra.
  destruct (pow_vanishes gamma (K / (1 - gamma)) (eps * (1 # 2)) ltac:(lra) c0 half) as [N HN]. exists N. intros n Ln.
  specialize (HN n Ln). lra.
Qed.
Lemma laurent_total m best g h : laurent m best g h -> limit_total m best g h.
Proof.
  intros (K & de & K0 & d0 & X) s hy Ss.
  assert (pick : forall eps, 0 < eps -> exists d, 0 < d <= de /\ K * d * 2 <= eps).
  { intros eps e0. assert (y0 : 0 < eps / (2 * (K + 1))) by (apply Qlt_shift_div_l; lra).
    assert (E1 : eps / (2 * (K + 1)) * (2 * (K + 1)) == eps) by (field; lra).
    set (y := eps / (2 * (K + 1))) in *. assert (0 <= K * y) by nra.
    destruct (Qlt_le_dec de y) as [L|L]; [exists de|exists y]; (split; [lra|]); nra. }
  split; [|split].
  - intros g0 eps e0. destruct (pick eps e0) as (d & D & Kd). exists d. split; [lra|]. intros gamma G.
    assert (G' : 1 - de <= gamma < 1) by lra. specialize (X gamma G').
    assert (Hs : K * (1 - gamma) * 2 <= eps) by nra.
    destruct (rest_vanishes K gamma eps K0 e0 ltac:(lra) Hs) as [N HN].
    assert (z : g s / (1 - gamma) == 0) by (rewrite g0; field; lra).
    split; [intros pi V|]; exists N; intros n Ln; specialize (HN n Ln); destruct (X s n hy Ss) as [U Lo].
    + specialize (U pi V). lra.
    + lra.
  - intros gp B. destruct (pick 1 ltac:(lra)) as (d & D & Kd).
    set (b := Qabs B + Qabs (h s) + 1). pose proof (Qabs_nonneg B). pose proof (Qabs_nonneg (h s)).
    set (d' := g s / b). assert (d'0 : 0 < d') by (unfold d', b; apply Qlt_shift_div_l; lra).
    exists (Qmin d d'). split; [apply Q.min_glb_lt; lra|]. intros gamma G.
    assert (m1 : Qmin d d' <= d) by apply Q.le_min_l. assert (m2 : Qmin d d' <= d') by apply Q.le_min_r.
    assert (G' : 1 - de <= gamma < 1) by lra. specialize (X gamma G').
    assert (Hs : K * (1 - gamma) * 2 <= 1) by nra.
    destruct (rest_vanishes K gamma 1 K0 ltac:(lra) ltac:(lra) Hs) as [N HN].
    assert (big : b <= g s / (1 - gamma)).
    { apply Qle_shift_div_l; [lra|]. assert (d' * b == g s) by (unfold d'; field; unfold b; lra).
      assert (0 < b) by (unfold b; lra). nra. }
    exists N. intros n Ln. specialize (HN n Ln). destruct (X s n hy Ss) as [_ Lo].
    pose proof (Qle_Qabs B). pose proof (Qle_Qabs (- h s)). rewrite Qabs_opp in H2. unfold b in big. lra.
  - intros gp B. destruct (pick 1 ltac:(lra)) as (d & D & Kd).
    set (b := Qabs B + Qabs (h s) + 1). pose proof (Qabs_nonneg B). pose proof (Qabs_nonneg (h s)).
    set (d' := - g s / b). assert (d'0 : 0 < d') by (unfold d', b; apply Qlt_shift_div_l; lra).
    exists (Qmin d d'). split; [apply Q.min_glb_lt; lra|]. intros gamma G.
    assert (m1 : Qmin d d' <= d) by apply Q.le_min_l. assert (m2 : Qmin d d' <= d') by apply Q.le_min_r.
    assert (G' : 1 - de <= gamma < 1) by lra. specialize (X gamma G').
    assert (Hs : K * (1 - gamma) * 2 <= 1) by nra.
    destruct (rest_vanishes K gamma 1 K0 ltac:(lra) ltac:(lra) Hs) as [N HN].
    assert (big : g s / (1 - gamma) <= - b).
    { apply Qle_shift_div_r; [lra|]. assert (d' * b == - g s) by (unfold d'; field; unfold b; lra).
      assert (0 < b) by (unfold b; lra). nra. }
    intros pi V. exists N. intros n Ln. specialize (HN n Ln). destruct (X s n hy Ss) as [U _]. specialize (U pi V).
    pose proof (Qle_Qabs (- B)). pose proof (Qle_Qabs (h s)). rewrite Qabs_opp in H1. unfold b in big. lra.
Qed.

(* the value of the start *)
Lemma fold_lcm (l : list (Z * Q)) : forall d, (0 < d)%Z ->
  let D := fold_left (fun d sq => Z.lcm d (Zpos (Qden (snd sq)))) l d in
  (0 < D)%Z /\ (d | D)%Z /\ forall sq, In sq l -> (Zpos (Qden (snd sq)) | D)%Z.
Proof.
  induction l as [|x l IH]; intros d d0; cbn [fold_left]; [split; [exact d0|split; [apply Z.divide_refl|easy]]|].
  assert (l0 : (0 < Z.lcm d (Zpos (Qden (snd x))))%Z).
  { assert (0 <= Z.lcm d (Zpos (Qden (snd x))))%Z by apply Z.lcm_nonneg.
    assert (Z.lcm d (Zpos (Qden (snd x))) <> 0)%Z; [|lia]. intro Y. apply Z.lcm_eq_0 in Y. lia. }
  destruct (IH _ l0) as (D0 & Dd & Dl). cbv zeta in *. split; [exact D0|]. split.
  - apply Z.divide_trans with (2 := Dd). apply Z.divide_lcm_l.
  - intros sq [<-|I]; [|now apply Dl]. apply Z.divide_trans with (2 := Dd). apply Z.divide_lcm_r.
Qed.
Lemma start_sum_ok m x : well_formed m -> level_pos m x ->
  (0 < snd (start_sum m x))%Z /\
  inject_Z (fst (start_sum m x)) / inject_Z (snd (start_sum m x)) == sumQ (fun sq => snd sq * value x (fst sq)) (start m).
Proof.
  intros wf L. unfold start_sum. destruct (fold_lcm (start m) 1 ltac:(lia)) as (D0 & _ & Dl). cbv zeta in *.
  set (D := fold_left _ (start m) 1%Z) in *. set (l := map _ (start m)).
  destruct (acc_ok x l 0 1 ltac:(lia)) as [B V].
  { intros s c I. apply in_map_iff in I. destruct I as ([s' q] & Eq & I). inversion Eq. subst. apply L.
    destruct (wf_start m wf) as [_ W]. now apply (W s q). }
  destruct (acc x l 0 1) as [t b]. cbn [fst snd] in *. split; [now apply Z.mul_pos_pos|].
  assert (S : sumQ (fun sc : Z * Z => inject_Z (snd sc) * value x (fst sc)) l ==
    inject_Z D * sumQ (fun sq => snd sq * value x (fst sq)) (start m)).
  { unfold l. rewrite sumQ_map, <- sumQ_scal. apply sumQ_ext. intros [s q] I. cbn [fst snd].
    specialize (Dl (s, q) I). cbn [snd] in Dl. destruct Dl as [k Dk]. rewrite Dk, Z.div_mul by lia.
    rewrite !inject_Z_mult.
    rewrite Q_num. ring. }
  rewrite S in V. rewrite inject_Z_mult. apply injZ_pos in B, D0.
  assert (T : inject_Z t == inject_Z b * (inject_Z D * sumQ (fun sq => snd sq * value x (fst sq)) (start m))).
  { setoid_replace (inject_Z t) with (inject_Z b * (inject_Z t / inject_Z b)) by (field; lra). rewrite V.
    change (inject_Z 0) with 0. field. }
  rewrite T. field. split; lra.
Qed.
Lemma is_mean_ok m x v : well_formed m -> level_pos m x -> is_mean m x v = true -> start_mean m (value x) v.
Proof.
  intros wf L. unfold is_mean, start_mean. destruct v as [q| |]; try discriminate.
  destruct (start_sum_ok m x wf L) as [B V]. destruct (start_sum m x) as [t b]. cbn [fst snd] in *. intro X.
  apply Z.eqb_eq in X. rewrite <- V. apply injZ_pos in B.
  assert (Y : inject_Z ((if maximise m then Qnum q else - Qnum q) * b) == inject_Z (t * Zpos (Qden q))) by now rewrite X.
  rewrite !inject_Z_mult in Y. assert (d0 : 0 < inject_Z (Zpos (Qden q))) by (apply injZ_pos; lia).
  assert (o : own m q == inject_Z (if maximise m then Qnum q else - Qnum q) / inject_Z (Zpos (Qden q))).
  { unfold own. destruct (maximise m); [|rewrite inject_Z_opp]; rewrite Q_num; field; lra. }
  rewrite o. set (z := inject_Z (if maximise m then Qnum q else - Qnum q)) in *.
  assert (z == inject_Z t * inject_Z (Zpos (Qden q)) / inject_Z b) by (rewrite <- Y; field; lra).
  rewrite H. field. split; lra.
Qed.
Lemma live_ok m s : well_formed m -> (exists q, In (s, q) (start m) /\ 0 < q) <->
  (exists q, In (s, q) (filter (fun sq => negb (Qeq_bool (snd sq) 0)) (start m))).
Proof.
  intro wf. split; intros (q & I).
  - exists q. apply filter_In. destruct I as [I q0]. split; [exact I|]. cbn [snd]. apply negb_true_iff.
    destruct (Qeq_bool q 0) eqn:e; [|reflexivity]. apply Qeq_bool_iff in e. lra.
  - apply filter_In in I. destruct I as [I n]. exists q. split; [exact I|]. cbn [snd] in n. apply negb_true_iff in n.
    destruct (wf_start m wf) as [_ W]. destruct (W s q I) as [_ q0]. destruct (Qlt_le_dec 0 q) as [|l]; [assumption|].
    assert (e : q == 0) by lra. apply Qeq_bool_iff in e. congruence.
Qed.
Lemma start_ok_is m sign x v : well_formed m -> level_pos m x -> start_ok m sign x v = true -> start_is m sign (value x) v.
Proof.
  intros wf L. unfold start_ok, start_is. set (live := filter _ (start m)).
  assert (F : forall (f : Z -> bool), existsb (fun sq => f (fst sq)) live = false ->
    forall s, (exists q, In (s, q) (start m) /\ 0 < q) -> f s = false).
  { intros f X s Ls. apply live_ok in Ls; [|exact wf]. destruct Ls as [q I]. destruct (f s) eqn:e; [|reflexivity].
    assert (existsb (fun sq : Z * Q => f (fst sq)) live = true) by (apply existsb_exists; exists (s, q); auto). congruence. }
  assert (T : forall (f : Z -> bool), existsb (fun sq => f (fst sq)) live = true ->
    exists s, (exists q, In (s, q) (start m) /\ 0 < q) /\ f s = true).
  { intros f X. apply existsb_exists in X. destruct X as ([s q] & I & e). exists s. split; [|exact e].
    apply live_ok; [exact wf|]. now exists q. }
  assert (Fu := F (fun s => 0 <? sign s)%Z). assert (Fd := F (fun s => sign s <? 0)%Z).
  assert (Tu := T (fun s => 0 <? sign s)%Z). assert (Td := T (fun s => sign s <? 0)%Z). cbv beta in *.
  destruct (existsb (fun sq => 0 <? sign (fst sq))%Z live); destruct (existsb (fun sq => sign (fst sq) <? 0)%Z live);
    intro X; try discriminate.
  - right. left. destruct (Tu eq_refl) as (s & Ls & e). apply Z.ltb_lt in e.
    split; [exists s; auto|]. split; [intros t Lt; specialize (Fd eq_refl t Lt); apply Z.ltb_ge in Fd; lia|].
    destruct v, (maximise m); try discriminate; reflexivity.
  - right. right. destruct (Td eq_refl) as (s & Ls & e). apply Z.ltb_lt in e.
    split; [exists s; auto|]. split; [intros t Lt; specialize (Fu eq_refl t Lt); apply Z.ltb_ge in Fu; lia|].
    destruct v, (maximise m); try discriminate; reflexivity.
  - left. split; [|now apply is_mean_ok]. intros s Ls. specialize (Fu eq_refl s Ls). specialize (Fd eq_refl s Ls).
    apply Z.ltb_ge in Fu, Fd. lia.
Qed.

(* uniqueness *)
Lemma no_twins_before l : forall p, no_twins p l = true -> forall q, In q l -> (state p < state q)%Z.
Proof.
  induction l as [|a l IH]; intros p X q I; [easy|]. cbn [no_twins] in X. split_and. reflect.
  destruct I as [<-|I]; [assumption|]. specialize (IH a H0 q I). lia.
Qed.
Lemma no_twins_same l : forall p, no_twins p l = true -> forall q rew, In q (p :: l) -> In rew (p :: l) -> state q = state rew -> q = rew.
Proof.
  induction l as [|a l IH]; intros p X q rew Iq Ir Es.
  - destruct Iq as [<-|[]], Ir as [<-|[]]. reflexivity.
  - pose proof (no_twins_before _ _ X) as B. cbn [no_twins] in X. split_and.
    destruct Iq as [<-|Iq], Ir as [<-|Ir]; [reflexivity|specialize (B rew Ir); lia|specialize (B q Iq); lia|].
    now apply (IH a).
Qed.
Lemma unique_ok m c hs : model_right m hs = true ->
  (if unique c then one_each m (claims c) hs else two_somewhere m (claims c) hs) = true ->
  one_optimum m (fun p => optimal m (claims c) p = true) (unique c).
Proof.
  intros M X. pose proof (model_right_ok m hs M) as [wf eo]. unfold one_optimum. destruct (unique c).
  - unfold one_each in X. rewrite !andb_true_iff in X. destruct X as [[S C] O]. rewrite forallb_forall in S, C.
    assert (R : forall s, reached m (fun p => optimal m (claims c) p = true) s -> reach hs s = true).
    { intros s Rs. induction Rs as [s q I q0|p o Rs IH I Op Io].
      - specialize (S (s, q) I). cbn [fst snd] in S. apply orb_true_iff in S. destruct S as [S|S]; [|exact S].
        apply Qeq_bool_iff in S. lra.
      - specialize (C p I). cbv beta in C. rewrite IH, Op in C. cbn [andb negb orb] in C. unfold all_next in C.
        rewrite forallb_forall in C. now apply C. }
    intros s Rs. destruct (ends hs s) eqn:e; [left; now apply eo|right].
    intros p q Ip Iq Es Et Op Oq.
    set (l := filter _ (pairs m)) in O.
    assert (Il : forall y, In y (pairs m) -> state y = s -> optimal m (claims c) y = true -> In y l).
    { intros y Iy Ey Oy. apply filter_In. split; [exact Iy|]. rewrite Ey, (R s Rs), e, Oy. reflexivity. }
    specialize (Il p Ip Es Op) as Il1. specialize (Il q Iq Et Oq). destruct l as [|y l]; [easy|].
    apply (no_twins_same l y O); auto. congruence.
  - unfold two_somewhere in X. destruct (twins hs) as [[s0 w0] [[a1 a2] a3]]. apply andb_true_iff in X. destruct X as [S X].
    assert (PA : forall s a p, pair_at m s a = Some p -> In p (pairs m) /\ state p = s /\ action p = a).
    { intros s a p F. unfold pair_at in F. apply find_some in F. destruct F as [I F]. split_and. reflect. auto. }
    assert (R : reached m (fun p => optimal m (claims c) p = true) s0).
    { apply existsb_exists in S. destruct S as ([s q] & I & S). cbn [fst snd] in S. apply andb_true_iff in S.
      destruct S as [E0 n]. apply Z.eqb_eq in E0. subst s. apply at_start with q; [exact I|].
      apply negb_true_iff in n. destruct (wf_start m wf) as [_ W]. destruct (W s0 q I) as [_ q0].
      destruct (Qlt_le_dec 0 q) as [|l]; [assumption|]. assert (e : q == 0) by lra. apply Qeq_bool_iff in e. congruence. }
    clear S. revert s0 X R. induction w0 as [|[a t] w IH]; intros s0 X R.
    + cbn [leads] in X. destruct (pair_at m s0 a1) as [p1|] eqn:e1; [|discriminate].
      destruct (pair_at m s0 a2) as [p2|] eqn:e2; [|discriminate]. destruct (pair_at m s0 a3) as [p3|] eqn:e3; [|discriminate].
      apply PA in e1, e2, e3. destruct e1 as (I1 & S1 & A1), e2 as (I2 & S2 & A2), e3 as (I3 & S3 & A3).
      rewrite !andb_true_iff in X. destruct X as [[[N O1] O2] St]. exists s0, p1, p2.
      repeat split; auto.
      * intro En. destruct (En p3 I3 S3) as [M0 N0]. apply negb_true_iff in St. unfold stays in St.
        pose proof (wf_rows m wf p3 I3) as Rw. pose proof (mean_sum_ok p3 (proj1 (proj2 Rw))) as Ms. rewrite M0 in Ms.
        apply andb_false_iff in St. destruct St as [St|St].
        -- apply Z.eqb_neq in St. apply St. destruct (reward_sum p3) as [n d]. cbn [Qnum]. unfold Qeq in Ms. cbn in Ms. nia.
        -- assert (Y : forallb (fun o => (next o =? state p3)%Z) (outcomes p3) = true); [|congruence].
           apply forallb_forall. intros o Io. apply Z.eqb_eq. rewrite S3. now apply N0.
      * apply negb_true_iff, Z.eqb_neq in N. congruence.
    + cbn [leads] in X. destruct (pair_at m s0 a) as [p|] eqn:e; [|discriminate]. apply PA in e. destruct e as (I & Es & _).
      destruct (optimal m (claims c) p && some_next p (Z.eqb t)) eqn:e; [|discriminate]. apply andb_true_iff in e.
      destruct e as [O Sn]. apply (IH t); [exact X|]. unfold some_next in Sn. apply existsb_exists in Sn.
      destruct Sn as (o & Io & Et). apply Z.eqb_eq in Et. rewrite Et. apply by_pair with p; auto. now rewrite Es.
Qed.

Lemma values_within m hs a low high rank : model_right m hs = true -> policy_right m a = true ->
  values m hs a low high rank = true -> between m (stationary m a) (value low) (value high).
Proof.
  intros M P K. destruct (values_sound m hs a low high rank M P K) as (lam & C & L & C0 & X).
  exists lam, C. split; [exact L|]. split; [exact C0|]. intros s Ss. destruct (X s Ss) as (U & _ & Lo & Mi). auto.
Qed.
Lemma values_optimal m hs a h rank : model_right m hs = true -> policy_right m a = true -> values m hs a h h rank = true ->
  optimal_pairs m (value h) (fun p => optimal m (Values h rank) p = true).
Proof.
  intros M P K. pose proof (model_right_ok m hs M) as [wf _].
  pose proof K as K'. unfold values in K'. rewrite !andb_true_iff in K'. destruct K' as [[[_ Lh] _] F].
  rewrite forallb_forall in F. apply (level_right_ok m _ _ P) in Lh.
  assert (eq : forall p, In p (pairs m) -> (optimal m (Values h rank) p = true <-> surplus_of (discount m) (r m p) p (value h) == 0)
    /\ surplus_of (discount m) (r m p) p (value h) <= 0).
  { intros p I. pose proof (wf_rows m wf p I) as R. destruct (earned_ok m p (proj1 (proj2 R))) as [r0 rq].
    destruct (surplus_value m (discount m) _ (earned m p) p h R Lh r0 rq) as (k & k0 & G). cbn [optimal]. rewrite Z.eqb_eq. split.
    - split; intro X.
      + rewrite X in G. change (inject_Z 0) with 0 in G. nra.
      + rewrite X in G. unfold Qeq in G. cbn in G. nia.
    - apply (surplus_le m _ _ (earned m p) p h R Lh r0 rq). specialize (F p I). unfold values_pair in F.
      rewrite !andb_true_iff in F. destruct F as [[_ F] _]. now apply Z.leb_le. }
  split.
  - intros p I. destruct (eq p I) as [E1 E2]. unfold surplus_of in E1, E2. split.
    + rewrite E1. split; intro; lra.
    + intro N. apply Qnot_le_lt. intro Y. apply N, E1. lra.
  - intros pi pl s hy Ss eps e0. destruct (values_sound m hs a h h rank M P K) as (lam & C & L & C0 & X).
    destruct (pow_vanishes lam C eps L C0 e0) as [N HN]. exists N. intros n Ln. specialize (HN n Ln).
    destruct (X s Ss) as (_ & Lo & _). assert (Pl : plays m (fun p => 0 <= surplus_of (discount m) (r m p) p (value h)) pi).
    { intros h' t St. destruct (pl h' t St) as [Y Z]. split; [|exact Z]. intros p q I.
      destruct (Y p q I) as (Ip & ? & ? & O). repeat split; auto. apply (eq p Ip) in O. lra. }
    specialize (Lo pi n hy Pl). lra.
Qed.

Theorem sound m c hs : check m c hs = true -> holds m c.
Proof.
  unfold check, holds. intro X. rewrite !andb_true_iff in X. destruct X as [[[M P] K] Un].
  pose proof (model_right_ok m hs M) as [wf eo]. split; [exact wf|]. cbv zeta.
  split; [eapply plays_valid, stationary_plays, P|].
  split; [|destruct (claims c) eqn:Ew; try exact I; rewrite <- Ew in *; now apply (unique_ok m c hs)].
  destruct (claims c) as [h rank|low high rank|av g h w|h rank order inf].
  - apply andb_true_iff in K. destruct K as [K S]. pose proof (values_within m hs _ _ _ _ M P K) as B.
    split; [exact B|]. split; [now apply between_limits|]. split; [|exact (values_optimal m hs _ h rank M P K)].
    unfold values in K. rewrite !andb_true_iff in K. destruct K as [[[_ Lh] _] _].
    apply (level_right_ok m _ _ P) in Lh. pose proof (start_ok_is m (fun _ => 0%Z) h _ wf Lh S) as [[_ Y]|[Y|Y]]; [exact Y| |];
      destruct Y as [(s & _ & Y) _]; lia.
  - pose proof (values_within m hs _ _ _ _ M P K) as B. split; [exact B|]. now apply between_limits.
  - rewrite !andb_true_iff in K. destruct K as [[K A] S]. pose proof K as Lv. unfold expansion in Lv.
    rewrite !andb_true_iff in Lv. destruct Lv as [[[Lg Lh] _] _]. apply (level_right_ok m _ _ P) in Lg, Lh.
    pose proof (limit_sound m hs _ g h w M P K) as La. destruct av.
    + split; [exact (average_sound m hs _ g h w M P K)|]. split; [exact La|]. now apply is_mean_ok.
    + cbn [orb] in A. apply andb_true_iff in A. destruct A as [A _]. apply Qeq_bool_iff in A. split; [exact A|].
      split; [exact La|]. split; [now apply laurent_total|]. now apply start_ok_is.
  - destruct (goal m) as [g|] eqn:G; [|discriminate]. apply andb_true_iff in K. destruct K as [K S].
    exists g. split; [reflexivity|].
    assert (Lh : level_pos m h) by (apply (g_level m (actions c) (out hs) h rank order inf g P K)).
    split; [|now apply start_ok_is].
    intros s hy Ss.
    destruct (goal_finite m hs _ _ h rank order inf g M P G K) as (lam & C & L & C0 & F).
    assert (fin : inf s = 0%Z -> finite inf s = true) by (intro e; unfold finite; now apply Z.eqb_eq).
    assert (lim : forall eps, 0 < eps -> exists N, forall n, (N <= n)%nat -> pow lam n * C <= eps)
      by (intros; now apply pow_vanishes).
    split; [|split; [|split; [|split]]].
    + intro I0. destruct (F s Ss (fin I0)) as [U Lo]. pose proof (arriving_stationary m _ P) as As.
      split; [|split; [|split]].
      * intros eps e0. destruct (lim eps e0) as [N HN]. exists N. intros n Ln. specialize (HN n Ln).
        destruct (U _ n hy As) as [_ Y]. unfold missed_in. lra.
      * intros eps e0. destruct (lim eps e0) as [N HN]. exists N. intros n Ln. specialize (HN n Ln).
        destruct (U _ n hy As) as [Y _]. specialize (Lo n hy). lra.
      * intros Lf pi V.
        assert (Pl : plays m (arriving_pair m (actions c)) pi).
        { intros h' t St. destruct (V h' t St) as [Y Z]. split; [|exact Z]. intros p q I.
          destruct (Y p q I) as (? & ? & ? & _). repeat split; auto. unfold arriving_pair. congruence. }
        split; intros eps e0; destruct (lim eps e0) as [N HN]; exists N; intros n Ln; specialize (HN n Ln);
          destruct (U pi n hy Pl) as [Y Z]; unfold missed_in; lra.
      * intros Lt pi V Ar eps e0.
        destruct (goal_upper m hs _ _ h rank order inf g M P G K Lt) as (C' & C0' & Up).
        assert (e1 : 0 < eps / (C' + 1)) by (apply Qlt_shift_div_l; lra).
        destruct (Ar _ e1) as [N HN]. exists N. intros n Ln.
        destruct (Up pi V n hy s Ss (fin I0)) as [(de & N' & de0 & Mi)|Y].
        -- exfalso. assert (e2 : 0 < de * (1 # 2)) by lra. destruct (Ar _ e2) as [N2 HN2].
           specialize (Mi (N' + N2)%nat ltac:(lia)). specialize (HN2 (N' + N2)%nat ltac:(lia)). unfold missed_in in HN2. lra.
        -- specialize (HN n Ln). unfold missed_in in HN. assert (q : eps / (C' + 1) * (C' + 1) == eps) by (field; lra).
           set (y := eps / (C' + 1)) in *. set (mi := chance _ _ _ _ _) in *. nra.
    + intro I1. assert (Nv : never inf s = true) by (unfold never; now apply Z.eqb_eq).
      destruct (missing_is_least m) eqn:Lt.
      * split; [reflexivity|]. intros pi V.
        destruct (goal_never m hs _ _ h rank order inf g M P K Lt) as (de & de0 & Y).
        exists de. split; [exact de0|]. exists 0%nat. intros n _. now apply Y.
      * pose proof (no_never m _ _ h rank order inf g P K Lt s Ss) as Y. congruence.
    + intros I1 Lf. destruct (goal_above m hs _ _ h rank order inf g M P K Lf) as (de & de0 & Y).
      exists de. split; [exact de0|]. exists 0%nat. intros n _. apply Y; [exact Ss|]. unfold above. now apply Z.eqb_eq.
    + intros I1 Lt B. assert (Ab : above inf s = true) by (unfold above; now apply Z.eqb_eq).
      destruct (goal_unbounded m hs _ _ h rank order inf g M P G K Lt s Ss Ab B) as (pi & V & Y & Z).
      exists pi. split; [exact V|]. split; [exact Z|exact Y].
    + destruct (one_of m _ _ h rank order inf g P K s Ss) as [Y|[Y|Y]]; unfold finite, never, above in Y;
        apply Z.eqb_eq in Y; auto.
Qed.
Print Assumptions sound.
