(* Optima under limits: prices bound what policies earn, and visits that balance are a policy's.
*)
From Coq Require Import ZArith QArith Qreduction Qabs Qfield List Bool Lqa Lia Wf_nat.
From MDP Require Import Spec Checker Claims Arith Integers Start Bellman Goals.
From MDP Require Import LimitsChecker LimitsClaims.
Import ListNotations.
Open Scope Q_scope.

(* ---- sums -----------------------------------------------------------------------------------
  *)

Lemma sumQ_filter {A} (f : A -> Q) (b : A -> bool) l :
  sumQ f l == sumQ f (filter b l) + sumQ f (filter (fun x => negb (b x)) l).
Proof.
  induction l as [|x l IH]; cbn [sumQ filter]; [lra|]. destruct (b x); cbn [negb sumQ]; lra.
Qed.
Lemma sumQ_app {A} (f : A -> Q) l l' : sumQ f (l ++ l') == sumQ f l + sumQ f l'.
Proof. induction l as [|x l IH]; cbn [sumQ app]; [lra|]. rewrite IH. lra. Qed.
Lemma sumQ_flat {A B} (f : B -> Q) (k : A -> list B) l :
  sumQ f (flat_map k l) == sumQ (fun x => sumQ f (k x)) l.
Proof. induction l as [|x l IH]; cbn [sumQ flat_map]; [lra|]. rewrite sumQ_app, IH. lra. Qed.
Lemma sumQ_zero {A} (f : A -> Q) l : (forall x, In x l -> f x == 0) -> sumQ f l == 0.
Proof.
  induction l as [|x l IH]; cbn [sumQ]; intro H; [lra|].
  rewrite (H x (or_introl eq_refl)), IH by (intros; apply H; now right). lra.
Qed.

Lemma filter_of_map {A B} (k : A -> B) (b : B -> bool) l :
  filter b (map k l) = map k (filter (fun x => b (k x)) l).
Proof.
  induction l as [|x l IH]; cbn [map filter]; [reflexivity|].
  destruct (b (k x)); cbn [map]; now rewrite IH.
Qed.
Lemma filter_shorter {A} (b : A -> bool) l : (length (filter b l) <= length l)%nat.
Proof. induction l as [|x l IH]; cbn [filter length]; [lia|]. destruct (b x); cbn [length]; lia.
Qed.

(* If what each state is given adds up to 0, unless f is 0 there, then the sum with f is 0. *)
Lemma groups_zero (f : Z -> Q) : forall k (l : list (Z * Q)), (length l <= k)%nat ->
  (forall s a, In (s, a) l ->
    f s == 0 \/ sumQ snd (filter (fun x => (fst x =? s)%Z) l) == 0) ->
  sumQ (fun x => snd x * f (fst x)) l == 0.
Proof.
  induction k as [|k IH]; intros l Lk H.
  - destruct l; [reflexivity|cbn [length] in Lk; lia].
  - destruct l as [|[s a] l]; [reflexivity|]. set (all := (s, a) :: l) in *.
    rewrite (sumQ_filter _ (fun x => (fst x =? s)%Z) all).
    assert (own : sumQ (fun x => snd x * f (fst x)) (filter (fun x => (fst x =? s)%Z) all) == 0).
    { rewrite (sumQ_ext _ (fun x => snd x * f s)).
      - rewrite sumQ_times_right. destruct (H s a (or_introl eq_refl)) as [Z|Z]; rewrite Z; ring.
      - intros x I. apply filter_In in I. destruct I as [_ E]. apply Z.eqb_eq in E.
        now rewrite E. }
    rewrite own. set (rest := filter (fun x => negb (fst x =? s)%Z) all).
    assert (sumQ (fun x => snd x * f (fst x)) rest == 0); [|lra]. apply IH.
    + unfold rest, all. cbn [filter fst]. rewrite Z.eqb_refl. cbn [negb].
      pose proof (filter_shorter (fun x : Z * Q => negb (fst x =? s)%Z) l).
      unfold all in Lk. cbn [length] in Lk. lia.
    + intros t b I. unfold rest in I. apply filter_In in I. destruct I as [I N].
      cbn [fst] in N. destruct (H t b I) as [Z|Z]; [now left|right].
      assert (E : filter (fun x => (fst x =? t)%Z) rest = filter (fun x => (fst x =? t)%Z) all).
      { unfold rest. clear - N. induction all as [|y l' IHa]; [reflexivity|]. cbn [filter].
        destruct (Z.eqb_spec (fst y) s) as [Es|Es]; cbn [negb filter].
        - destruct (Z.eqb_spec (fst y) t) as [Et|Et]; [|exact IHa].
          apply negb_true_iff, Z.eqb_neq in N. congruence.
        - now rewrite IHa. }
      now rewrite E.
Qed.

(* ---- what n steps earn is linear in the rewards
  ----------------------------------------------- *)

Section Linear.
  Variables (gamma : Q) (pi : policy).
  Lemma run_linear f g k n : forall hist s,
    run (fun p => f p + k * g p) gamma (fun _ => 0) pi n hist s ==
    run f gamma (fun _ => 0) pi n hist s + k * run g gamma (fun _ => 0) pi n hist s.
  Proof.
    induction n; intros hist s; cbn [run]; [ring|]. rewrite <- sumQ_times, <- sumQ_plus.
    apply sumQ_ext. intros [p q] _. cbn [fst snd].
    rewrite (mean_ext p _ (fun t => run f gamma (fun _ => 0) pi n ((s, action p) :: hist) t +
      k * run g gamma (fun _ => 0) pi n ((s, action p) :: hist) t)) by (intros; apply IHn).
    rewrite mean_plus, mean_times. ring.
  Qed.
  Lemma run_ext f g n : (forall p, f p == g p) -> forall hist s,
    run f gamma (fun _ => 0) pi n hist s == run g gamma (fun _ => 0) pi n hist s.
  Proof.
    intros E. induction n; intros hist s; cbn [run]; [ring|]. apply sumQ_ext.
    intros [p q] _. cbn [fst snd]. rewrite E.
    rewrite (mean_ext p _ (run g gamma (fun _ => 0) pi n ((s, action p) :: hist)))
      by (intros; apply IHn). reflexivity.
  Qed.
  Lemma run_sum base ls n hist s :
    run (fun p => base p + sumQ (fun l => price l * amount l p) ls) gamma (fun _ => 0) pi n hist s
    == run base gamma (fun _ => 0) pi n hist s +
      sumQ (fun l => price l * run (amount l) gamma (fun _ => 0) pi n hist s) ls.
  Proof.
    revert base. induction ls as [|l ls IH]; intro base; cbn [sumQ].
    - rewrite (run_ext _ base) by (intro; ring). ring.
    - rewrite (run_ext _ (fun p => (base p + price l * amount l p) +
        sumQ (fun l => price l * amount l p) ls)) by (intro; ring).
      rewrite IH, run_linear. ring.
  Qed.
End Linear.

Lemma total_sum m pi base ls n :
  total m (fun p => base p + sumQ (fun l => price l * amount l p) ls) pi n ==
  total m base pi n + sumQ (fun l => price l * total m (amount l) pi n) ls.
Proof.
  unfold total.
  rewrite (sumQ_ext _ (fun sq : Z * Q => snd sq * run base (discount m) (fun _ => 0)
    pi n [] (fst sq) +
    snd sq * sumQ (fun l => price l * run (amount l) (discount m) (fun _ => 0) pi n [] (fst sq))
      ls))
    by (intros; rewrite run_sum; ring).
  rewrite sumQ_plus. apply Qplus_inj_l. induction ls as [|l ls IH]; cbn [sumQ].
  - apply sumQ_zero. intros. ring.
  - rewrite <- IH, <- sumQ_times, <- sumQ_plus. apply sumQ_ext. intros. ring.
Qed.
Lemma total_ext m pi f g n : (forall p, f p == g p) -> total m f pi n == total m g pi n.
Proof. intro E. apply sumQ_ext. intros sq _. now rewrite (run_ext _ _ f g n E). Qed.

(* ---- what the tests of the checker show
  ------------------------------------------------------- *)

Section Dual.
  Variables (m : model) (hs : hints) (c : limited).
  Hypotheses (M : model_right m hs = true) (H : dual_right m c hs = true).
  Let V := value (dual c).
  Let gamma := discount m.
  Let base (p : pair) : Q := if feasible c then r m p else 0.
  Let W (p : pair) : Q := base p + sumQ (fun l => price l * amount l p) (limits c).

  Lemma parts : policy_right m (way_out hs) = true /\ rank_fits m (end_rank c) = true /\
    (forall p, In p (pairs m) -> ends_by_rank hs (end_rank c) p = true) /\
    level_right m (dual c) = true /\
    (forall p, In p (pairs m) -> dual_pair m hs c p = true).
  Proof.
    pose proof H as X. unfold dual_right in X. rewrite !andb_true_iff, !forallb_forall in X.
    tauto.
  Qed.
  Lemma l_wf : well_formed m.
  Proof. exact (wf m hs (model_right_ok m hs M)). Qed.
  Lemma l_end s : ends hs s = true -> is_end m s.
  Proof. exact (ends_ok m hs (model_right_ok m hs M) s). Qed.
  Lemma l_dual : level_pos m (dual c).
  Proof. destruct parts as (P & _ & _ & D & _). exact (level_right_ok m _ _ P D). Qed.
  Lemma amount_ok p l : positive (counted p l) /\ quotient (counted p l) == amount l p.
  Proof. apply ratio_of_ok. Qed.
  Lemma priced_ok y q : positive y ->
    positive (snd (priced y q)) /\ inject_Z (fst (priced y q)) * quotient (snd (priced y q)) ==
      q * quotient y.
  Proof.
    unfold priced, positive, quotient. destruct y as [t b]. cbn [fst snd]. intro B.
    split; [lia|]. rewrite inject_Z_mult, Q_num. field. split; apply inject_nz; [exact B|lia].
  Qed.
  Lemma lagrangian_ok p : In p (pairs m) ->
    positive (lagrangian m c p) /\ quotient (lagrangian m c p) == W p.
  Proof.
    intro I. destruct (earned_ok m p) as [r0 rq]; [apply (wf_rows m l_wf p I)|].
    unfold lagrangian. set (l := map _ (limits c)).
    destruct (sum_of_ok ((if feasible c then 1 else 0, earned m p)%Z :: l)) as [P E].
    { intros term [<-|J]; [exact r0|]. apply in_map_iff in J. destruct J as (y & <- & _).
      apply priced_ok, amount_ok. }
    split; [exact P|]. rewrite E. cbn [sumQ fst snd]. unfold W. apply Qplus_comp.
    - unfold base. rewrite rq. destruct (feasible c); [change (inject_Z 1) with 1|
        change (inject_Z 0) with 0]; ring.
    - unfold l. rewrite sumQ_map. apply sumQ_ext. intros y _.
      destruct (priced_ok (counted p y) (price y)) as [_ ->]; [apply amount_ok|].
      destruct (amount_ok p y) as [_ ->]. reflexivity.
  Qed.

  (* At ends nothing is earned or counted, and the dual is not negative. *)
  Lemma end_pair p : In p (pairs m) -> ends hs (state p) = true ->
    r m p == 0 /\ (forall l, In l (limits c) -> amount l p == 0) /\
    (forall o, In o (outcomes p) -> next o = state p) /\ 0 <= V (state p).
  Proof.
    intros I E. destruct (l_end _ E p I eq_refl) as [Me S].
    split; [unfold r; destruct (maximise m); lra|].
    destruct parts as (_ & _ & _ & _ & D). specialize (D p I). unfold dual_pair in D.
    rewrite E in D. apply andb_true_iff in D. destruct D as [D N]. rewrite forallb_forall in D.
    split; [|split; [exact S|]].
    - intros l J. specialize (D l J). apply Z.eqb_eq in D.
      destruct (amount_ok p l) as [P Q]. rewrite <- Q. unfold quotient. rewrite D.
      change (inject_Z 0) with 0. unfold positive in P. apply inject_pos in P. field. lra.
    - apply Z.leb_le in N. apply value_nneg; [|exact N]. apply l_dual.
      apply (wf_rows m l_wf p I).
  Qed.
  Lemma end_W p : In p (pairs m) -> ends hs (state p) = true -> W p == 0.
  Proof.
    intros I E. destruct (end_pair p I E) as (r0 & a0 & _). unfold W, base.
    rewrite (sumQ_zero _ (limits c)) by (intros l J; rewrite (a0 l J); ring).
    destruct (feasible c); lra.
  Qed.

  (* A potential that each step lowers *)
  Lemma end_potential : exists lam w, 0 <= lam < 1 /\ (forall s, 0 <= w s <= 2) /\
    (forall s, ends hs s = false -> 1 <= w s) /\
    forall p, In p (pairs m) -> gamma * mean p w <= lam * w (state p).
  Proof.
    destruct parts as (P & F & R & _). unfold rank_fits in F.
    destruct (end_rank c) as [rk|].
    - apply andb_true_iff in F. destruct F as [one rk0]. apply is_one_ok in one.
      pose proof (rank_right_ok m _ rk P rk0) as nn.
      destruct (rank_potential m (ends hs) rk l_wf nn) as (lam & w & L & WW & step).
      exists lam, w. split; [exact L|]. split; [intro s; split; apply WW|].
      split; [apply (w_out w _ WW)|]. intros p I. unfold gamma. rewrite one, Qmult_1_l.
      apply (step p I). specialize (R p I). cbn [ends_by_rank] in R.
      destruct (ends hs (state p)) eqn:E.
      + destruct (end_pair p I E) as (_ & _ & S & _). intros o Io. now rewrite (S o Io).
      + cbn [orb] in R. apply falls_ok in R. destruct R as (o & ? & ? & _). eauto.
    - exists gamma, (fun _ => 1). destruct (wf_discount m l_wf) as [g0 g1]. fold gamma in g0, g1.
      apply negb_true_iff in F. assert (N : ~ gamma == 1).
      { intro X. apply is_one_ok in X. unfold gamma in X. congruence. }
      assert (gamma < 1) by (destruct (Qlt_le_dec gamma 1); [assumption|]; exfalso; apply N; lra).
      split; [lra|]. split; [intro; lra|]. split; [intros; lra|]. intros p I.
      rewrite (mean_const m p (wf_rows m l_wf p I)). lra.
  Qed.

  (* ---- prices and the dual bound what every policy earns *)

  Lemma dual_bound : exists lam C, 0 <= lam < 1 /\ 0 <= C /\ forall pi n, valid m pi ->
    total m W pi n <= sumQ (fun sq => snd sq * V (fst sq)) (start m) + pow lam n * C.
  Proof.
    destruct end_potential as (lam & w & L & wb & w1 & step).
    destruct (bounded m V) as (C & C0 & B).
    exists lam, (2 * C). split; [exact L|]. split; [lra|]. intros pi n va.
    assert (each : forall s, is_state m s ->
      run W gamma (fun _ => 0) pi n [] s <= V s + pow lam n * (2 * C)).
    { intros s Ss. apply Qle_trans with (V s + pow lam n * C * w s).
      - apply (weighted_upper m (fun _ => True) (fun _ => True) W gamma lam C (fun _ => 0) w V pi
          l_wf); auto; try lra; try (apply (wf_discount m l_wf)).
        + intros p I _ _. destruct parts as (_ & _ & _ & _ & D). specialize (D p I).
          unfold dual_pair in D. destruct (ends hs (state p)) eqn:E.
          * destruct (end_pair p I E) as (_ & _ & S & V0). unfold surplus_of.
            rewrite (end_W p I E), (mean_ext p V (fun _ => V (state p)))
              by (intros o Io; now rewrite (S o Io)).
            rewrite (mean_const m p (wf_rows m l_wf p I)).
            destruct (wf_discount m l_wf) as [g0 g1]. fold gamma in g0, g1. nra.
          * apply Z.leb_le in D. destruct (lagrangian_ok p I) as [P E'].
            apply (surplus_le m gamma _ _ p (dual c) (wf_rows m l_wf p I) l_dual P E' D).
        + intros t St _. specialize (B t St). destruct (ends hs t) eqn:E.
          * destruct parts as (P & _). destruct (policy_pair m _ t P St) as (p & I & <- & _).
            destruct (end_pair p I E) as (_ & _ & _ & V0). specialize (wb (state p)). nra.
          * specialize (w1 t E). nra.
      - specialize (wb s). assert (0 <= pow lam n) by (apply pow_nneg; lra).
        assert (0 <= pow lam n * C) by nra. nra. }
    unfold total. apply Qle_trans with
      (sumQ (fun sq => snd sq * (V (fst sq) + pow lam n * (2 * C))) (start m)).
    - apply sumQ_le. intros [s q] I. cbn [fst snd]. destruct (wf_start m l_wf) as [_ D].
      destruct (D s q I) as [Ss q0]. specialize (each s Ss). fold gamma. nra.
    - rewrite (sumQ_ext _ (fun sq : Z * Q => snd sq * V (fst sq) +
        snd sq * (pow lam n * (2 * C)))) by (intros; ring).
      rewrite sumQ_plus, sumQ_times_right. destruct (wf_start m l_wf) as [S1 _]. rewrite S1. lra.
  Qed.
End Dual.

(* ---- visits that balance are those of a policy
  ------------------------------------------------ *)

Section Flow.
  Variables (m : model) (hs : hints) (c : limited).
  Hypotheses (M : model_right m hs = true) (H : dual_right m c hs = true)
    (Fl : flow_right m hs c = true).
  Let gamma := discount m.
  Let x (p : pair) : Q := quotient (visits_of c p).
  Let l_wf := l_wf m hs M.
  Let end_pair := end_pair m hs c M H.
  Let end_potential := end_potential m hs c M H.

  Let own (s : Z) : list pair := filter (fun p => (state p =? s)%Z) (pairs m).
  Definition flowing : policy := fun hist s =>
    if Qle_bool (sumQ x (own s)) 0 then stationary m (way_out hs) hist s
    else map (fun p => (p, x p / sumQ x (own s))) (own s).

  Lemma own_in s p : In p (own s) <-> In p (pairs m) /\ state p = s.
  Proof. unfold own. rewrite filter_In, Z.eqb_eq. reflexivity. Qed.
  Lemma visits_right p : In p (pairs m) -> positive (visits_of c p) /\ 0 <= x p.
  Proof.
    intro I. pose proof Fl as F. unfold flow_right in F.
    cbv zeta in F. apply andb_true_iff in F. destruct F as [F _]. rewrite forallb_forall in F.
    specialize (F p I). apply andb_true_iff in F. destruct F as [F0 F1].
    apply Z.leb_le in F0. apply Z.ltb_lt in F1. split; [exact F1|]. unfold x, quotient.
    apply inject_pos in F1. apply inject_nneg in F0. apply Qle_shift_div_l; lra.
  Qed.
  Lemma flowing_valid : valid m flowing.
  Proof.
    destruct (parts m hs c H) as (P & _). intros hist s Ss. unfold flowing.
    destruct (Qle_bool (sumQ x (own s)) 0) eqn:E.
    - exact (plays_valid m _ _ (stationary_plays m _ P) hist s Ss).
    - assert (A : 0 < sumQ x (own s)).
      { apply Qnot_le_lt. intro L. apply Qle_bool_iff in L. congruence. }
      split.
      + intros p q I. apply in_map_iff in I. destruct I as (y & Eq & I). inversion Eq. subst y.
        apply own_in in I. destruct I as [I Es]. repeat split; auto.
        destruct (visits_right p I) as [_ x0]. apply Qle_shift_div_l; lra.
      + rewrite sumQ_map. cbn [snd].
        rewrite (sumQ_ext _ (fun p => / sumQ x (own s) * x p)) by (intros; unfold Qdiv; ring).
        rewrite sumQ_times. field. lra.
  Qed.

  Section Amount.
  Variable a : pair -> Q.
  Hypothesis a_end : forall p, In p (pairs m) -> ends hs (state p) = true -> a p == 0.
  Let F (n : nat) (s : Z) : Q := run a gamma (fun _ => 0) flowing n [] s.

  Lemma run_history n : forall hist s, run a gamma (fun _ => 0) flowing n hist s == F n s.
  Proof.
    unfold F. induction n; intros hist s; cbn [run]; [reflexivity|].
    change (flowing hist s) with (flowing [] s). apply sumQ_ext. intros [p q] _. cbn [fst snd].
    rewrite (mean_ext p _ (run a gamma (fun _ => 0) flowing n [(s, action p)])); [reflexivity|].
    intros o _. rewrite IHn. symmetry. apply IHn.
  Qed.
  Lemma F_step n s : F (S n) s ==
    sumQ (fun ch => snd ch * (a (fst ch) + gamma * mean (fst ch) (F n))) (flowing [] s).
  Proof.
    unfold F at 1. cbn [run]. apply sumQ_ext. intros [p q] _. cbn [fst snd].
    rewrite (mean_ext p _ (F n)) by (intros; apply run_history). reflexivity.
  Qed.
  Lemma F_end n s : is_state m s -> ends hs s = true -> F n s == 0.
  Proof.
    intros Ss E. destruct (wf_discount m l_wf) as [g0 _]. fold gamma in g0.
    assert (cl : forall p, In p (pairs m) -> True -> ends hs (state p) = true ->
      forall o, In o (outcomes p) -> ends hs (next o) = true).
    { intros p I _ Ep o Io. destruct (end_pair p I Ep) as (_ & _ & S & _). now rewrite (S o Io). }
    assert (z : forall p, In p (pairs m) -> ends hs (state p) = true ->
      a p + gamma * mean p (fun _ => 0) == 0).
    { intros p I Ep. rewrite (a_end p I Ep), (mean_const m p (wf_rows m l_wf p I)). ring. }
    apply Qle_antisym.
    - apply (run_upper m (fun _ => True) (fun s => ends hs s = true) a gamma (fun _ => 0)
        (fun _ _ => 0) flowing l_wf g0 flowing_valid cl); [intros; lra| |exact Ss|exact E].
      intros _ p I _ Ep. rewrite (z p I Ep). lra.
    - apply (run_lower m (fun _ => True) (fun s => ends hs s = true) a gamma (fun _ => 0)
        (fun _ _ => 0) flowing l_wf g0 flowing_valid cl); [intros; lra| |exact Ss|exact E].
      intros _ p I _ Ep. rewrite (z p I Ep). lra.
  Qed.

  (* In each state, what the visits earn now and next is what the policy earns. *)
  Lemma visits_step n :
    sumQ (fun p => x p * (a p + gamma * mean p (F n))) (pairs m) ==
    sumQ (fun p => x p * F (S n) (state p)) (pairs m).
  Proof.
    set (B := fun p => a p + gamma * mean p (F n)).
    assert (Z : sumQ (fun y => snd y * 1)
      (map (fun p => (state p, x p * (B p - F (S n) (state p)))) (pairs m)) == 0).
    { apply (groups_zero (fun _ => 1) _ _ (le_n _)). intros s y I. right.
      apply in_map_iff in I. destruct I as (p0 & Eq & I0). injection Eq as <- _.
      rewrite filter_of_map, sumQ_map. cbn [fst snd].
      change (filter (fun p => (state p =? state p0)%Z) (pairs m)) with (own (state p0)).
      set (t := state p0) in *. set (all := sumQ x (own t)).
      rewrite (sumQ_ext _ (fun p => x p * B p + (- F (S n) t) * x p)).
      2: { intros p I. apply own_in in I. destruct I as [_ E]. rewrite E. ring. }
      rewrite sumQ_plus, sumQ_times. fold all.
      assert (x0 : forall p, In p (own t) -> 0 <= x p).
      { intros p I. apply own_in in I. now apply visits_right. }
      destruct (Qle_bool all 0) eqn:E.
      - apply Qle_bool_iff in E. assert (A0 : all == 0).
        { assert (0 <= all) by (apply sumQ_pos; exact x0). lra. }
        rewrite A0. rewrite sumQ_zero; [ring|]. intros p I.
        assert (x p == 0); [|rewrite H0; ring].
        pose proof (sumQ_one x (own t) p x0 I). fold all in H0. specialize (x0 p I). lra.
      - assert (A : 0 < all).
        { apply Qnot_le_lt. intro L. apply Qle_bool_iff in L. congruence. }
        assert (S1 : F (S n) t == sumQ (fun p => / all * (x p * B p)) (own t)).
        { rewrite F_step. unfold flowing. fold all. rewrite E, sumQ_map. cbn [fst snd].
          apply sumQ_ext. intros p _. unfold B, Qdiv. ring. }
        rewrite S1, sumQ_times. field. lra. }
    rewrite sumQ_map in Z. cbn [fst snd] in Z.
    assert (Y : sumQ (fun p => x p * B p) (pairs m) - sumQ (fun p => x p * F (S n) (state p))
      (pairs m) == 0).
    { rewrite <- Z. setoid_replace (sumQ (fun p => x p * B p) (pairs m) -
        sumQ (fun p => x p * F (S n) (state p)) (pairs m)) with
        (sumQ (fun p => x p * B p) (pairs m) +
         (-1) * sumQ (fun p => x p * F (S n) (state p)) (pairs m)) by ring.
      rewrite <- sumQ_times, <- sumQ_plus. apply sumQ_ext. intros. ring. }
    unfold B in Y. lra.
  Qed.

  Let worth (t : Z * (Z * ratio)) : Q := inject_Z (fst (snd t)) * quotient (snd (snd t)).
  Lemma moved_ok p : In p (pairs m) ->
    (forall t, In t (moved m c p) -> positive (snd (snd t)) /\ is_state m (fst t)) /\
    forall f, sumQ (fun t => worth t * f (fst t)) (moved m c p) ==
      - x p * f (state p) + gamma * x p * mean p f.
  Proof.
    intro I. pose proof (wf_rows m l_wf p I) as R. pose proof R as (Ss & D & _ & O).
    destruct (visits_right p I) as [b0 _]. unfold x. unfold moved, given.
    destruct (visits_of c p) as [t b]. unfold positive in b0. cbn [fst snd] in b0. split.
    - intros y [<-|J]; cbn [fst snd]; [split; [exact b0|exact Ss]|].
      apply in_map_iff in J. destruct J as (o & <- & Io). cbn [fst snd].
      split; [unfold positive; cbn [snd]; nia|now apply O].
    - intro f. cbn [sumQ fst snd]. rewrite sumQ_map. unfold worth at 1. cbn [fst snd].
      change (inject_Z (-1)) with (-1).
      rewrite (sumQ_ext _ (fun o => (gamma * quotient (t, b)) * (prob p o * f (next o)))).
      + rewrite sumQ_times. fold (mean p f). ring.
      + intros o _. unfold worth, quotient, prob. cbn [fst snd].
        rewrite !inject_Z_mult, Q_num. fold gamma. field.
        repeat split; apply inject_nz; assumption || lia.
  Qed.
  Lemma terms_ok t : In t (flow_terms m c) -> positive (snd (snd t)) /\ is_state m (fst t).
  Proof.
    intro I. unfold flow_terms in I. apply in_app_iff in I. destruct I as [I|I].
    - apply in_map_iff in I. destruct I as ([s q] & <- & I). cbn [fst snd].
      destruct (wf_start m l_wf) as [_ D]. destruct (D s q I) as [Ss _].
      split; [apply ratio_of_ok|exact Ss].
    - apply in_flat_map in I. destruct I as (p & J & I). apply filter_In in J.
      destruct J as [J _]. now apply (moved_ok p J).
  Qed.

  (* The visits balance: what the start and they give to each state, they take. *)
  Lemma balance f : (forall s, is_state m s -> ends hs s = true -> f s == 0) ->
    sumQ (fun sq => snd sq * f (fst sq)) (start m) +
    gamma * sumQ (fun p => x p * mean p f) (pairs m) ==
    sumQ (fun p => x p * f (state p)) (pairs m).
  Proof.
    intro fe.
    assert (Sum : sumQ (fun y => snd y * f (fst y))
      (map (fun t => (fst t, worth t)) (flow_terms m c)) == 0).
    { apply (groups_zero f _ _ (le_n _)). intros s y I. apply in_map_iff in I.
      destruct I as (t & Eq & I). injection Eq as <- _.
      destruct (terms_ok t I) as [_ Ss]. destruct (ends hs (fst t)) eqn:E; [left; now apply fe|].
      right. destruct (parts m hs c H) as (P & _). pose proof Fl as B. unfold flow_right in B.
      cbv zeta in B. apply andb_true_iff in B. destruct B as [_ B].
      rewrite forallb_forall in B. destruct (policy_pair m _ _ P Ss) as (p & Ip & Ep & _).
      specialize (B p Ip). rewrite Ep, E in B. cbn [orb] in B. apply Z.eqb_eq in B.
      destruct (sum_of_ok (grouped (flow_terms m c) (fst t))) as [Po Q].
      { intros term J. unfold grouped in J. apply in_map_iff in J. destruct J as (u & <- & J).
        apply filter_In in J. now apply terms_ok. }
      rewrite filter_of_map, sumQ_map. cbn [fst snd]. unfold grouped in Q.
      rewrite sumQ_map in Q. unfold worth. rewrite <- Q. unfold quotient at 1.
      unfold grouped in B. rewrite B. change (inject_Z 0) with 0. unfold positive in Po.
      apply inject_pos in Po. unfold grouped in Po. field. lra. }
    rewrite sumQ_map in Sum. cbn [fst snd] in Sum. unfold flow_terms in Sum.
    rewrite sumQ_app, sumQ_map, sumQ_flat in Sum. cbn [fst snd] in Sum.
    assert (S1 : sumQ (fun sq : Z * Q => worth (fst sq, (1%Z, ratio_of (snd sq))) * f (fst sq))
      (start m) == sumQ (fun sq => snd sq * f (fst sq)) (start m)).
    { apply sumQ_ext. intros sq _. unfold worth. cbn [fst snd].
      destruct (ratio_of_ok (snd sq)) as [_ ->]. change (inject_Z 1) with 1. ring. }
    rewrite S1 in Sum. set (nz := fun p => negb (fst (visits_of c p) =? 0)%Z) in Sum.
    set (G := fun p => - x p * f (state p) + gamma * x p * mean p f).
    assert (S2 : sumQ (fun p => sumQ (fun t => worth t * f (fst t)) (moved m c p))
      (filter nz (pairs m)) == sumQ G (pairs m)).
    { rewrite (sumQ_filter G nz (pairs m)).
      rewrite (sumQ_zero G (filter (fun p => negb (nz p)) _)).
      - rewrite Qplus_0_r. apply sumQ_ext. intros p I. apply filter_In in I. destruct I as [I _].
        unfold G. now apply moved_ok.
      - intros p I. apply filter_In in I. destruct I as [I N]. unfold nz in N.
        rewrite negb_involutive in N. apply Z.eqb_eq in N. unfold G.
        assert (x p == 0); [|rewrite H0; ring]. unfold x, quotient. rewrite N.
        change (inject_Z 0) with 0. destruct (visits_right p I) as [b0 _]. unfold positive in b0.
        apply inject_pos in b0. field. lra. }
    rewrite S2 in Sum. unfold G in Sum.
    rewrite (sumQ_ext _ (fun p => (-1) * (x p * f (state p)) + gamma * (x p * mean p f))) in Sum
      by (intros; ring).
    rewrite sumQ_plus, !sumQ_times in Sum. lra.
  Qed.

  (* From step to step, what the policy earns changes by less and less. *)
  Lemma F_settles : exists lam R w, 0 <= lam < 1 /\ 0 <= R /\ (forall s, 0 <= w s <= 2) /\
    forall n s, is_state m s ->
      - (pow lam n * R * w s) <= F (S n) s - F n s <= pow lam n * R * w s.
  Proof.
    destruct end_potential as (lam & w & L & wb & w1 & step). fold gamma in step.
    destruct (bound_pairs a (pairs m)) as (R & R0 & HR).
    exists lam, R, w. split; [exact L|]. split; [exact R0|]. split; [exact wb|].
    destruct (wf_discount m l_wf) as [g0 _]. fold gamma in g0.
    induction n; intros s Ss; destruct (flowing_valid [] s Ss) as [Pl S1].
    - assert (E : F 1 s - F 0 s == sumQ (fun ch => snd ch * a (fst ch)) (flowing [] s)).
      { rewrite F_step. unfold F at 2. cbn [run].
        rewrite (sumQ_ext _ (fun ch : pair * Q => snd ch * a (fst ch))); [ring|].
        intros [p q] I. cbn [fst snd]. destruct (Pl p q I) as (Ip & _).
        rewrite (mean_ext p (F 0) (fun _ => 0)) by (intros; reflexivity).
        rewrite (mean_const m p (wf_rows m l_wf p Ip)). ring. }
      assert (b : forall p q, In (p, q) (flowing [] s) -> 0 <= q /\ - (R * w s) <= a p <=
        R * w s).
      { intros p q I. destruct (Pl p q I) as (Ip & Es & q0 & _). split; [exact q0|].
        specialize (HR p Ip). specialize (wb s). destruct (ends hs (state p)) eqn:E0.
        - rewrite (a_end p Ip E0). nra.
        - specialize (w1 _ E0). rewrite Es in w1. nra. }
      rewrite E. cbn [pow]. split.
      + apply Qle_trans with (- (R * w s)); [lra|].
        apply (mix_ge a); [intros p q I; destruct (b p q I); lra|exact S1].
      + apply Qle_trans with (R * w s); [|lra].
        apply (mix_le a); [intros p q I; destruct (b p q I); lra|exact S1].
    - set (g := fun p => gamma * (mean p (F (S n)) - mean p (F n))).
      assert (E : F (S (S n)) s - F (S n) s == sumQ (fun ch => snd ch * g (fst ch))
        (flowing [] s)).
      { rewrite (F_step (S n)), (F_step n).
        setoid_replace (sumQ (fun ch : pair * Q => snd ch * (a (fst ch) + gamma * mean (fst ch)
          (F (S n)))) (flowing [] s) - sumQ (fun ch : pair * Q => snd ch * (a (fst ch) +
          gamma * mean (fst ch) (F n))) (flowing [] s)) with
          (sumQ (fun ch : pair * Q => snd ch * (a (fst ch) + gamma * mean (fst ch) (F (S n))))
          (flowing [] s) + (-1) * sumQ (fun ch : pair * Q => snd ch * (a (fst ch) +
          gamma * mean (fst ch) (F n))) (flowing [] s)) by ring.
        rewrite <- sumQ_times, <- sumQ_plus. apply sumQ_ext. intros ch _. unfold g. ring. }
      assert (b : forall p q, In (p, q) (flowing [] s) -> 0 <= q /\
        - (pow lam (S n) * R * w s) <= g p <= pow lam (S n) * R * w s).
      { intros p q I. destruct (Pl p q I) as (Ip & Es & q0 & _). split; [exact q0|].
        pose proof (wf_rows m l_wf p Ip) as Rw. set (k := pow lam n * R).
        assert (k0 : 0 <= k).
        { unfold k. assert (0 <= pow lam n) by (apply pow_nneg; lra). nra. }
        assert (up : mean p (F (S n)) <= mean p (fun t => F n t + k * w t)).
        { apply (mean_le m p Rw). intros o Io. destruct Rw as (_ & _ & _ & O).
          destruct (O o Io) as [_ So]. destruct (IHn _ So) as [_ U]. fold k in U. lra. }
        assert (lo : mean p (F n) <= mean p (fun t => F (S n) t + k * w t)).
        { apply (mean_le m p Rw). intros o Io. destruct Rw as (_ & _ & _ & O).
          destruct (O o Io) as [_ So]. destruct (IHn _ So) as [U _]. fold k in U. lra. }
        rewrite mean_plus, mean_times in up, lo. specialize (step p Ip). rewrite Es in step.
        unfold g. cbn [pow].
        setoid_replace (lam * pow lam n * R * w s) with (k * (lam * w s)) by (unfold k; ring).
        assert (k * (gamma * mean p w) <= k * (lam * w s)) by nra.
        set (e1 := mean p (F (S n))) in *. set (e0 := mean p (F n)) in *.
        set (e := mean p w) in *.
        assert (gamma * (e1 - e0) <= gamma * (k * e)) by nra.
        assert (gamma * (e0 - e1) <= gamma * (k * e)) by nra.
        split; nra. }
      rewrite E. split.
      + apply (mix_ge g); [intros p q I; destruct (b p q I); lra|exact S1].
      + apply (mix_le g); [intros p q I; destruct (b p q I); lra|exact S1].
  Qed.

  (* So the policy earns, in the limit, what the visits do. *)
  Lemma flow_total : exists lam C, 0 <= lam < 1 /\ 0 <= C /\ forall n,
    - (pow lam n * C) <= total m a flowing n - sumQ (fun p => x p * a p) (pairs m) <=
    pow lam n * C.
  Proof.
    destruct F_settles as (lam & R & w & L & R0 & wb & D).
    set (X := sumQ x (pairs m)). assert (X0 : 0 <= X).
    { apply sumQ_pos. intros p I. now apply visits_right. }
    exists lam, (R * 2 * X). split; [exact L|]. split; [nra|]. intro n.
    assert (B := balance (F n) (fun s Ss E => F_end n s Ss E)).
    assert (St := visits_step n).
    rewrite (sumQ_ext _ (fun p => x p * a p + gamma * (x p * mean p (F n)))) in St
      by (intros; ring).
    rewrite sumQ_plus, sumQ_times in St.
    assert (T : total m a flowing n == sumQ (fun sq => snd sq * F n (fst sq)) (start m))
      by (unfold total, F; reflexivity).
    set (k := pow lam n * R * 2).
    assert (k0 : 0 <= pow lam n * R).
    { assert (0 <= pow lam n) by (apply pow_nneg; lra). nra. }
    assert (up : sumQ (fun p => x p * F (S n) (state p)) (pairs m) <=
      sumQ (fun p => x p * F n (state p) + k * x p) (pairs m)).
    { apply sumQ_le. intros p I. destruct (visits_right p I) as [_ x0].
      destruct (wf_rows m l_wf p I) as (Ss & _). destruct (D n _ Ss) as [_ U].
      specialize (wb (state p)). assert (pow lam n * R * w (state p) <= k) by (unfold k; nra).
      nra. }
    assert (lo : sumQ (fun p => x p * F n (state p)) (pairs m) <=
      sumQ (fun p => x p * F (S n) (state p) + k * x p) (pairs m)).
    { apply sumQ_le. intros p I. destruct (visits_right p I) as [_ x0].
      destruct (wf_rows m l_wf p I) as (Ss & _). destruct (D n _ Ss) as [U _].
      specialize (wb (state p)). assert (pow lam n * R * w (state p) <= k) by (unfold k; nra).
      nra. }
    rewrite sumQ_plus, sumQ_times in up, lo. fold X in up, lo.
    setoid_replace (pow lam n * (R * 2 * X)) with (k * X) by (unfold k; ring). lra.
  Qed.
  End Amount.
End Flow.

(* ---- the theorem -----------------------------------------------------------------------------
  *)

Lemma nneg_quotient y : positive y -> (0 <= fst y)%Z -> 0 <= quotient y.
Proof.
  unfold positive, quotient. intros P N. apply inject_pos in P. apply inject_nneg in N.
  apply Qle_shift_div_l; lra.
Qed.
Lemma zero_quotient y : positive y -> fst y = 0%Z -> quotient y == 0.
Proof.
  unfold positive, quotient. intros P N. rewrite N. apply inject_pos in P.
  change (inject_Z 0) with 0. field. lra.
Qed.
Lemma visited_ok y v : positive y -> positive v ->
  positive (snd (visited_term y v)) /\
  inject_Z (fst (visited_term y v)) * quotient (snd (visited_term y v)) ==
    quotient v * quotient y.
Proof.
  unfold visited_term, positive, quotient. destruct y as [t b], v as [top below].
  cbn [fst snd]. intros B D. split; [nia|]. rewrite inject_Z_mult. field.
  split; apply inject_nz; assumption.
Qed.
Lemma run_zero gamma pi n : forall hist s,
  run (fun _ => 0) gamma (fun _ => 0) pi n hist s == 0.
Proof.
  induction n; intros hist s; cbn [run]; [reflexivity|]. apply sumQ_zero. intros [p q] _.
  cbn [fst snd]. unfold mean. rewrite (sumQ_zero _ (outcomes p)); [ring|].
  intros o _. rewrite IHn. ring.
Qed.
Lemma eventually_all {A} (P : A -> nat -> Prop) l :
  (forall y, In y l -> eventually (P y)) -> eventually (fun n => forall y, In y l -> P y n).
Proof.
  induction l as [|y l IH]; intro H; [exists 0%nat; easy|].
  destruct (H y (or_introl eq_refl)) as [N HN].
  destruct IH as [M HM]; [intros; apply H; now right|]. exists (N + M)%nat.
  intros n L z [<-|I]; [apply HN; lia|apply HM; [lia|exact I]].
Qed.

Theorem limits_sound m c hs : check_limits m c hs = true -> limits_hold m c.
Proof.
  intro X. unfold check_limits in X. rewrite !andb_true_iff in X.
  destruct X as [[[[[M H] Fl] Ke] Pr] Bo]. rewrite forallb_forall in Ke.
  pose proof (l_wf m hs M) as wf. destruct (parts m hs c H) as (P & _).
  set (x := fun p => quotient (visits_of c p)).
  assert (xp : forall p, In p (pairs m) -> positive (visits_of c p) /\ 0 <= x p)
    by (intros; now apply (visits_right m hs c Fl)).
  assert (fr : positive (flow_reward m c) /\
    quotient (flow_reward m c) == sumQ (fun p => x p * r m p) (pairs m)).
  { unfold flow_reward. set (l := map _ (pairs m)). destruct (sum_of_ok l) as [S E].
    - intros t I. apply in_map_iff in I. destruct I as (p & <- & I).
      apply visited_ok; [apply earned_ok, (wf_rows m wf p I)|apply (xp p I)].
    - split; [exact S|]. rewrite E. unfold l. rewrite sumQ_map. apply sumQ_ext. intros p I.
      destruct (earned_ok m p) as [r0 rq]; [apply (wf_rows m wf p I)|].
      destruct (visited_ok _ _ r0 (proj1 (xp p I))) as [_ ->]. rewrite rq. reflexivity. }
  assert (fc : forall l, positive (flow_count m c l) /\
    quotient (flow_count m c l) == sumQ (fun p => x p * amount l p) (pairs m)).
  { intro l. unfold flow_count. set (k := map _ (pairs m)). destruct (sum_of_ok k) as [S E].
    - intros t I. apply in_map_iff in I. destruct I as (p & <- & I).
      apply visited_ok; [apply amount_ok|apply (xp p I)].
    - split; [exact S|]. rewrite E. unfold k. rewrite sumQ_map. apply sumQ_ext. intros p I.
      destruct (amount_ok p l) as [r0 rq].
      destruct (visited_ok _ _ r0 (proj1 (xp p I))) as [_ ->]. rewrite rq. reflexivity. }
  assert (kept : forall l, In l (limits c) ->
    least l - shift c <= sumQ (fun p => x p * amount l p) (pairs m)).
  { intros l I. specialize (Ke l I). unfold keeps in Ke. apply Z.leb_le in Ke.
    destruct (fc l) as [f0 fq]. destruct (ratio_of_ok (least l)) as [l0 lq].
    destruct (ratio_of_ok (shift c)) as [s0 sq].
    destruct (sum_of_ok [(1, flow_count m c l); (-1, ratio_of (least l));
      (1, ratio_of (shift c))]%Z) as [S E].
    { intros t [<-|[<-|[<-|[]]]]; assumption. }
    pose proof (nneg_quotient _ S Ke) as N. rewrite E in N. cbn [sumQ fst snd] in N.
    rewrite fq, lq, sq in N. change (inject_Z 1) with 1 in N.
    change (inject_Z (-1)) with (-1) in N. lra. }
  unfold prices_right in Pr. apply andb_true_iff in Pr. destruct Pr as [Pr Fe].
  apply andb_true_iff in Pr. destruct Pr as [Pr Sh]. apply Z.leb_le in Sh.
  apply Qnum_nneg in Sh. rewrite forallb_forall in Pr.
  assert (pr : forall l, In l (limits c) -> 0 <= price l).
  { intros l I. specialize (Pr l I). apply Z.leb_le in Pr. now apply Qnum_nneg. }
  set (PL := sumQ (fun l => price l * least l) (limits c)).
  set (SP := sumQ price (limits c)). assert (SP0 : 0 <= SP) by (apply sumQ_pos; exact pr).
  destruct (dual_bound m hs c M H) as (lam & C & L & C0 & Du).
  set (mu := sumQ (fun sq => snd sq * value (dual c) (fst sq)) (start m)) in *.
  set (base := fun p => if feasible c then r m p else 0) in *.
  assert (bound : mu <= (if feasible c then sumQ (fun p => x p * r m p) (pairs m)
    else - shift c) + PL).
  { unfold bound_right in Bo.
    destruct (sum_of_ok (map (start_term (dual c)) (start m))) as [S1 E1].
    { intros t I. apply in_map_iff in I. destruct I as ([s q] & <- & I).
      destruct (wf_start m wf) as [_ D].
      pose proof (l_dual m hs c H s (proj1 (D s q I))) as B. unfold start_term, positive.
      cbn [fst snd]. destruct (dual c s) as [t b]. cbn [fst snd] in *. now apply Z.mul_pos_pos. }
    assert (E2 : quotient (sum_of (map (start_term (dual c)) (start m))) == mu).
    { rewrite E1, sumQ_map. apply sumQ_ext. intros [s q] I. destruct (wf_start m wf) as [_ D].
      pose proof (l_dual m hs c H s (proj1 (D s q I))) as B.
      unfold start_term, value, quotient. cbn [fst snd]. destruct (dual c s) as [t b].
      cbn [fst snd] in *. rewrite inject_Z_mult, Q_num. field.
      split; apply inject_nz; [exact B|lia]. }
    cbv zeta in Bo. set (at_start := sum_of (map (start_term (dual c)) (start m))) in *.
    set (reward := if feasible c then flow_reward m c else ratio_of (shift c)) in Bo.
    set (sign := if feasible c then 1%Z else (-1)%Z) in Bo.
    set (ls := map _ (limits c)) in Bo. apply Z.leb_le in Bo.
    destruct (sum_of_ok ((-1, at_start) :: (sign, reward) :: ls)%Z) as [S3 E3].
    { intros y [<-|[<-|I]]; cbn [snd]; [exact S1| |].
      - unfold reward. destruct (feasible c); [apply fr|apply ratio_of_ok].
      - apply in_map_iff in I. destruct I as (l & <- & _). apply priced_ok, ratio_of_ok. }
    pose proof (nneg_quotient _ S3 Bo) as N. rewrite E3 in N. cbn [sumQ fst snd] in N.
    rewrite E2 in N. change (inject_Z (-1)) with (-1) in N.
    assert (E4 : sumQ (fun term => inject_Z (fst term) * quotient (snd term)) ls == PL).
    { unfold ls. rewrite sumQ_map. apply sumQ_ext. intros l _.
      destruct (ratio_of_ok (least l)) as [l0 lq].
      destruct (priced_ok (ratio_of (least l)) (price l) l0) as [_ ->]. now rewrite lq. }
    rewrite E4 in N. unfold sign, reward in N. destruct (feasible c).
    - destruct fr as [_ fq]. rewrite fq in N. change (inject_Z 1) with 1 in N. lra.
    - destruct (ratio_of_ok (shift c)) as [_ sq]. rewrite sq in N.
      change (inject_Z (-1)) with (-1) in N. lra. }
  assert (parted : forall pi n, valid m pi ->
    total m base pi n + sumQ (fun l => price l * total m (amount l) pi n) (limits c) <=
    mu + pow lam n * C).
  { intros pi n va. rewrite <- total_sum. now apply Du. }
  assert (paid : forall pi n t, (forall l, In l (limits c) -> least l - t <= total m (amount l)
    pi n)
    -> PL - t * SP <= sumQ (fun l => price l * total m (amount l) pi n) (limits c)).
  { intros pi n t K. unfold PL, SP.
    setoid_replace (sumQ (fun l => price l * least l) (limits c) - t * sumQ price (limits c))
      with (sumQ (fun l => price l * least l) (limits c) + (- t) * sumQ price (limits c)) by ring.
    rewrite <- sumQ_times, <- sumQ_plus. apply sumQ_le. intros l I. specialize (K l I).
    specialize (pr l I). nra. }
  assert (keeping : keeps_less m (limits c) (shift c) (flowing m hs c)).
  { intros l I eps e0.
    destruct (flow_total m hs c M H Fl (amount l)) as (la & D & La & D0 & T).
    { intros p Ip E. now apply (end_pair m hs c M H p Ip E). }
    destruct (pow_vanishes la D eps La D0 e0) as [N HN]. exists N. intros n Ln.
    specialize (HN n Ln). specialize (T n). specialize (kept l I).
    change (fun p => quotient (visits_of c p) * amount l p) with (fun p => x p * amount l p) in T.
    lra. }
  split; [exact wf|]. exists (flowing m hs c). split; [exact (flowing_valid m hs c H Fl)|].
  destruct (feasible c) eqn:Fs.
  - apply Z.eqb_eq, Qnum_zero in Fe. split; [|split].
    + intros l I eps e0. destruct (keeping l I eps e0) as [N HN]. exists N. intros n Ln.
      specialize (HN n Ln). lra.
    + intros eps e0. destruct (flow_total m hs c M H Fl (r m)) as (la & D & La & D0 & T).
      { intros p Ip E. now apply (end_pair m hs c M H p Ip E). }
      destruct (pow_vanishes la D eps La D0 e0) as [N HN]. exists N. intros n Ln.
      specialize (HN n Ln). specialize (T n).
      change (visits_earn m c) with (sumQ (fun p => x p * r m p) (pairs m)).
      change (fun p => quotient (visits_of c p) * r m p) with (fun p => x p * r m p) in T. lra.
    + intros pi va K eps e0. set (small := eps / (2 * (SP + 1))).
      assert (s0 : 0 < small) by (unfold small; apply Qlt_shift_div_l; lra).
      assert (half : 0 < eps * (1 # 2)) by lra.
      destruct (eventually_all (fun l n => least l - 0 - small <= total m (amount l) pi n)
        (limits c)) as [N1 H1]; [intros l I; now apply (K l I)|].
      destruct (pow_vanishes lam C (eps * (1 # 2)) L C0 half) as [N2 H2].
      exists (N1 + N2)%nat. intros n Ln. specialize (H2 n ltac:(lia)).
      specialize (parted pi n va).
      assert (Pa : PL - small * SP <= sumQ (fun l => price l * total m (amount l) pi n)
        (limits c)).
      { apply paid. intros l I. specialize (H1 n ltac:(lia) l I). cbv beta in H1. lra. }
      assert (Q : small * SP <= eps * (1 # 2)).
      { assert (E : small * (2 * (SP + 1)) == eps) by (unfold small; field; lra). nra. }
      change (visits_earn m c) with (sumQ (fun p => x p * r m p) (pairs m)).
      assert (B : total m base pi n == total m (r m) pi n) by (apply total_ext; reflexivity).
      lra.
  - apply andb_true_iff in Fe. destruct Fe as [Ns One]. apply negb_true_iff, Z.eqb_neq in Ns.
    assert (SP1 : SP == 1).
    { apply Z.eqb_eq in One.
      destruct (sum_of_ok ((-1, (1, 1)) :: map (fun l => (1, ratio_of (price l))) (limits c))%Z)
        as [S E].
      { intros t [<-|I]; [reflexivity|]. apply in_map_iff in I. destruct I as (l & <- & _).
        apply ratio_of_ok. }
      pose proof (zero_quotient _ S One) as Z0. rewrite E in Z0. cbn [sumQ fst snd] in Z0.
      rewrite sumQ_map in Z0. cbn [fst snd] in Z0.
      rewrite (sumQ_ext _ price) in Z0.
      2: { intros l _. destruct (ratio_of_ok (price l)) as [_ ->].
      change (inject_Z 1) with 1. ring. }
      change (inject_Z (-1)) with (-1) in Z0. change (quotient (1, 1)%Z) with (1 / 1) in Z0.
      unfold SP. assert (1 / 1 == 1) by reflexivity. lra. }
    assert (s0 : 0 < shift c).
    { destruct (Qlt_le_dec 0 (shift c)) as [G|G]; [exact G|]. exfalso. apply Ns, Qnum_zero. lra. }
    split; [exact s0|]. split; [exact keeping|]. intros pi t va K.
    destruct (Qlt_le_dec t (shift c)) as [B|B]; [exfalso|exact B].
    set (eps := (shift c - t) * (1 # 4)). assert (e0 : 0 < eps) by (unfold eps; lra).
    destruct (eventually_all (fun l n => least l - t - eps <= total m (amount l) pi n)
      (limits c)) as [N1 H1]; [intros l I; now apply (K l I)|].
    destruct (pow_vanishes lam C eps L C0 e0) as [N2 H2].
    specialize (H1 (N1 + N2)%nat ltac:(lia)). specialize (H2 (N1 + N2)%nat ltac:(lia)).
    specialize (parted pi (N1 + N2)%nat va).
    assert (Pa : PL - (t + eps) * SP <=
      sumQ (fun l => price l * total m (amount l) pi (N1 + N2)%nat) (limits c)).
    { apply paid. intros l I. specialize (H1 l I). cbv beta in H1. lra. }
    assert (Z0 : total m base pi (N1 + N2)%nat == 0).
    { unfold total, base. apply sumQ_zero. intros sq _. rewrite run_zero. ring. }
    rewrite SP1 in Pa. unfold eps in *. lra.
Qed.
