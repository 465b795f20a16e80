(* For totals by values alone: an optimum is unique if and only if no other policy is optimal. *)
From Coq Require Import ZArith QArith Qreduction Qfield List Bool Lqa Lia.
From MDP Require Import Spec Checker Claims Arith Integers Start Bellman.
Import ListNotations.
Open Scope Q_scope.

(* What one of several choices falls short of a bound, its share of the whole falls short of it.
*)
Lemma mix_short (v : pair -> Q) B l p q :
  (forall p' q', In (p', q') l -> 0 <= q' /\ v p' <= B) -> sumQ snd l == 1 -> In (p, q) l ->
  q * (B - v p) <= B - sumQ (fun c => snd c * v (fst c)) l.
Proof.
  intros H S I.
  assert (X : q * (B - v p) <= sumQ (fun c : pair * Q => snd c * (B - v (fst c))) l).
  { apply (sumQ_one (fun c : pair * Q => snd c * (B - v (fst c))) l (p, q)); [|exact I].
    intros [p' q'] I'. destruct (H p' q' I'). cbn [fst snd]. nra. }
  assert (Y : sumQ (fun c : pair * Q => snd c * (B - v (fst c))) l +
    sumQ (fun c : pair * Q => snd c * v (fst c)) l == B).
  { rewrite <- sumQ_plus. rewrite (sumQ_ext _ (fun c : pair * Q => snd c * B)) by (intros; ring).
    rewrite sumQ_times_right, S. ring. }
  lra.
Qed.
Lemma mean_short m p f g o : row_ok m p -> In o (outcomes p) ->
  (forall o, In o (outcomes p) -> f (next o) <= g (next o)) ->
  prob p o * (g (next o) - f (next o)) <= mean p g - mean p f.
Proof.
  intros R I H.
  assert (X : prob p o * (g (next o) - f (next o)) <=
    sumQ (fun o => prob p o * (g (next o) - f (next o))) (outcomes p)).
  { apply (sumQ_one (fun o => prob p o * (g (next o) - f (next o)))); [|exact I].
    intros y Iy. pose proof (prob_pos m p R y Iy). specialize (H y Iy). nra. }
  assert (Y : sumQ (fun o => prob p o * (g (next o) - f (next o))) (outcomes p) + mean p f ==
    mean p g).
  { unfold mean. rewrite <- sumQ_plus. apply sumQ_ext. intros. ring. }
  lra.
Qed.

Section Unique.
  Variables (m : model) (V : Z -> Q) (lam C : Q) (pi : policy).
  Hypotheses (wf : well_formed m) (lam1 : 0 <= lam < 1) (C0 : 0 <= C) (va : valid m pi).
  Hypothesis upper : forall n hist s, is_state m s ->
    earns m (discount m) pi n hist s <= V s + pow lam n * C.
  Hypothesis bellman : forall p, In p (pairs m) -> surplus_of (discount m) (r m p) p V <= 0.
  Let gamma := discount m.

  (* What the policy earns from here tends to V, so that nothing is lost. *)
  Definition loses_nothing (hist : history) (s : Z) : Prop :=
    in_the_limit (fun eps n => V s - eps <= earns m gamma pi n hist s).

  (* One step: for every ε, from some n on, a pair that is played with probability q loses at most
     2 ε / q, and all that follows is within ε of what it may be. *)
  Lemma step_short hist s p q eps : is_state m s -> loses_nothing hist s ->
    In (p, q) (pi hist s) -> 0 < eps -> exists N, forall n, (N <= n)%nat ->
      let e := earns m gamma pi n ((s, action p) :: hist) in
      q * (V s - (r m p + gamma * mean p e)) <= 2 * eps /\
      forall o, In o (outcomes p) -> e (next o) <= V (next o) + eps.
  Proof.
    intros Ss L I e0. destruct (L eps e0) as [N1 H1].
    destruct (pow_vanishes lam C eps lam1 C0 e0) as [N2 H2]. exists (N1 + N2)%nat. intros n Ln.
    destruct (va hist s Ss) as [Pl S1]. specialize (H2 n ltac:(lia)).
    destruct (wf_discount m wf) as [g0 g1]. fold gamma in g0, g1.
    assert (each : forall p' q', In (p', q') (pi hist s) ->
      (forall o, In o (outcomes p') ->
        earns m gamma pi n ((s, action p') :: hist) (next o) <= V (next o) + eps) /\
      0 <= q' /\ r m p' + gamma * mean p' (earns m gamma pi n ((s, action p') :: hist)) <=
        V s + eps).
    { intros p' q' I'. destruct (Pl p' q' I') as (Ip & Es & q0 & _).
      pose proof (wf_rows m wf p' Ip) as R.
      assert (no : forall o, In o (outcomes p') ->
        earns m gamma pi n ((s, action p') :: hist) (next o) <= V (next o) + eps).
      { intros o Io. pose proof R as (_ & _ & _ & Ro). destruct (Ro o Io) as [_ So].
        specialize (upper n ((s, action p') :: hist) (next o) So). fold gamma in upper. lra. }
      split; [exact no|]. split; [exact q0|].
      assert (le : mean p' (earns m gamma pi n ((s, action p') :: hist)) <=
        mean p' (fun t => V t + eps)) by (apply (mean_le m p' R); exact no).
      rewrite mean_plus, (mean_const m p' R) in le. specialize (bellman p' Ip).
      unfold surplus_of in bellman. fold gamma in bellman. rewrite Es in bellman. nra. }
    cbv zeta. split; [|exact (proj1 (each p q I))].
    pose proof (mix_short (fun p' => r m p' +
      gamma * mean p' (earns m gamma pi n ((s, action p') :: hist))) (V s + eps) (pi hist s) p q
      (fun p' q' I' => proj2 (each p' q' I')) S1 I) as X. cbv beta in X.
    specialize (H1 (S n) ltac:(lia)). unfold earns at 1 in H1. cbn [run] in H1.
    fold (earns m gamma pi n) in H1.
    assert (q0 : 0 <= q) by (destruct (Pl p q I) as (_ & _ & ? & _); assumption).
    set (v := r m p + gamma * mean p _) in *. set (sum := sumQ _ _) in X.
    assert (H1' : V s - eps <= sum) by exact H1. nra.
  Qed.

  Lemma plays_optimal hist s p q : is_state m s -> loses_nothing hist s ->
    In (p, q) (pi hist s) -> 0 < q -> surplus_of gamma (r m p) p V == 0.
  Proof.
    intros Ss L I q0. destruct (va hist s Ss) as [Pl S1].
    destruct (Pl p q I) as (Ip & Es & _ & _). pose proof (wf_rows m wf p Ip) as R.
    pose proof (bellman p Ip) as Bp. fold gamma in Bp. destruct (wf_discount m wf) as [g0 g1].
    fold gamma in g0, g1. destruct (Qlt_le_dec (surplus_of gamma (r m p) p V) 0) as [D|D];
      [exfalso|lra]. set (d := - surplus_of gamma (r m p) p V) in *.
    assert (d0 : 0 < d) by (unfold d; lra).
    assert (q1 : q <= 1).
    { rewrite <- S1. apply (sumQ_one snd (pi hist s) (p, q)); [|exact I]. intros [p' q'] I'.
      destruct (Pl p' q' I') as (_ & _ & ? & _). assumption. }
    set (eps := q * d * (1 # 4)). assert (e0 : 0 < eps) by (unfold eps; nra).
    destruct (step_short hist s p q eps Ss L I e0) as [N H]. specialize (H N (le_n _)).
    cbv zeta in H. destruct H as [H1 H2].
    assert (le : mean p (earns m gamma pi N ((s, action p) :: hist)) <=
      mean p (fun t => V t + eps))
      by (apply (mean_le m p R); exact H2).
    rewrite mean_plus, (mean_const m p R) in le.
    assert (X : V s - (r m p + gamma * mean p (earns m gamma pi N ((s, action p) :: hist))) >=
      d - eps).
    { unfold d, surplus_of. rewrite Es. set (e := mean p (earns _ _ _ _ _)) in *.
      assert (gamma * e <= gamma * (mean p V + eps)) by nra. nra. }
    set (x := V s - _) in *.
    assert (q * (d - eps) <= 2 * eps) by nra. unfold eps in *. nra.
  Qed.

  Lemma next_loses_nothing hist s p q o : is_state m s -> loses_nothing hist s -> 0 < gamma ->
    In (p, q) (pi hist s) -> 0 < q -> In o (outcomes p) ->
    loses_nothing ((s, action p) :: hist) (next o).
  Proof.
    intros Ss L g0 I q0 Io eps e0. destruct (va hist s Ss) as [Pl S1].
    destruct (Pl p q I) as (Ip & Es & _ & _). pose proof (wf_rows m wf p Ip) as R.
    pose proof (prob_pos m p R o Io) as w0. destruct (wf_discount m wf) as [_ g1].
    fold gamma in g1. pose proof (bellman p Ip) as Bp. fold gamma in Bp.
    unfold surplus_of in Bp. rewrite Es in Bp.
    assert (q1 : q <= 1).
    { rewrite <- S1. apply (sumQ_one snd (pi hist s) (p, q)); [|exact I]. intros [p' q'] I'.
      destruct (Pl p' q' I') as (_ & _ & ? & _). assumption. }
    set (k := q * gamma * prob p o).
    assert (k0 : 0 < k) by (unfold k; apply Qmult_lt_0_compat; [apply Qmult_lt_0_compat|];
      assumption).
    set (small := eps * k * (1 # 3)).
    assert (s0 : 0 < small).
    { unfold small. assert (0 < eps * k) by (apply Qmult_lt_0_compat; assumption). lra. }
    destruct (step_short hist s p q small Ss L I s0) as [N H]. exists N. intros n Ln.
    specialize (H n Ln). cbv zeta in H. destruct H as [H1 H2].
    set (e := earns m gamma pi n ((s, action p) :: hist)) in *.
    pose proof (mean_short m p e (fun t => V t + small) o R Io H2) as X. cbv beta in X.
    rewrite mean_plus, (mean_const m p R) in X.
    set (D := V (next o) + small - e (next o)) in *.
    assert (Y : gamma * (prob p o * D) <= gamma * (mean p V + small - mean p e)) by nra.
    assert (Z : gamma * (prob p o * D) <= V s - (r m p + gamma * mean p e) + small) by nra.
    assert (W : q * (gamma * (prob p o * D)) <= 3 * small) by nra.
    assert (K : k * D <= eps * k).
    { setoid_replace (k * D) with (q * (gamma * (prob p o * D))) by (unfold k; ring).
      unfold small in W. lra. }
    assert (D <= eps).
    { destruct (Qlt_le_dec eps D) as [B|B]; [exfalso|exact B].
      assert (k * eps < k * D) by (apply Qmult_lt_l; assumption). lra. }
    unfold D in *. fold e. lra.
  Qed.
End Unique.

(* Unique: every optimal policy takes optimal pairs alone, of which there is one. *)
Theorem one_policy_unique m hs a h rank : model_right m hs = true -> policy_right m a = true ->
  values m hs a h h rank = true ->
  optimal_pairs m (value h) (fun p => optimal m (Values h rank) p = true) ->
  one_optimum m (fun p => optimal m (Values h rank) p = true) true ->
  one_policy m (value h) a true.
Proof.
  intros M P K [Op _] One g0 pi va At.
  pose proof (model_right_ok m hs M) as [wf _].
  destruct (values_sound m hs a h h rank M P K) as (lam & C & L & C0 & X).
  assert (upper : forall n hist s, is_state m s ->
    earns m (discount m) pi n hist s <= value h s + pow lam n * C).
  { intros n hist s Ss. destruct (X s Ss) as [U _]. now apply U. }
  assert (bellman : forall p, In p (pairs m) ->
    surplus_of (discount m) (r m p) p (value h) <= 0).
  { intros p I. destruct (Op p I) as [E N]. unfold surplus_of.
    destruct (optimal m (Values h rank) p) eqn:e.
    - destruct E as [E _]. rewrite E by reflexivity. lra.
    - specialize (N ltac:(discriminate)). lra. }
  assert (go : forall hist s, meets m pi hist s -> is_state m s /\
    loses_nothing m (value h) pi hist s /\
    reached m (fun p => optimal m (Values h rank) p = true) s).
  { intros hist s Me. induction Me as [s B|hist s p q o Me IH I q0 Io].
    - split; [|split; [now apply At|now apply at_start]].
      destruct B as (q & I & _). destruct (wf_start m wf) as [_ W]. now apply (W s q).
    - destruct IH as (Ss & Ln & Re). destruct (va hist s Ss) as [Pl _].
      destruct (Pl p q I) as (Ip & Es & _ & _).
      split; [destruct (wf_rows m wf p Ip) as (_ & _ & _ & N); now apply N|]. split.
      + now apply (next_loses_nothing m (value h) lam C pi wf L C0 va upper bellman hist s p q o).
      + apply by_pair with p; [now rewrite Es|exact Ip| |exact Io]. apply Op; [exact Ip|].
        pose proof (plays_optimal m (value h) lam C pi wf L C0 va upper bellman hist s p q
          Ss Ln I q0) as Z. unfold surplus_of in Z. lra. }
  intros hist s Me. destruct (go hist s Me) as (Ss & Ln & Re).
  destruct (One s Re) as [En|Two]; [now left|right]. intros p q I q0.
  destruct (va hist s Ss) as [Pl _]. destruct (Pl p q I) as (Ip & Es & _ & _).
  destruct (policy_pair m a s P Ss) as (p' & Ip' & Es' & T).
  assert (same : p = p').
  { apply Two; auto; apply Op; auto.
    - pose proof (plays_optimal m (value h) lam C pi wf L C0 va upper bellman hist s p q
        Ss Ln I q0) as Z. unfold surplus_of in Z. lra.
    - pose proof K as K'. unfold values in K'. rewrite !andb_true_iff in K'.
      destruct K' as [[[_ Lh] _] F]. rewrite forallb_forall in F. specialize (F p' Ip').
      apply (level_right_ok m _ _ P) in Lh. unfold values_pair in F.
      apply andb_true_iff in F. destruct F as [_ F]. rewrite T in F. cbn [negb orb] in F.
      apply Z.leb_le in F. pose proof (wf_rows m wf p' Ip') as R.
      destruct (earned_ok m p' (proj1 (proj2 R))) as [r0 rq].
      pose proof (surplus_ge m _ _ (earned m p') p' h R Lh r0 rq F) as Z.
      specialize (bellman p' Ip'). unfold surplus_of in *. lra. }
  subst p'. unfold taken in T. apply Z.eqb_eq in T. congruence.
Qed.

(* The policy that draws one of the optimal pairs of each state, all alike *)
Definition chosen (m : model) (opt : pair -> bool) (s : Z) : list pair :=
  filter (fun p => (state p =? s)%Z && opt p) (pairs m).
Definition drawn (m : model) (opt : pair -> bool) : policy := fun _ s =>
  map (fun p => (p, 1 / inject_Z (Z.of_nat (length (chosen m opt s))))) (chosen m opt s).
Lemma sum_alike {A} (l : list A) c :
  sumQ snd (map (fun x => (x, c)) l) == inject_Z (Z.of_nat (length l)) * c.
Proof.
  induction l as [|x l IH]; cbn [map sumQ length snd].
  - change (inject_Z (Z.of_nat 0)) with 0. ring.
  - rewrite IH, Nat2Z.inj_succ, <- Z.add_1_r, inject_Z_plus. change (inject_Z 1) with 1. ring.
Qed.
Lemma drawn_in m opt s p : In p (chosen m opt s) <->
  In p (pairs m) /\ state p = s /\ opt p = true.
Proof.
  unfold chosen. rewrite filter_In, andb_true_iff, Z.eqb_eq. tauto.
Qed.
Lemma drawn_share m opt s p : In p (chosen m opt s) ->
  0 < 1 / inject_Z (Z.of_nat (length (chosen m opt s))).
Proof.
  intro I. apply Qlt_shift_div_l; [|lra]. apply inject_pos.
  destruct (chosen m opt s); [easy|cbn [length]; lia].
Qed.

(* Not unique: that policy is optimal, and takes another action where there are two. *)
Theorem one_policy_not_unique m hs a h rank : model_right m hs = true ->
  policy_right m a = true -> values m hs a h h rank = true ->
  optimal_pairs m (value h) (fun p => optimal m (Values h rank) p = true) ->
  one_optimum m (fun p => optimal m (Values h rank) p = true) false ->
  one_policy m (value h) a false.
Proof.
  intros M P K [Op At] (s & p & q & Re & En & Ip & Iq & Es & Et & Opp & Opq & Ne).
  pose proof (model_right_ok m hs M) as [wf _]. set (opt := optimal m (Values h rank)) in *.
  assert (some : forall s, is_state m s -> exists p, In p (chosen m opt s)).
  { intros t St. destruct (policy_pair m a t P St) as (p' & Ip' & Es' & T). exists p'.
    apply drawn_in. split; [exact Ip'|]. split; [exact Es'|]. apply Op; [exact Ip'|].
    pose proof K as K'. unfold values in K'. rewrite !andb_true_iff in K'.
    destruct K' as [[[_ Lh] _] F]. rewrite forallb_forall in F. specialize (F p' Ip').
    apply (level_right_ok m _ _ P) in Lh. unfold values_pair in F. rewrite T in F.
    rewrite !andb_true_iff in F. cbn [negb orb] in F. destruct F as [[_ F1] F2].
    apply Z.leb_le in F1, F2. pose proof (wf_rows m wf p' Ip') as R.
    destruct (earned_ok m p' (proj1 (proj2 R))) as [r0 rq].
    pose proof (surplus_ge m _ _ (earned m p') p' h R Lh r0 rq F2) as Z2.
    pose proof (surplus_le m _ _ (earned m p') p' h R Lh r0 rq F1) as Z1.
    unfold surplus_of in Z1, Z2. lra. }
  assert (pl : plays m (fun p => opt p = true) (drawn m opt)).
  { intros hist t St. split.
    - intros p' q' I. unfold drawn in I. apply in_map_iff in I. destruct I as (x & Eq & I).
      inversion Eq. subst x. pose proof (drawn_share m opt t p' I). apply drawn_in in I.
      destruct I as (? & ? & ?). repeat split; auto. lra.
    - unfold drawn. rewrite sum_alike. destruct (some t St) as [x I].
      pose proof (drawn_share m opt t x I) as D.
      field. intro Z. rewrite Z in D. unfold Qdiv in D. cbn in D. lra. }
  exists (drawn m opt). split; [exact (plays_valid m _ _ pl)|]. split.
  - intros t B. apply (At (drawn m opt) pl). destruct B as (q' & I & _).
    destruct (wf_start m wf) as [_ W]. now apply (W t q').
  - assert (me : forall t, reached m (fun p => opt p = true) t ->
      is_state m t /\ exists hist, meets m (drawn m opt) hist t).
    { intros t Rt. induction Rt as [t B|x o Rt [St (hist & Me)] Ix Ox Io].
      - split; [|exists []; now apply meets_start]. destruct B as (q' & I & _).
        destruct (wf_start m wf) as [_ W]. now apply (W t q').
      - split; [destruct (wf_rows m wf x Ix) as (_ & _ & _ & N); now apply N|].
        exists ((state x, action x) :: hist).
        assert (I : In x (chosen m opt (state x))) by (apply drawn_in; auto).
        apply meets_next with (1 / inject_Z (Z.of_nat (length (chosen m opt (state x)))));
          [exact Me| |now apply (drawn_share m opt _ x)|exact Io].
        unfold drawn. apply in_map_iff. exists x. auto. }
    destruct (me s Re) as [Ss (hist & Me)].
    assert (both : forall x, In x (pairs m) -> state x = s -> opt x = true -> action x <> a s ->
      exists hist s p q, meets m (drawn m opt) hist s /\ ~ is_end m s /\
        In (p, q) (drawn m opt hist s) /\ 0 < q /\ action p <> a s).
    { intros x Ix Ex Ox Nx. assert (I : In x (chosen m opt s)) by (apply drawn_in; auto).
      exists hist, s, x, (1 / inject_Z (Z.of_nat (length (chosen m opt s)))).
      split; [exact Me|]. split; [exact En|].
      split; [|split; [now apply (drawn_share m opt s x)|exact Nx]].
      unfold drawn. apply in_map_iff. exists x. auto. }
    destruct (Z.eq_dec (action p) (a s)) as [Ea|Na].
    + apply (both q Iq Et Opq). congruence.
    + now apply (both p Ip Es Opp).
Qed.
