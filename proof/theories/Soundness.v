(* What the checker accepts, holds. *)
From Coq Require Import ZArith QArith Qreduction Qabs Qminmax Qfield List Bool Lqa Lia.
From MDP Require Import Spec Checker Claims Arith Integers Start Bellman Unique Laurent Goals.
Import ListNotations.
Open Scope Q_scope.

Lemma between_limit m best low high : between m best low high ->
  between_in_the_limit m best low high.
Proof.
  intros (lam & C & L & C0 & X) s h Ss. destruct (X s Ss) as (U & Lo & _).
  split; [intros pi V|]; intros eps e0;
    destruct (pow_vanishes lam C eps L C0 e0) as [N HN]; exists N; intros n Ln;
      specialize (HN n Ln).
  - specialize (U pi n h V). lra.
  - specialize (Lo n h). lra.
Qed.

Lemma rest_vanishes K gamma eps : 0 <= K -> 0 < eps -> 1 # 2 <= gamma < 1 -> K * (1 - gamma)
  * 2 <= eps ->
  eventually (fun n => K * (1 - gamma) + pow gamma n * (K / (1 - gamma)) <= eps).
Proof.
  intros K0 e0 G Hs. assert (c0 : 0 <= K / (1 - gamma)) by (apply Qle_shift_div_l; lra).
  assert (half : 0 < eps * (1 # 2)) by lra.
  destruct (pow_vanishes gamma (K / (1 - gamma)) (eps * (1 # 2)) ltac:(lra) c0 half) as [N HN].
  exists N. intros n Ln.
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
  - intros g0 eps e0. destruct (pick eps e0) as (d & D & Kd). exists d. split; [lra|].
    intros gamma G.
    assert (G' : 1 - de <= gamma < 1) by lra. specialize (X gamma G').
    assert (Hs : K * (1 - gamma) * 2 <= eps) by nra.
    destruct (rest_vanishes K gamma eps K0 e0 ltac:(lra) Hs) as [N HN].
    assert (z : g s / (1 - gamma) == 0) by (rewrite g0; field; lra).
    split; [intros pi V|]; exists N; intros n Ln; specialize (HN n Ln); destruct (X s n hy Ss)
      as [U Lo].
    + specialize (U pi V). lra.
    + lra.
  - intros gp B. destruct (pick 1 ltac:(lra)) as (d & D & Kd).
    set (b := Qabs B + Qabs (h s) + 1). pose proof (Qabs_nonneg B).
    pose proof (Qabs_nonneg (h s)).
    set (d' := g s / b). assert (d'0 : 0 < d') by (unfold d', b; apply Qlt_shift_div_l; lra).
    exists (Qmin d d'). split; [apply Q.min_glb_lt; lra|]. intros gamma G.
    assert (m1 : Qmin d d' <= d) by apply Q.le_min_l.
    assert (m2 : Qmin d d' <= d') by apply Q.le_min_r.
    assert (G' : 1 - de <= gamma < 1) by lra. specialize (X gamma G').
    assert (Hs : K * (1 - gamma) * 2 <= 1) by nra.
    destruct (rest_vanishes K gamma 1 K0 ltac:(lra) ltac:(lra) Hs) as [N HN].
    assert (big : b <= g s / (1 - gamma)).
    { apply Qle_shift_div_l; [lra|]. assert (d' * b == g s) by (unfold d'; field; unfold b; lra).
      assert (0 < b) by (unfold b; lra). nra. }
    exists N. intros n Ln. specialize (HN n Ln). destruct (X s n hy Ss) as [_ Lo].
    pose proof (Qle_Qabs B). pose proof (Qle_Qabs (- h s)).
    rewrite Qabs_opp in H2. unfold b in big. lra.
  - intros gp B. destruct (pick 1 ltac:(lra)) as (d & D & Kd).
    set (b := Qabs B + Qabs (h s) + 1). pose proof (Qabs_nonneg B).
    pose proof (Qabs_nonneg (h s)).
    set (d' := - g s / b). assert (d'0 : 0 < d') by (unfold d', b; apply Qlt_shift_div_l; lra).
    exists (Qmin d d'). split; [apply Q.min_glb_lt; lra|]. intros gamma G.
    assert (m1 : Qmin d d' <= d) by apply Q.le_min_l.
    assert (m2 : Qmin d d' <= d') by apply Q.le_min_r.
    assert (G' : 1 - de <= gamma < 1) by lra. specialize (X gamma G').
    assert (Hs : K * (1 - gamma) * 2 <= 1) by nra.
    destruct (rest_vanishes K gamma 1 K0 ltac:(lra) ltac:(lra) Hs) as [N HN].
    assert (big : g s / (1 - gamma) <= - b).
    { apply Qle_shift_div_r; [lra|].
      assert (d' * b == - g s) by (unfold d'; field; unfold b; lra).
      assert (0 < b) by (unfold b; lra). nra. }
    intros pi V. exists N. intros n Ln. specialize (HN n Ln). destruct (X s n hy Ss) as [U _].
    specialize (U pi V).
    pose proof (Qle_Qabs (- B)). pose proof (Qle_Qabs (h s)).
    rewrite Qabs_opp in H1. unfold b in big. lra.
Qed.

Lemma values_within m hs a low high rank : model_right m hs = true -> policy_right m a = true ->
  values m hs a low high rank = true -> between m (stationary m a) (value low) (value high).
Proof.
  intros M P K. destruct (values_sound m hs a low high rank M P K) as (lam & C & L & C0 & X).
  exists lam, C. split; [exact L|]. split; [exact C0|]. intros s Ss.
  destruct (X s Ss) as (U & _ & Lo & Mi). auto.
Qed.
Lemma values_optimal m hs a h rank : model_right m hs = true -> policy_right m a = true ->
  values m hs a h h rank = true ->
  optimal_pairs m (value h) (fun p => optimal m (Values h rank) p = true).
Proof.
  intros M P K. pose proof (model_right_ok m hs M) as [wf _].
  pose proof K as K'. unfold values in K'. rewrite !andb_true_iff in K'.
  destruct K' as [[[_ Lh] _] F].
  rewrite forallb_forall in F. apply (level_right_ok m _ _ P) in Lh.
  assert (eq : forall p, In p (pairs m) -> (optimal m (Values h rank) p = true <->
    surplus_of (discount m) (r m p) p (value h) == 0)
    /\ surplus_of (discount m) (r m p) p (value h) <= 0).
  { intros p I. pose proof (wf_rows m wf p I) as R.
    destruct (earned_ok m p (proj1 (proj2 R))) as [r0 rq].
    cbn [optimal]. rewrite Z.eqb_eq. split.
    - exact (surplus_eq m _ _ (earned m p) p h R Lh r0 rq).
    - apply (surplus_le m _ _ (earned m p) p h R Lh r0 rq). specialize (F p I).
      unfold values_pair in F.
      rewrite !andb_true_iff in F. destruct F as [[_ F] _]. now apply Z.leb_le. }
  split.
  - intros p I. destruct (eq p I) as [E1 E2]. unfold surplus_of in E1, E2. split.
    + rewrite E1. split; intro; lra.
    + intro N. apply Qnot_le_lt. intro Y. apply N, E1. lra.
  - intros pi pl s hy Ss eps e0. destruct (values_sound m hs a h h rank M P K)
      as (lam & C & L & C0 & X).
    destruct (pow_vanishes lam C eps L C0 e0) as [N HN]. exists N. intros n Ln.
    specialize (HN n Ln).
    destruct (X s Ss) as (_ & Lo & _).
    assert (Pl : plays m (fun p => 0 <= surplus_of (discount m) (r m p) p (value h)) pi).
    { intros h' t St. destruct (pl h' t St) as [Y Z]. split; [|exact Z]. intros p q I.
      destruct (Y p q I) as (Ip & ? & ? & O). repeat split; auto. apply (eq p Ip) in O. lra. }
    specialize (Lo pi n hy Pl). lra.
Qed.

Lemma expansion_pairs m hs a g h w : model_right m hs = true -> policy_right m a = true ->
  expansion m a g h w = true ->
  average_pairs m (value g) (value h) (fun p => optimal m (Expansion true g h w) p = true).
Proof.
  intros M P K. pose proof (model_right_ok m hs M) as [wf _]. pose proof K as Lv.
  unfold expansion in Lv. rewrite !andb_true_iff in Lv. destruct Lv as [[[Lg Lh] _] _].
  apply (level_right_ok m _ _ P) in Lg, Lh.
  assert (eq : forall p, In p (pairs m) -> (optimal m (Expansion true g h w) p = true <->
    surplus_of 1 0 p (value g) == 0 /\
    surplus_of 1 (r m p - value g (state p)) p (value h) == 0)).
  { intros p I. pose proof (wf_rows m wf p I) as R. cbn [optimal]. unfold expansion_optimal.
    destruct (g_surplus_ok m g p R Lg) as (_ & Ge & _).
    destruct (h_surplus_ok m g h p R Lg Lh) as (_ & He & _).
    destruct (g (state p)) as [t b]. cbn [negb andb].
    rewrite andb_true_iff, !Z.eqb_eq. tauto. }
  split.
  - intros p I. rewrite (eq p I). unfold surplus_of. split; intros [X Y]; split; lra.
  - destruct (average_pairs_sound m hs g h M) as (C & C0 & X). exists C.
    split; [exact C0|]. intros pi pl. apply X. intros hy t St. destruct (pl hy t St) as [Y Z].
    split; [|exact Z]. intros p q I. destruct (Y p q I) as (Ip & ? & ? & O).
    repeat split; auto; now apply (eq p Ip).
Qed.

(* What `goal_optimum` says follows from the theorems about goals. *)
Lemma reaching_optimum m hs a out h rank order inf g : model_right m hs = true ->
  policy_right m a = true -> goal m = Some g -> reaching m h rank order inf g a out = true ->
  goal_optimum m g (stationary m a) (value h) inf.
Proof.
  intros M P G K s hy Ss.
  destruct (goal_finite m hs _ _ h rank order inf g M P G K) as (lam & C & L & C0 & F).
  assert (fin : inf s = 0%Z -> finite inf s = true) by
    (intro e; unfold finite; now apply Z.eqb_eq).
  assert (lim : forall eps, 0 < eps -> exists N, forall n, (N <= n)%nat -> pow lam n * C <= eps)
    by (intros; now apply pow_vanishes).
  assert (all : missing_is_least m = false -> forall pi, valid m pi ->
    plays m (arriving_pair m a) pi).
  { intros Lf pi V h' t St. destruct (V h' t St) as [Y Z]. split; [|exact Z]. intros p q I.
    destruct (Y p q I) as (? & ? & ? & _). repeat split; auto. unfold arriving_pair. congruence. }
  assert (sure : missing_is_least m = false -> inf s = 0%Z -> forall pi, valid m pi ->
    arrives_surely g pi hy s).
  { intros Lf I0 pi V eps e0. destruct (lim eps e0) as [N HN]. exists N. intros n Ln.
    specialize (HN n Ln). destruct (F s Ss (fin I0)) as [U _].
    destruct (U pi n hy (all Lf pi V)) as [_ Z]. unfold missed. lra. }
  split; [|split; [|split; [|split]]].
  - destruct (one_of m _ _ h rank order inf g P K s Ss) as [Y|[Y|Y]];
      unfold finite, never, above in Y; apply Z.eqb_eq in Y; auto.
  - intro I0. destruct (F s Ss (fin I0)) as [U Lo].
    pose proof (arriving_stationary m _ P) as As. split; [|split; [|split]]; auto.
    + intros eps e0. destruct (lim eps e0) as [N HN]. exists N. intros n Ln. specialize (HN n Ln).
      destruct (U _ n hy As) as [_ Y]. unfold missed. lra.
    + intros eps e0. destruct (lim eps e0) as [N HN]. exists N. intros n Ln. specialize (HN n Ln).
      destruct (U _ n hy As) as [Y _]. specialize (Lo n hy). lra.
    + intros pi V Ar eps e0. destruct (missing_is_least m) eqn:Lt.
      * destruct (goal_upper m hs _ _ h rank order inf g M P G K Lt) as (C' & C0' & Up).
        assert (e1 : 0 < eps / (C' + 1)) by (apply Qlt_shift_div_l; lra).
        destruct (Ar _ e1) as [N HN]. exists N. intros n Ln.
        destruct (Up pi V n hy s Ss (fin I0)) as [(de & N' & de0 & Mi)|Y].
        -- exfalso. assert (e2 : 0 < de * (1 # 2)) by lra. destruct (Ar _ e2) as [N2 HN2].
           specialize (Mi (N' + N2)%nat ltac:(lia)). specialize (HN2 (N' + N2)%nat ltac:(lia)).
           unfold missed in HN2. lra.
        -- specialize (HN n Ln). unfold missed in HN.
           assert (q : eps / (C' + 1) * (C' + 1) == eps) by (field; lra).
           set (y := eps / (C' + 1)) in *. set (mi := chance _ _ _ _ _) in *. nra.
      * destruct (lim eps e0) as [N HN]. exists N. intros n Ln. specialize (HN n Ln).
        destruct (U pi n hy (all eq_refl pi V)) as [Y _]. lra.
  - intro I1. assert (Nv : never inf s = true) by (unfold never; now apply Z.eqb_eq).
    destruct (missing_is_least m) eqn:Lt.
    + split; [reflexivity|]. intros pi V.
      destruct (goal_never m hs _ _ h rank order inf g M P K Lt) as (de & de0 & Y).
      exists de. split; [exact de0|]. exists 0%nat. intros n _. now apply Y.
    + pose proof (no_never m _ _ h rank order inf g P K Lt s Ss) as Y. congruence.
  - intros I1 Lf. destruct (goal_above m hs _ _ h rank order inf g M P K Lf) as (de & de0 & Y).
    exists de. split; [exact de0|]. exists 0%nat. intros n _. apply Y; [exact Ss|].
    unfold above. now apply Z.eqb_eq.
  - intros I1 Lt B. assert (Ab : above inf s = true) by (unfold above; now apply Z.eqb_eq).
    destruct (goal_unbounded m hs _ _ h rank order inf g M P G K Lt s Ss Ab B)
      as (pi & V & Y & Z). exists pi. split; [exact V|]. split; [exact Z|exact Y].
Qed.

Theorem sound m c hs : check m c hs = true -> holds m c.
Proof.
  unfold check, holds. intro X. rewrite !andb_true_iff in X. destruct X as [[[M P] K] Un].
  pose proof (model_right_ok m hs M) as [wf _]. cbv zeta. split; [exact wf|].
  split; [eapply plays_valid, stationary_plays, P|].
  unfold proves in K. unfold uniqueness_right in Un.
  destruct (claims c) as [h rank|low high rank|average g h w|h rank order infinite].
  - apply andb_true_iff in K. destruct K as [K S].
    pose proof (values_within m hs _ _ _ _ M P K) as B.
    split; [exact B|]. split; [now apply between_limit|].
    pose proof (values_optimal m hs _ h rank M P K) as Op.
    pose proof (unique_ok m _ hs _ M Un) as One.
    split; [|split; [exact Op|split; [exact One|]]].
    2: { destruct (unique c); [now apply (one_policy_unique m hs _ h rank)|].
      now apply (one_policy_not_unique m hs _ h rank). }
    unfold values in K. rewrite !andb_true_iff in K. destruct K as [[[_ Lh] _] _].
    apply (level_right_ok m _ _ P) in Lh.
    destruct (start_value_right_ok m zero h _ wf Lh S) as [[_ Y]|[Y|Y]]; [exact Y| |];
      destruct Y as [(s & _ & Y) _]; unfold zero in Y; lia.
  - pose proof (values_within m hs _ _ _ _ M P K) as B. split; [exact B|].
    now apply between_limit.
  - apply andb_true_iff in K. destruct K as [K S]. pose proof K as Lv. unfold expansion in Lv.
    rewrite !andb_true_iff in Lv. destruct Lv as [[[Lg Lh] _] _].
    apply (level_right_ok m _ _ P) in Lg, Lh.
    pose proof (limit_sound m hs _ g h w M P K) as La. unfold expansion_start in S.
    destruct average.
    + split; [exact (average_sound m hs _ g h w M P K)|]. split; [exact La|].
      split; [now apply is_mean_ok|]. split; [now apply (unique_ok m _ hs)|].
      now apply (expansion_pairs m hs (actions c)).
    + rewrite !andb_true_iff in S. destruct S as [[A _] S]. apply is_one_ok in A.
      split; [exact A|]. split; [exact La|]. split; [now apply laurent_total|].
      split; [now apply start_value_right_ok|now apply (unique_ok m _ hs)].
  - unfold reaching_goal in K. destruct (goal m) as [g|] eqn:G; [|discriminate].
    apply andb_true_iff in K. destruct K as [K S]. exists g. split; [reflexivity|].
    assert (Lh : level_pos m h) by
      (apply (g_level m (actions c) (way_out hs) h rank order infinite g P K)).
    split; [|split; [now apply start_value_right_ok|now apply (unique_ok m _ hs)]].
    now apply (reaching_optimum m hs (actions c) (way_out hs) h rank order infinite g).
Qed.
