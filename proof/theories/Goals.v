(* Goals: what a total is worth where a run that never reaches the goal is worth +∞, or -∞.

   States are finite, of -∞ (`never`), or of +∞ (`above`). A rank that each pair may lower gives a
   potential, as in Bellman.v: the goal is reached, and the values hold as there. An order that a
   pair may lower, or keeps, bounds from below a probability that is never lost: of missing the
   goal, or of going round for a gain. *)
From Coq Require Import ZArith QArith Qreduction Qabs Qround Qfield List Bool Lqa Lia Arith.
From MDP Require Import Spec Checker Arith Integers Bellman.
Import ListNotations.
Open Scope Q_scope.

Lemma bound_pairs (f : pair -> Q) l : exists R, 0 <= R /\ forall p, In p l -> - R <= f p <= R.
Proof.
  induction l as [|a l [C [C0 H]]]; [exists 0; split; [lra|easy]|].
  exists (C + Qabs (f a)). pose proof (Qabs_nonneg (f a)).
  pose proof (Qle_Qabs (f a)). pose proof (Qle_Qabs (- f a)). rewrite Qabs_opp in H2.
  split; [lra|]. intros s [<-|I]; [lra|]. specialize (H s I). lra.
Qed.
Lemma least_gain (f : pair -> Q) l : exists eta, 0 < eta /\ forall p, In p l -> 0 < f p -> eta <=
  f p.
Proof.
  induction l as [|a l [e [e0 H]]]; [exists 1; split; [lra|easy]|].
  destruct (Qlt_le_dec 0 (f a)) as [L|L].
  - destruct (Qlt_le_dec (f a) e) as [L'|L']; [exists (f a)|exists e]; (split; [assumption|]);
      intros p [<-|I] P; try lra; specialize (H p I P); lra.
  - exists e. split; [exact e0|]. intros p [<-|I] P; [lra|]. now apply H.
Qed.
Lemma all_or {A} (P : A -> Prop) (Q : Prop) l : (forall x, In x l -> P x \/ Q) -> (forall x,
  In x l -> P x) \/ Q.
Proof.
  induction l as [|a l IH]; intro H; [left; easy|].
  destruct (H a (or_introl eq_refl)) as [Pa|]; [|now right].
  destruct IH as [F|]; [intros; apply H; now right| |now right]. left. intros x [<-|I]; auto.
Qed.
Lemma mean_one m p f o : row_ok m p -> (forall o, In o (outcomes p) -> 0 <= f (next o)) ->
  In o (outcomes p) ->
  prob p o * f (next o) <= mean p f.
Proof.
  intros R N I. apply (sumQ_one (fun o => prob p o * f (next o))); [|exact I]. intros y Iy.
  pose proof (prob_pos m p R y Iy). specialize (N y Iy). nra.
Qed.

(* The inductions over steps once more, for a policy that depends on the time, and N steps. *)
Section Timed.
  Variables (m : model) (N : nat) (D : nat -> pair -> Prop) (A : Z -> Prop) (rew : pair -> Q)
    (f : Z -> Q)
    (X : nat -> Z -> Q) (pi : policy).
  Hypotheses (wf : well_formed m).
  Hypothesis pl : forall h s, is_state m s ->
    (forall p q, In (p, q) (pi h s) -> In p (pairs m) /\ state p = s /\ 0 <= q /\ D (length h) p)
      /\
    sumQ snd (pi h s) == 1.
  Hypothesis closed : forall t p, In p (pairs m) -> D t p -> A (state p) -> forall o,
    In o (outcomes p) -> A (next o).
  Lemma timed_lower :
    (forall s, is_state m s -> A s -> X N s <= f s) ->
    (forall t p, (t < N)%nat -> In p (pairs m) -> D t p -> A (state p) -> X t (state p) <=
      rew p + 1 * mean p (X (S t))) ->
    forall n h s, (length h + n = N)%nat -> is_state m s -> A s -> X (length h) s <=
      run rew 1 f pi n h s.
  Proof.
    intros base step n. induction n; intros h s L St As.
    - rewrite Nat.add_0_r in L. rewrite L. now apply base.
    - cbn [run]. destruct (pl h s St) as [H S1].
      apply (mix_ge (fun p => rew p + 1 * mean p (run rew 1 f pi n ((s, action p) :: h))));
        [|exact S1].
      intros p q I. destruct (H p q I) as (Ip & <- & q0 & Dp). split; [exact q0|].
      apply Qle_trans with (1 := step (length h) p ltac:(lia) Ip Dp As).
      pose proof (wf_rows m wf p Ip) as R.
      assert (mean p (X (S (length h))) <= mean p (run rew 1 f pi n ((state p, action p) :: h)));
        [|lra].
      apply (mean_le m p R). intros o Io. apply (IHn ((state p, action p) :: h)).
      + cbn [length]. lia.
      + destruct R as (_ & _ & _ & R). now apply R.
      + now apply (closed (length h) p).
  Qed.
  Lemma timed_upper :
    (forall s, is_state m s -> A s -> f s <= X N s) ->
    (forall t p, (t < N)%nat -> In p (pairs m) -> D t p -> A (state p) ->
      rew p + 1 * mean p (X (S t)) <= X t (state p)) ->
    forall n h s, (length h + n = N)%nat -> is_state m s -> A s -> run rew 1 f pi n h s <=
      X (length h) s.
  Proof.
    intros base step n. induction n; intros h s L St As.
    - rewrite Nat.add_0_r in L. rewrite L. now apply base.
    - cbn [run]. destruct (pl h s St) as [H S1].
      apply (mix_le (fun p => rew p + 1 * mean p (run rew 1 f pi n ((s, action p) :: h))));
        [|exact S1].
      intros p q I. destruct (H p q I) as (Ip & <- & q0 & Dp). split; [exact q0|].
      apply Qle_trans with (2 := step (length h) p ltac:(lia) Ip Dp As).
      pose proof (wf_rows m wf p Ip) as R.
      assert (mean p (run rew 1 f pi n ((state p, action p) :: h)) <= mean p (X (S (length h))));
        [|lra].
      apply (mean_le m p R). intros o Io. apply (IHn ((state p, action p) :: h)).
      + cbn [length]. lia.
      + destruct R as (_ & _ & _ & R). now apply R.
      + now apply (closed (length h) p).
  Qed.
End Timed.

(* states that keep to themselves, or lead to a lower order:
  a probability that is not missing_is_least *)
Section Orders.
  Variables (m : model) (p0 : Q) (order : Z -> Z) (S : Z -> bool).
  Hypotheses (wf : well_formed m) (P0 : 0 < p0 <= 1)
    (least : forall p o, In p (pairs m) -> In o (outcomes p) -> p0 <= prob p o)
    (order0 : forall s, is_state m s -> (0 <= order s)%Z).
  Definition phi (s : Z) : Q := if S s then pow p0 (Z.to_nat (order s)) else 0.
  Definition keeps (p : pair) : Prop :=
    (forall o, In o (outcomes p) -> S (next o) = true /\ order (next o) = order (state p)) \/
    (exists o, In o (outcomes p) /\ (order (next o) < order (state p))%Z /\ S (next o) = true).
  Lemma phi_range s : 0 <= phi s <= 1.
  Proof. unfold phi. destruct (S s); [|lra]. split; [apply pow_nneg; lra|apply pow_le1; lra]. Qed.
  Lemma phi_in s : S s = true -> 0 < phi s.
  Proof. intro H. unfold phi. rewrite H. apply pow_pos. lra. Qed.
  Lemma phi_step p : In p (pairs m) -> S (state p) = true -> keeps p -> phi (state p) <=
    mean p phi.
  Proof.
    intros I Sp [K|(o & Io & Lo & So)]; pose proof (wf_rows m wf p I) as R.
    - rewrite (mean_ext p phi (fun _ => phi (state p))).
      + rewrite (mean_const m p R). lra.
      + intros o Io. destruct (K o Io) as [So Eo]. unfold phi. rewrite So, Sp, Eo. reflexivity.
    - pose proof (mean_one m p phi o R ltac:(intros; apply phi_range) Io) as X.
      unfold phi at 1 in X. rewrite So in X.
      pose proof R as (_ & _ & _ & Ro). destruct (Ro o Io) as [_ St]. pose proof (order0 _ St).
      unfold phi at 1. rewrite Sp. apply Qle_trans with (2 := X).
      set (k := Z.to_nat (order (next o))) in *.
      assert (P01 : 0 <= p0 <= 1) by lra.
      pose proof (pow_anti p0 (Datatypes.S k) (Z.to_nat (order (state p))) P01 ltac:(unfold k;
        lia)) as Y.
      cbn [pow] in Y. pose proof (least p o I Io). pose proof (pow_nneg p0 k ltac:(lra)). nra.
  Qed.
  Lemma phi_zero p : In p (pairs m) -> S (state p) = false -> phi (state p) <= mean p phi.
  Proof.
    intros I Sp. unfold phi at 1. rewrite Sp. apply sumQ_pos. intros o Io.
    pose proof (prob_pos m p (wf_rows m wf p I) o Io). pose proof (phi_range (next o)). nra.
  Qed.
  Lemma phi_run (D : pair -> Prop) pi f : plays m D pi ->
    (forall s, 0 <= f s) -> (forall s, is_state m s -> S s = true -> 1 <= f s) ->
    (forall p, In p (pairs m) -> D p -> S (state p) = true -> keeps p) ->
    forall n h s, is_state m s -> phi s <= run (fun _ => 0) 1 f pi n h s.
  Proof.
    intros pl f0 f1 K n h s Ss.
    apply (run_lower m D (fun _ => True) (fun _ => 0) 1 f (fun _ => phi) pi wf); auto; try lra.
    - intros t St _. destruct (S t) eqn:e.
      + specialize (f1 t St e). pose proof (phi_range t). lra.
      + unfold phi. rewrite e. apply f0.
    - intros _ p I Dp _. assert (phi (state p) <= mean p phi); [|lra].
      destruct (S (state p)) eqn:e.
      + apply phi_step; auto.
      + now apply phi_zero.
  Qed.
End Orders.

Section Goal.
  Variables (m : model) (hs : hints) (a out : Z -> Z) (h : level) (rank order infinite : Z -> Z)
    (g : Z -> bool).
  Hypotheses (M : model_right m hs = true) (P : policy_right m a = true) (Gl : goal m = Some g)
    (H : reaching m h rank order infinite g a out = true).
  Let Hv := value h.
  Let fin := finite infinite.
  Let nev := never infinite.
  Let abv := above infinite.
  Let missed_in := chance (fun s => negb (g s)).
  Let ind (s : Z) : Q := if negb (g s) then 1 else 0.

  Lemma g_wf : well_formed m. Proof. now apply (model_right_ok m hs). Qed.
  Lemma g_level : level_pos m h.
  Proof.
    pose proof H as X. unfold reaching in X. rewrite !andb_true_iff in X.
    apply (level_right_ok m a _ P). tauto.
  Qed.
  Lemma g_rank s : is_state m s -> (0 <= rank s)%Z.
  Proof.
    pose proof H as X. unfold reaching in X. rewrite !andb_true_iff in X.
    apply (rank_right_ok m a _ P). tauto.
  Qed.
  Lemma g_order s : is_state m s -> (0 <= order s)%Z.
  Proof.
    pose proof H as X. unfold reaching in X. rewrite !andb_true_iff in X.
    apply (rank_right_ok m a _ P). tauto.
  Qed.
  Lemma g_pair p : In p (pairs m) -> reaching_pair m h rank order infinite g a p = true.
  Proof.
    pose proof H as X. unfold reaching in X. rewrite !andb_true_iff in X.
    destruct X as [[_ X] _]. rewrite forallb_forall in X. apply X.
  Qed.
  Lemma next_state p o : In p (pairs m) -> In o (outcomes p) -> is_state m (next o).
  Proof. intros I Io. pose proof (wf_rows m g_wf p I) as (_ & _ & _ & R). now apply R. Qed.
  Lemma all_next_ok p f : all_next p f = true <-> forall o, In o (outcomes p) -> f (next o)
    = true.
  Proof. unfold all_next. rewrite forallb_forall. reflexivity. Qed.
  Lemma excl s : (fin s = true -> nev s = false /\ abv s = false) /\ (abv s = true ->
    nev s = false /\ fin s = false)
    /\ (nev s = true -> fin s = false /\ abv s = false).
  Proof. unfold fin, nev, abv, finite, never, above. rewrite !Z.eqb_eq, !Z.eqb_neq. lia. Qed.

  Lemma goal_state s : is_state m s -> g s = true -> fin s = true /\ Hv s == 0.
  Proof.
    intros Ss G. destruct (policy_pair m a s P Ss) as (p & I & <- & _).
    pose proof (g_pair p I) as X.
    unfold reaching_pair in X. rewrite G in X. unfold of_goal in X. split_and. reflect.
    split; [assumption|].
    unfold Hv, value. rewrite H1. pose proof (g_level _ Ss) as L. apply inject_pos in L. field.
    lra.
  Qed.
  Lemma goal_pair p : In p (pairs m) -> g (state p) = true -> r m p == 0 /\ forall o,
    In o (outcomes p) -> next o = state p.
  Proof.
    intros I G. pose proof (wf_rows m g_wf p I) as (Ss & _).
    destruct (wf_goal m g_wf g Gl) as [_ F]. destruct (F _ Ss G p I eq_refl) as [Mn St].
    split; [|exact St].
    unfold r. destruct (maximise m); lra.
  Qed.
  Lemma gain_at p : In p (pairs m) ->
    ((surplus 1 (earned m p) p h <= 0)%Z -> surplus_of 1 (r m p) p Hv <= 0) /\
    ((surplus 1 (earned m p) p h = 0)%Z -> surplus_of 1 (r m p) p Hv == 0) /\
    ((0 < surplus 1 (earned m p) p h)%Z -> 0 < surplus_of 1 (r m p) p Hv).
  Proof.
    intro I. pose proof (wf_rows m g_wf p I) as R.
    destruct (earned_ok m p (proj1 (proj2 R))) as [r0 rq].
    split; [|split]; intro X.
    - exact (surplus_le m 1 _ (earned m p) p h R g_level r0 rq X).
    - exact (proj1 (surplus_eq m 1 _ (earned m p) p h R g_level r0 rq) X).
    - exact (surplus_gt m 1 _ (earned m p) p h R g_level r0 rq X).
  Qed.

  (* ---- finite states *)
  Lemma fin_pair p : In p (pairs m) -> fin (state p) = true -> g (state p) = false ->
    (safe infinite p = true -> (forall o, In o (outcomes p) -> fin (next o) = true) /\
      surplus_of 1 (r m p) p Hv <= 0) /\
    (taken a p = true -> safe infinite p = true /\ surplus_of 1 (r m p) p Hv == 0) /\
    ((missing_is_least m = true -> taken a p = true) -> exists o, In o (outcomes p) /\
      (rank (next o) < rank (state p))%Z).
  Proof.
    intros I F G. pose proof (g_pair p I) as X. destruct (excl (state p)) as [Ex _].
    destruct (Ex F) as [En Ea].
    unfold reaching_pair in X. fold nev abv in X. rewrite G, En, Ea in X. cbn [andb] in X.
    unfold of_finite in X.
    fold fin in X. rewrite !andb_true_iff in X. destruct X as [[[[_ S] D0] T] Rk].
    apply Z.leb_le in D0.
    destruct (gain_at p I) as (g1 & g2 & _). split; [|split].
    - intro Sf. rewrite Sf in S. cbn [negb orb] in S. rewrite S in D0. rewrite all_next_ok in S.
      split; [exact S|].
      now apply g1.
    - intro Tk. rewrite Tk in T. cbn [negb orb] in T. apply Z.eqb_eq in T.
      destruct (all_next p fin) eqn:An; [|discriminate]. rewrite all_next_ok in An.
      split; [|now apply g2].
      unfold safe. apply all_next_ok. intros o Io. specialize (An o Io).
      destruct (excl (next o)) as [Eo _].
      destruct (Eo An) as [X _]. unfold nev in X. now rewrite X.
    - intro L. assert (L' : missing_is_least m && negb (taken a p) = false).
      { destruct (missing_is_least m); [|reflexivity]. rewrite L; reflexivity. }
      rewrite L' in Rk. cbn [orb] in Rk. apply falls_ok in Rk. destruct Rk as (o & ? & ? & _).
      eauto.
  Qed.
  Lemma no_never : missing_is_least m = false -> forall s, is_state m s -> nev s = false.
  Proof.
    intros L s Ss. destruct (nev s) eqn:En; [|reflexivity]. exfalso.
    destruct (policy_pair m a s P Ss) as (p & I & <- & _). pose proof (g_pair p I) as X.
    destruct (excl (state p)) as [_ [_ Ex]]. destruct (Ex En) as [Ef Ea].
    unfold reaching_pair in X. fold nev abv in X. rewrite L, En, Ea in X. cbn [andb] in X.
    destruct (g (state p)) eqn:G.
    - destruct (goal_state _ Ss G) as [Y _]. congruence.
    - unfold of_finite in X. fold fin in X. rewrite Ef in X. discriminate.
  Qed.
  Lemma one_of s : is_state m s -> fin s = true \/ nev s = true \/ abv s = true.
  Proof.
    intro Ss. destruct (policy_pair m a s P Ss) as (p & I & <- & _). pose proof (g_pair p I) as X.
    unfold reaching_pair in X. fold nev abv in X.
    destruct (g (state p)) eqn:G; [left; now apply goal_state|].
    destruct (abv (state p)) eqn:Ea; [auto|]. destruct (nev (state p)) eqn:En; [auto|].
    cbn [andb] in X.
    unfold of_finite in X. rewrite !andb_true_iff in X. left. tauto.
  Qed.

  Definition arriving_pair (p : pair) : Prop := missing_is_least m = true -> taken a p = true.
  Lemma arriving_stationary : plays m arriving_pair (stationary m a).
  Proof.
    intros hy s Ss. destruct (stationary_plays m a P hy s Ss) as [X Y]. split; [|exact Y].
    intros p q I. destruct (X p q I) as (? & ? & ? & ?). unfold arriving_pair. auto.
  Qed.
  Lemma fin_safe p : In p (pairs m) -> fin (state p) = true -> g (state p) = false ->
    arriving_pair p -> safe infinite p = true.
  Proof.
    intros I F G A. destruct (missing_is_least m) eqn:L.
    - destruct (fin_pair p I F G) as (_ & X & _). apply X. now apply A.
    - unfold safe. apply all_next_ok. intros o Io.
      pose proof (no_never L _ (next_state p o I Io)) as X.
      unfold nev in X. now rewrite X.
  Qed.
  Lemma fin_closed p : In p (pairs m) -> arriving_pair p -> fin (state p) = true ->
    forall o, In o (outcomes p) -> fin (next o) = true.
  Proof.
    intros I A F. destruct (g (state p)) eqn:G.
    - destruct (goal_pair p I G) as [_ X]. intros o Io. now rewrite (X o Io).
    - destruct (fin_pair p I F G) as (X & _). apply X. now apply fin_safe.
  Qed.
  Lemma fin_change p : In p (pairs m) -> fin (state p) = true -> safe infinite p = true ->
    surplus_of 1 (r m p) p Hv <= 0.
  Proof.
    intros I F S. destruct (g (state p)) eqn:G; [|now apply fin_pair].
    destruct (goal_pair p I G) as [r0 X]. unfold surplus_of. rewrite r0.
    rewrite (mean_ext p Hv (fun _ => Hv (state p))) by (intros o Io; rewrite (X o Io);
      reflexivity).
    rewrite (mean_const m p (wf_rows m g_wf p I)). lra.
  Qed.
  Lemma fin_equal p : In p (pairs m) -> fin (state p) = true -> taken a p = true ->
    surplus_of 1 (r m p) p Hv == 0.
  Proof.
    intros I F T. destruct (g (state p)) eqn:G; [|now apply fin_pair].
    destruct (goal_pair p I G) as [r0 X]. unfold surplus_of. rewrite r0.
    rewrite (mean_ext p Hv (fun _ => Hv (state p))) by (intros o Io; rewrite (X o Io);
      reflexivity).
    rewrite (mean_const m p (wf_rows m g_wf p I)). lra.
  Qed.
  Lemma goal_safe p : In p (pairs m) -> g (state p) = true -> safe infinite p = true.
  Proof.
    intros I G. destruct (goal_pair p I G) as [_ X]. unfold safe. apply all_next_ok. intros o Io.
    rewrite (X o Io).
    destruct (goal_state (state p)) as [F _]; [apply (wf_rows m g_wf p I)|exact G|].
    destruct (excl (state p)) as [Ex _]. destruct (Ex F) as [En _]. unfold nev in En.
    now rewrite En.
  Qed.

  (* From finite states the policy arrives and earns h; where missing is worth the most,
    every policy
     arrives and none earns more. *)
  Theorem goal_finite : exists lam C, 0 <= lam < 1 /\ 0 <= C /\ forall s, is_state m s ->
    fin s = true ->
    (forall pi n hy, plays m arriving_pair pi -> earns m 1 pi n hy s <= Hv s + pow lam n * C /\
      missed_in pi n hy s <= pow lam n * C) /\
    (forall n hy, Hv s - pow lam n * C <= earns m 1 (stationary m a) n hy s).
  Proof.
    destruct (rank_potential m g rank g_wf g_rank) as (lam & w & L & WW & step).
    destruct (bounded m Hv) as (C & C0 & B). exists lam, (2 * (C + 1)). split; [exact L|].
    split; [lra|].
    assert (shrink : forall p, In p (pairs m) -> arriving_pair p -> fin (state p) = true ->
      1 * mean p w <= lam * w (state p)).
    { intros p I A F. rewrite Qmult_1_l. apply (step p I). destruct (g (state p)) eqn:G.
      - intros o Io. destruct (goal_pair p I G) as [_ X]. now rewrite (X o Io).
      - destruct (fin_pair p I F G) as (_ & _ & X). now apply X. }
    intros s Ss Fs.
    assert (small : forall n, pow lam n * (C + 1) * w s <= pow lam n * (2 * (C + 1))).
    { intro n. assert (0 <= pow lam n) by (apply pow_nneg; lra). pose proof (w_low w _ WW s).
      pose proof (w_high w _ WW s).
      assert (0 <= pow lam n * (C + 1)) by nra. nra. }
    split.
    - intros pi n hy pl. split.
      + apply Qle_trans with (Hv s + pow lam n * (C + 1) * w s); [|specialize (small n); lra].
        apply (weighted_upper m arriving_pair (fun s => fin s = true) (r m) 1 lam (C + 1)
          (fun _ => 0) w Hv pi);
          auto; try lra.
        * exact g_wf.
        * apply fin_closed.
        * intros p I A F. apply fin_change; auto.
          destruct (g (state p)) eqn:G; [now apply goal_safe|now apply fin_safe].
        * intros t St Ft. destruct (g t) eqn:G.
          -- destruct (goal_state t St G) as [_ X]. rewrite X, (w_in w _ WW t G). lra.
          -- pose proof (w_out w _ WW t G). specialize (B t St). nra.
      + apply Qle_trans with (0 + pow lam n * (C + 1) * w s); [|specialize (small n); lra].
        apply (weighted_upper m arriving_pair (fun s => fin s = true) (fun _ => 0) 1 lam (C + 1)
          ind w (fun _ => 0) pi);
          auto; try lra.
        * exact g_wf.
        * apply fin_closed.
        * intros p I A F. unfold surplus_of. rewrite (mean_const m p (wf_rows m g_wf p I)). lra.
        * intros t St Ft. unfold ind. pose proof (w_low w _ WW t).
          destruct (g t) eqn:G; cbn [negb]; [nra|].
          pose proof (w_out w _ WW t G). nra.
    - intros n hy.
      apply Qle_trans with (Hv s - pow lam n * (C + 1) * w s); [specialize (small n); lra|].
      apply (weighted_lower m (fun p => taken a p = true) (fun s => fin s = true) (r m)
        1 lam (C + 1) (fun _ => 0) w Hv);
        auto; try lra.
      + exact g_wf.
      + now apply stationary_plays.
      + intros p I T. apply fin_closed; [assumption|]. unfold arriving_pair. auto.
      + intros p I T F. apply shrink; auto. unfold arriving_pair. auto.
      + intros p I T F. rewrite (fin_equal p I F T). lra.
      + intros t St Ft. destruct (g t) eqn:G.
        * destruct (goal_state t St G) as [_ X]. rewrite X, (w_in w _ WW t G). lra.
        * pose proof (w_out w _ WW t G). specialize (B t St). nra.
  Qed.

  Lemma not_goal s : is_state m s -> nev s = true \/ abv s = true -> g s = false.
  Proof.
    intros Ss X. destruct (g s) eqn:G; [|reflexivity]. destruct (goal_state s Ss G) as [F _].
    destruct (excl s) as (Ex & _). destruct (Ex F). destruct X; congruence.
  Qed.
  Lemma ind0 s : 0 <= ind s. Proof. unfold ind. destruct (negb (g s)); lra. Qed.
  Lemma ind1 s : g s = false -> ind s == 1. Proof. intro G. unfold ind. rewrite G. reflexivity.
  Qed.

  (* From states of -∞ every policy misses the goal with a probability that does not
    vanish *)
  Theorem goal_never : missing_is_least m = true -> exists de, 0 < de /\ forall s,
    is_state m s -> nev s = true ->
    forall pi n hy, valid m pi -> de <= missed_in pi n hy s.
  Proof.
    intro L. destruct (least_prob m g_wf) as (p0 & P0 & least).
    destruct (highest_rank m order) as [K HK].
    exists (pow p0 K). split; [apply pow_pos; lra|]. intros s Ss Ns pi n hy V.
    apply Qle_trans with (phi p0 order nev s).
    { unfold phi. rewrite Ns. apply pow_anti; [lra|auto]. }
    apply (phi_run m p0 order nev g_wf P0 least g_order (fun _ => True)); auto.
    - exact ind0.
    - intros t St Nt. cbv beta. rewrite (not_goal t St); [cbn [negb]; lra|auto].
    - intros p I _ Np. pose proof (g_pair p I) as X. unfold reaching_pair in X. fold nev in X.
      assert (Sp : is_state m (state p)) by apply (wf_rows m g_wf p I).
      rewrite (not_goal _ Sp (or_introl Np)), Np, L in X. cbn [andb] in X. unfold of_never in X.
      fold nev in X.
      apply orb_true_iff in X. destruct X as [X|X].
      + left. intros o Io. rewrite all_next_ok in X. specialize (X o Io). cbv beta in X.
        split_and. reflect. auto.
      + right. apply falls_ok in X. destruct X as (o & ? & ? & ?). eauto.
  Qed.

  (* Where missing is worth the most: from states of +∞ the policy misses it so *)
  Theorem goal_above : missing_is_least m = false -> exists de, 0 < de /\ forall s,
    is_state m s -> abv s = true ->
    forall n hy, de <= missed_in (stationary m a) n hy s.
  Proof.
    intro L. destruct (least_prob m g_wf) as (p0 & P0 & least).
    destruct (highest_rank m order) as [K HK].
    exists (pow p0 K). split; [apply pow_pos; lra|]. intros s Ss As n hy.
    apply Qle_trans with (phi p0 order abv s).
    { unfold phi. rewrite As. apply pow_anti; [lra|auto]. }
    apply (phi_run m p0 order abv g_wf P0 least g_order (fun p => taken a p = true)); auto.
    - now apply stationary_plays.
    - exact ind0.
    - intros t St Nt. cbv beta. rewrite (not_goal t St); [cbn [negb]; lra|auto].
    - intros p I T Ap. pose proof (g_pair p I) as X. unfold reaching_pair in X. fold nev abv in X.
      assert (Sp : is_state m (state p)) by apply (wf_rows m g_wf p I).
      rewrite (not_goal _ Sp (or_intror Ap)), L, andb_false_r, Ap, T in X. cbn [negb orb] in X.
      unfold of_above, goes_round in X. fold abv in X. apply andb_true_iff in X.
      destruct X as [_ X].
      apply orb_true_iff in X. destruct X as [X|X].
      + left. rewrite !andb_true_iff in X. destruct X as [[X O] _]. rewrite all_next_ok in X.
        intros o Io.
        specialize (X o Io). cbv beta in X. split_and. reflect. split; [assumption|congruence].
      + right. apply falls_ok in X. destruct X as (o & ? & ? & ?). eauto.
  Qed.

  (* Where missing is worth the least: a policy from a finite state misses the goal with a
     probability that does not vanish, or earns no more than h and its part of the runs that have
     not arrived. *)
  Definition misses_from (pi : policy) (hy : history) (s : Z) : Prop :=
    exists de N, 0 < de /\ forall n, (N <= n)%nat -> de <= missed_in pi n hy s.
  Lemma missed_nneg pi n hy s : valid m pi -> is_state m s -> 0 <= missed_in pi n hy s.
  Proof.
    intros V Ss. apply (run_lower m (fun _ => True) (fun _ => True) (fun _ => 0)
      1 ind (fun _ _ => 0) pi g_wf); auto; try lra.
    - intros. apply ind0.
    - intros k p I _ _. rewrite (mean_const m p (wf_rows m g_wf p I)). lra.
  Qed.
  Lemma may_miss_step pi hy s p q o : valid m pi -> is_state m s -> In (p, q) (pi hy s) ->
    0 < q -> In o (outcomes p) ->
    misses_from pi ((s, action p) :: hy) (next o) -> misses_from pi hy s.
  Proof.
    intros V Ss I q0 Io (de & N & de0 & Mi). destruct (V hy s Ss) as [Pl S1].
    destruct (Pl p q I) as (Ip & <- & _ & _).
    pose proof (wf_rows m g_wf p Ip) as R. pose proof (prob_pos m p R o Io) as po.
    exists (q * (prob p o * de)), (S N).
    split; [apply Qmult_lt_0_compat; [assumption|]; now apply Qmult_lt_0_compat|].
    intros n Ln. destruct n as [|n]; [lia|]. unfold missed_in, chance. cbn [run].
    set (v := fun c : pair * Q => _).
    assert (v0 : forall c, In c (pi hy (state p)) -> 0 <= v c).
    { intros [p' q'] I'. destruct (Pl p' q' I') as (Ip' & Es & q0' & _). unfold v. cbn [fst snd].
      assert (0 <= mean p' (run (fun _ => 0) 1 (fun s => if negb (g s) then 1 else 0)
        pi n ((state p, action p') :: hy))); [|nra].
      apply sumQ_pos. intros y Iy. pose proof (prob_pos m p' (wf_rows m g_wf p' Ip') y Iy).
      assert (0 <= run (fun _ => 0) 1 (fun s => if negb (g s) then 1 else 0) pi n ((state p,
        action p') :: hy) (next y)); [|nra].
      apply (missed_nneg pi n); auto. now apply (next_state p'). }
    apply Qle_trans with (2 := sumQ_one v _ (p, q) v0 I). unfold v. cbn [fst snd].
    assert (X : prob p o * de <= mean p (run (fun _ => 0) 1 (fun s => if negb (g s)
      then 1 else 0) pi n ((state p, action p) :: hy))); [|nra].
    apply Qle_trans with (2 := mean_one m p _ o R ltac:(intros; apply (missed_nneg pi n); auto;
      now apply (next_state p)) Io).
    apply Qmult_le_l; [exact po|]. apply (Mi n). lia.
  Qed.
  Theorem goal_upper : missing_is_least m = true -> exists C, 0 <= C /\ forall pi, valid m pi ->
    forall n hy s,
    is_state m s -> fin s = true -> misses_from pi hy s \/ earns m 1 pi n hy s <=
      Hv s + C * missed_in pi n hy s.
  Proof.
    intro L. destruct (bounded m Hv) as (C & C0 & B). destruct (goal_never L) as (de & de0 & Nev).
    exists C. split; [exact C0|]. intros pi V. induction n; intros hy s Ss Fs.
    - right. unfold earns, missed_in, chance. cbn [run]. specialize (B s Ss).
      destruct (g s) eqn:G; cbn [negb]; [|lra].
      destruct (goal_state s Ss G) as [_ X]. lra.
    - destruct (V hy s Ss) as [Pl S1].
      assert (X : (forall c, In c (pi hy s) -> snd c * (r m (fst c) + 1 * mean (fst c)
        (earns m 1 pi n ((s, action (fst c)) :: hy)))
          <= snd c * Hv s + C * (snd c * (0 + 1 * mean (fst c) (missed_in pi n ((s,
            action (fst c)) :: hy))))) \/ misses_from pi hy s).
      { apply all_or. intros [p q] I. cbn [fst snd]. destruct (Pl p q I) as (Ip & Es & q0 & _).
        destruct (Qlt_le_dec 0 q) as [qp|qz].
        - pose proof (wf_rows m g_wf p Ip) as R.
          assert (Y : (forall o, In o (outcomes p) -> fin (next o) = true /\
              earns m 1 pi n ((s, action p) :: hy) (next o) <= Hv (next o)
                + C * missed_in pi n ((s, action p) :: hy) (next o))
              \/ misses_from pi hy s).
          { destruct (safe infinite p) eqn:Sf.
            - assert (Cl : forall o, In o (outcomes p) -> fin (next o) = true).
              { destruct (g (state p)) eqn:G.
                - destruct (goal_pair p Ip G) as [_ X]. intros o Io. rewrite (X o Io).
                  now rewrite Es.
                - destruct (fin_pair p Ip) as (X & _); auto; [now rewrite Es|]. now apply X. }
              apply all_or. intros o Io.
              destruct (IHn ((s, action p) :: hy) (next o) (next_state p o Ip Io) (Cl o Io))
                as [Bad|Good]; [right|left; auto].
              now apply (may_miss_step pi hy s p q o).
            - right. assert (Ex : exists o, In o (outcomes p) /\ nev (next o) = true).
              { unfold safe, all_next in Sf. clear - Sf.
                induction (outcomes p) as [|o l IH]; [discriminate|].
                cbn [forallb] in Sf. apply andb_false_iff in Sf. destruct Sf as [Sf|Sf].
                - exists o. split; [now left|]. now apply negb_false_iff.
                - destruct (IH Sf) as (y & ? & ?). exists y. split; [now right|assumption]. }
              destruct Ex as (o & Io & No). apply (may_miss_step pi hy s p q o); auto.
              exists de, 0%nat. split; [exact de0|]. intros k _. apply Nev; auto.
              now apply (next_state p). }
          destruct Y as [Y|Y]; [left|now right].
          assert (Sf : safe infinite p = true).
          { unfold safe. apply all_next_ok. intros o Io. destruct (Y o Io) as [F _].
            destruct (excl (next o)) as [Ex _].
            destruct (Ex F) as [En _]. unfold nev in En. now rewrite En. }
          pose proof (fin_change p Ip ltac:(now rewrite Es) Sf) as Ch. unfold surplus_of in Ch.
          rewrite Es in Ch.
          pose (e1 := earns m 1 pi n ((s, action p) :: hy)).
          pose (m1 := missed_in pi n ((s, action p) :: hy)).
          assert (Ee : mean p e1 <= mean p Hv + C * mean p m1).
          { apply Qle_trans with (mean p (fun t => Hv t + C * m1 t)).
            - apply (mean_le m p R). intros o Io. now apply Y.
            - rewrite mean_plus, mean_times. apply Qle_refl. }
          change (q * (r m p + 1 * mean p e1) <= q * Hv s + C * (q * (0 + 1 * mean p m1))).
          assert (Z : r m p + 1 * mean p e1 <= Hv s + C * (0 + 1 * mean p m1)) by lra.
          clearbody e1 m1. clear - Z qp. set (x := r m p + _) in *.
          set (y := 0 + 1 * mean p m1) in *. nra.
        - left. assert (Z : q == 0) by (clear - qz q0; lra).
          set (x := r m p + _). set (y := 0 + 1 * mean p _). clearbody x y. rewrite Z.
          ring_simplify. apply Qle_refl. }
      destruct X as [X|X]; [right|now left].
      unfold earns, missed_in, chance in *. cbn [run]. apply sumQ_le in X.
      apply Qle_trans with (1 := X).
      pose (v := fun c : pair * Q => snd c * (0 + 1 * mean (fst c) (missed_in pi n ((s,
        action (fst c)) :: hy)))).
      change (sumQ (fun c => snd c * Hv s + C * v c) (pi hy s) <= Hv s + C * sumQ v (pi hy s)).
      rewrite sumQ_plus, sumQ_times_right, sumQ_times. clearbody v. rewrite S1. lra.
  Qed.

  (* Where missing is worth the least: from states of +∞ policies that arrive earn as much as one
     likes. They follow the certificate's policy for n0 steps and then go to the goal. *)
  Let b := arriving infinite a out.
  Definition switch (n0 : nat) : policy := fun hy s =>
    if (length hy <? n0)%nat then stationary m a hy s else stationary m b hy s.
  Let A (s : Z) : bool := fin s || abv s.
  Lemma A_next p : In p (pairs m) -> safe infinite p = true -> forall o, In o (outcomes p) ->
    A (next o) = true.
  Proof.
    intros I S o Io. unfold safe in S. rewrite all_next_ok in S. specialize (S o Io).
    cbv beta in S.
    apply negb_true_iff in S. fold nev in S. unfold A.
    destruct (one_of (next o) (next_state p o I Io)) as [X|[X|X]].
    - now rewrite X.
    - unfold nev in *. congruence.
    - rewrite X. apply orb_true_r.
  Qed.
  Lemma above_pair p : In p (pairs m) -> abv (state p) = true -> taken a p = true ->
    of_above m h order infinite p = true.
  Proof.
    intros I Ap T. pose proof (g_pair p I) as X. unfold reaching_pair in X. fold nev abv in X.
    assert (Sp : is_state m (state p)) by apply (wf_rows m g_wf p I).
    destruct (excl (state p)) as (_ & Ex & _).
    destruct (Ex Ap) as [En _]. rewrite (not_goal _ Sp (or_intror Ap)), En, Ap, T in X. exact X.
  Qed.

  Section Lost.
  Hypothesis L : missing_is_least m = true.
  Lemma b_ok : policy_right m b = true /\
    forall p, In p (pairs m) -> abv (state p) = true -> taken b p = true ->
      arrives rank infinite p = true.
  Proof.
    pose proof H as X. unfold reaching in X. rewrite !andb_true_iff in X. destruct X as [_ X].
    rewrite L in X.
    cbn [negb orb] in X. unfold way_right in X. apply andb_true_iff in X. destruct X as [Pb X].
    split; [exact Pb|].
    intros p I Ap T. rewrite forallb_forall in X. specialize (X p I). unfold way_pair in X.
    fold abv b in X.
    rewrite Ap, T in X. exact X.
  Qed.
  Lemma b_fin p : fin (state p) = true -> taken b p = true -> taken a p = true.
  Proof.
    intros F T. destruct (excl (state p)) as [Ex _]. destruct (Ex F) as [_ Ea].
    unfold taken, b, arriving in T.
    fold abv in T. now rewrite Ea in T.
  Qed.
  Lemma A_fin_safe p : In p (pairs m) -> fin (state p) = true -> taken a p = true ->
    safe infinite p = true.
  Proof.
    intros I F T. destruct (g (state p)) eqn:G; [now apply goal_safe|].
    now apply (fin_pair p I F G).
  Qed.
  Lemma A_closed_a p : In p (pairs m) -> taken a p = true -> A (state p) = true ->
    forall o, In o (outcomes p) -> A (next o) = true.
  Proof.
    intros I T As. apply A_next; [exact I|]. unfold A in As. apply orb_true_iff in As.
    destruct As as [F|Ap].
    - now apply A_fin_safe.
    - pose proof (above_pair p I Ap T) as X. unfold of_above, goes_round in X.
      apply andb_true_iff in X. tauto.
  Qed.
  Lemma A_closed_b p : In p (pairs m) -> taken b p = true -> A (state p) = true ->
    forall o, In o (outcomes p) -> A (next o) = true.
  Proof.
    intros I T As. apply A_next; [exact I|]. unfold A in As. apply orb_true_iff in As.
    destruct As as [F|Ap].
    - apply A_fin_safe; auto. now apply b_fin.
    - pose proof (proj2 b_ok p I Ap T) as X. unfold arrives in X. apply andb_true_iff in X. tauto.
  Qed.
  (* A potential that falls on the way to the goal. *)
  Lemma b_weight : exists lam w, 0 <= lam < 1 /\ potential w g /\
    forall p, In p (pairs m) -> taken b p = true -> A (state p) = true -> mean p w <=
      lam * w (state p).
  Proof.
    destruct (highest_rank m rank) as [K HK].
    set (rk := fun s => (rank s + if abv s then Z.of_nat K + 1 else 0)%Z).
    destruct (rank_potential m g rk g_wf) as (lam & w & L1 & WW & step).
    { intros s Ss. pose proof (g_rank s Ss). unfold rk. destruct (abv s); lia. }
    exists lam, w. split; [exact L1|]. split; [exact WW|]. intros p I T As. apply (step p I).
    assert (Sp : is_state m (state p)) by apply (wf_rows m g_wf p I).
    destruct (g (state p)) eqn:G.
    - intros o Io. destruct (goal_pair p I G) as [_ X]. now rewrite (X o Io).
    - unfold A in As. apply orb_true_iff in As. destruct As as [F|Ap].
      + pose proof (b_fin p F T) as Ta. destruct (fin_pair p I F G) as (_ & _ & X).
        destruct (X (fun _ => Ta)) as (o & Io & Lo). exists o. split; [exact Io|].
        assert (Fo : fin (next o) = true) by (apply (fin_closed p I); auto; intro; assumption).
        unfold rk. destruct (excl (next o)) as [E1 _]. destruct (E1 Fo) as [_ E1a].
        destruct (excl (state p)) as [E2 _]. destruct (E2 F) as [_ E2a]. rewrite E1a, E2a. lia.
      + pose proof (proj2 b_ok p I Ap T) as X. unfold arrives in X. apply andb_true_iff in X.
        destruct X as [_ X].
        apply orb_true_iff in X. destruct X as [X|X].
        * unfold some_next in X. apply existsb_exists in X. destruct X as (o & Io & Fo).
          fold fin in Fo.
          exists o. split; [exact Io|]. unfold rk. destruct (excl (next o)) as [E1 _].
          destruct (E1 Fo) as [_ E1a].
          rewrite E1a, Ap. pose proof (HK _ (next_state p o I Io)).
          pose proof (g_rank _ (next_state p o I Io)).
          pose proof (g_rank _ Sp). lia.
        * apply falls_ok in X. destruct X as (o & Io & Lo & Ao). exists o. split; [exact Io|].
          unfold rk. fold abv in Ao. rewrite Ao, Ap. lia.
  Qed.

  Theorem goal_unbounded : forall s, is_state m s -> abv s = true -> forall B, exists pi,
    valid m pi /\
    (exists N, forall n, (N <= n)%nat -> B <= earns m 1 pi n [] s) /\
    (forall eps, 0 < eps -> exists N, forall n, (N <= n)%nat -> missed_in pi n [] s <= eps).
  Proof.
    intros s Ss As B. destruct b_weight as (lam & wb & [l0 l1] & WB & stepb).
    destruct (least_prob m g_wf) as (p0 & P0 & least).
    destruct (bound_pairs (r m) (pairs m)) as (R & R0 & HR).
    destruct (bound_pairs (fun p => surplus_of 1 (r m p) p Hv) (pairs m)) as (R' & R0' & HR').
    destruct (least_gain (fun p => surplus_of 1 (r m p) p Hv) (pairs m)) as (eta & eta0 & Heta).
    destruct (bounded m Hv) as (Ch & Ch0 & BH).
    set (T := fun s => fin s || (abv s && (order s =? 0)%Z)).
    destruct (rank_potential m T order g_wf g_order) as (mu & w & [m0 m1] & WW & step).
    set (f := phi p0 order abv). set (c := R / (1 - lam)).
    assert (c0 : 0 <= c) by (unfold c; apply Qle_shift_div_l; lra).
    assert (cR : c * (1 - lam) == R) by (unfold c; field; lra).
    set (Q := (R' + eta) / (1 - mu)).
    assert (Q0 : 0 <= Q) by (unfold Q; apply Qle_shift_div_l; lra).
    assert (QR : Q * (1 - mu) == R' + eta) by (unfold Q; field; lra).
    set (L' := Ch + 2 * c).
    set (Y := fun (j : nat) (s : Z) => Hv s + inject_Z (Z.of_nat j) * eta * f s - Q * w s - L').
    assert (EY : forall j p, In p (pairs m) -> mean p (Y j) ==
      mean p Hv + inject_Z (Z.of_nat j) * eta * mean p f - Q * mean p w - L').
    { intros j p I. pose proof (wf_rows m g_wf p I) as Rw. unfold Y.
      assert (X : mean p (fun s => Hv s + inject_Z (Z.of_nat j) * eta * f s - Q * w s - L') ==
        mean p (fun s => (Hv s + inject_Z (Z.of_nat j) * eta * f s) + ((- Q) * w s + (- L'))))
          by (apply mean_ext; intros; ring).
      rewrite X, !mean_plus, !mean_times, (mean_const m p Rw). ring. }
    assert (stepY : forall j p, In p (pairs m) -> taken a p = true -> A (state p) = true ->
      Y (S j) (state p) <= r m p + 1 * mean p (Y j)).
    { intros j p I Tk Ap. pose proof (wf_rows m g_wf p I) as Rw. rewrite (EY j p I). unfold Y.
      rewrite Nat2Z.inj_succ, <- Z.add_1_r, inject_Z_plus. change (inject_Z 1) with 1.
      set (z := inject_Z (Z.of_nat j)). assert (z0 : 0 <= z) by (apply inject_nneg; lia).
      assert (Sp : is_state m (state p)) by apply Rw.
      unfold A in Ap. apply orb_true_iff in Ap. destruct Ap as [Fp|Ap].
      - pose proof (fin_equal p I Fp Tk) as Ch1. unfold surplus_of in Ch1.
        assert (fs : f (state p) == 0) by (unfold f, phi; destruct (excl (state p)) as [Ex _];
          destruct (Ex Fp) as [_ Ea]; rewrite Ea; reflexivity).
        assert (Ef : 0 <= mean p f).
        { apply sumQ_pos. intros o Io. pose proof (prob_pos m p Rw o Io).
          pose proof (phi_range p0 order abv P0 (next o)). fold f in H1. nra. }
        assert (Ew : mean p w <= mu * w (state p)).
        { apply (step p I). unfold T at 1. rewrite Fp. cbn [orb]. intros o Io. unfold T.
          rewrite (fin_closed p I (fun _ => Tk) Fp o Io). reflexivity. }
        rewrite (w_in w T WW (state p)) in * by (unfold T; now rewrite Fp). rewrite fs.
        assert (0 <= z * eta) by nra. set (ze := z * eta) in *. nra.
      - pose proof (above_pair p I Ap Tk) as X. unfold of_above, goes_round in X.
        apply andb_true_iff in X. destruct X as [_ X].
        assert (kp : keeps order abv p /\ ((order (state p) = 0%Z /\ (forall o, In o (outcomes p)
          -> abv (next o) = true /\ order (next o) = 0%Z)
            /\ 0 < surplus_of 1 (r m p) p Hv) \/ ((0 < order (state p))%Z /\ exists o,
              In o (outcomes p) /\ (order (next o) < order (state p))%Z))).
        { apply orb_true_iff in X. destruct X as [X|X].
          - rewrite !andb_true_iff in X. destruct X as [[X O] Gn]. rewrite L in Gn.
            cbn [negb orb] in Gn.
            rewrite all_next_ok in X. apply Z.eqb_eq in O. apply Z.ltb_lt in Gn.
            assert (N : forall o, In o (outcomes p) -> abv (next o) = true /\ order (next o)
              = 0%Z).
            { intros o Io. specialize (X o Io). cbv beta in X. apply andb_true_iff in X.
              destruct X as [X1 X2].
              apply Z.eqb_eq in X2. split; assumption. }
            split.
            + left. intros o Io. destruct (N o Io). split; [assumption|congruence].
            + left. split; [exact O|]. split; [exact N|]. now apply gain_at.
          - apply falls_ok in X. destruct X as (o & Io & Lo & Ao). fold abv in Ao. split.
            + right. eauto.
            + right. pose proof (g_order _ (next_state p o I Io)). split; [lia|eauto]. }
        destruct kp as [kp cases].
        pose proof (phi_step m p0 order abv g_wf P0 least g_order p I Ap kp) as Ef. fold f in Ef.
        pose proof (phi_range p0 order abv P0 (state p)) as fr. fold f in fr.
        assert (ze : 0 <= z * eta) by nra.
        assert (Ef' : z * eta * f (state p) <= z * eta * mean p f) by (set (x := z * eta) in *;
          nra).
        destruct cases as [(O & N & Gn)|(O & lower)].
        + pose proof (Heta p I Gn) as G1. unfold surplus_of in G1.
          assert (Ew : mean p w <= mu * w (state p)).
          { apply (step p I). unfold T at 1. rewrite Ap, O. rewrite Z.eqb_refl. cbn [andb].
            rewrite orb_true_r.
            intros o Io. destruct (N o Io) as [N1 N2]. unfold T. rewrite N1, N2, Z.eqb_refl.
            cbn [andb]. apply orb_true_r. }
          rewrite (w_in w T WW (state p)) in * by (unfold T; rewrite Ap, O, Z.eqb_refl;
            cbn [andb]; apply orb_true_r).
          assert (eta * f (state p) <= eta) by nra. assert (0 <= Q * (0 - mean p w)) by nra. lra.
        + assert (Tp : T (state p) = false).
          { unfold T. destruct (excl (state p)) as (_ & Ex & _). destruct (Ex Ap) as [_ Ef0].
            rewrite Ef0, Ap. cbn [orb andb].
            apply Z.eqb_neq. lia. }
          assert (Ew : mean p w <= mu * w (state p)).
          { apply (step p I). rewrite Tp. destruct lower as (o & Io & Lo). eauto. }
          pose proof (w_out w T WW _ Tp) as w1. pose proof (HR' p I) as HRp. cbv beta in HRp.
          unfold surplus_of in HRp.
          assert (eta * f (state p) <= eta) by nra.
          assert (Q * (w (state p) - mean p w) >= R' + eta).
          { assert (w (state p) - mean p w >= 1 - mu) by nra. nra. }
          lra. }
    assert (stepB : forall p, In p (pairs m) -> taken b p = true -> A (state p) = true ->
      - c * wb (state p) <= r m p + 1 * mean p (fun s => - c * wb s)).
    { intros p I Tk Ap. rewrite mean_times. specialize (stepb p I Tk Ap).
      destruct (g (state p)) eqn:G.
      - destruct (goal_pair p I G) as [r0 _]. rewrite (w_in wb g WB _ G) in *. rewrite r0. nra.
      - pose proof (w_out wb g WB _ G). specialize (HR p I).
        assert (c * mean p wb <= c * (lam * wb (state p))) by nra.
        assert (R <= c * (1 - lam) * wb (state p)) by (rewrite cR; nra). nra. }
    assert (Y0 : forall t, is_state m t -> Y 0%nat t <= - c * wb t).
    { intros t St. unfold Y. change (inject_Z (Z.of_nat 0)) with 0. specialize (BH t St).
      unfold L'.
      pose proof (w_low w T WW t). pose proof (w_low wb g WB t). pose proof (w_high wb g WB t).
      nra. }
    (* enough steps of the policy before it goes to the goal *)
    assert (fp : 0 < f s) by (apply phi_in; assumption).
    set (need := (Qabs B + Ch + 2 * Q + L') / (eta * f s)).
    assert (ef : 0 < eta * f s) by nra.
    set (n0 := S (Z.to_nat (Qceiling need))).
    exists (switch n0).
    assert (pl : forall hy t, is_state m t ->
      (forall p q, In (p, q) (switch n0 hy t) -> In p (pairs m) /\ state p = t /\ 0 <= q /\
        (if (length hy <? n0)%nat then taken a p = true else taken b p = true)) /\
          sumQ snd (switch n0 hy t) == 1).
    { intros hy t St. unfold switch. destruct (length hy <? n0)%nat.
      - apply (stationary_plays m a P hy t St).
      - apply (stationary_plays m b (proj1 b_ok) hy t St). }
    assert (cl : forall t p, In p (pairs m) ->
      (if (t <? n0)%nat then taken a p = true else taken b p = true) ->
      A (state p) = true -> forall o, In o (outcomes p) -> A (next o) = true).
    { intros t p I D. destruct (t <? n0)%nat; [now apply A_closed_a|now apply A_closed_b]. }
    assert (AS : A s = true) by (unfold A; rewrite As; apply orb_true_r).
    split; [|split].
    - intros hy t St. destruct (pl hy t St) as [X1 X2]. split; [|exact X2]. intros p q I.
      destruct (X1 p q I) as (? & ? & ? & _). auto.
    - exists n0. intros n Ln.
      apply Qle_trans with (Y n0 s).
      + unfold Y. specialize (BH s Ss). pose proof (w_low w T WW s). pose proof (w_high w T WW s).
        assert (K : need * (eta * f s) == Qabs B + Ch + 2 * Q + L') by (unfold need; field; lra).
        assert (N1 : need <= inject_Z (Z.of_nat n0)).
        { apply Qle_trans with (1 := Qle_ceiling need). rewrite <- Zle_Qle. unfold n0. lia. }
        pose proof (Qle_Qabs B). set (z := inject_Z (Z.of_nat n0)) in *.
        assert (need * (eta * f s) <= z * (eta * f s)) by (apply Qmult_le_compat_r; lra).
        assert (Q * w s <= 2 * Q) by nra. lra.
      + set (X := fun t : nat => if (t <? n0)%nat then Y (n0 - t)%nat else fun s => - c * wb s).
        apply Qle_trans with (X (length (@nil (Z * Z))) s).
        { unfold X. cbn [length]. replace (0 <? n0)%nat with true by reflexivity.
          rewrite Nat.sub_0_r. apply Qle_refl. }
        apply (timed_lower m n (fun t p => if (t <? n0)%nat then taken a p = true else taken b p
          = true)
          (fun s => A s = true) (r m) (fun _ => 0) X (switch n0) g_wf pl cl); auto.
        * intros t St At. unfold X. replace (n <? n0)%nat with false by (symmetry;
            apply Nat.ltb_ge; lia).
          pose proof (w_low wb g WB t). nra.
        * intros t p Lt I D Ap. unfold X at 1. destruct (Nat.ltb_spec t n0) as [T1|T1].
          -- replace (n0 - t)%nat with (S (n0 - S t)) by lia.
             apply Qle_trans with (1 := stepY (n0 - S t)%nat p I D Ap).
             assert (mean p (Y (n0 - S t)%nat) <= mean p (X (S t))); [|lra].
             apply (mean_le m p (wf_rows m g_wf p I)). intros o Io. unfold X.
             destruct (Nat.ltb_spec (S t) n0); [apply Qle_refl|].
             replace (n0 - S t)%nat with 0%nat by lia. apply Y0. now apply (next_state p).
          -- unfold X. replace (S t <? n0)%nat with false by (symmetry; apply Nat.ltb_ge; lia).
             now apply stepB.
    - intros eps e0. destruct (pow_vanishes lam 2 eps ltac:(lra) ltac:(lra) e0) as [N HN].
      exists (n0 + N)%nat. intros n Ln.
      apply Qle_trans with (2 := HN (n - n0)%nat ltac:(lia)).
      set (X := fun t : nat => if (t <? n0)%nat then fun _ : Z => pow lam (n - n0) * 2
                else fun s => pow lam (n - t) * wb s).
      apply Qle_trans with (X (length (@nil (Z * Z))) s).
      2: { unfold X. cbn [length]. replace (0 <? n0)%nat with true by reflexivity.
      apply Qle_refl. }
      apply (timed_upper m n (fun t p => if (t <? n0)%nat then taken a p = true else taken b p =
        true)
        (fun s => A s = true) (fun _ => 0) ind X (switch n0) g_wf pl cl); auto.
      + intros t St At. unfold X. replace (n <? n0)%nat with false by (symmetry;
          apply Nat.ltb_ge; lia).
        rewrite Nat.sub_diag. cbn [pow]. unfold ind. pose proof (w_low wb g WB t).
        destruct (g t) eqn:G; cbn [negb]; [lra|]. pose proof (w_out wb g WB t G). lra.
      + intros t p Lt I D Ap. pose proof (wf_rows m g_wf p I) as Rw.
        unfold X at 2. destruct (Nat.ltb_spec t n0) as [T1|T1].
        * assert (mean p (X (S t)) <= mean p (fun _ => pow lam (n - n0) * 2)).
          { apply (mean_le m p Rw). intros o Io. unfold X.
            destruct (Nat.ltb_spec (S t) n0); [apply Qle_refl|].
            replace (n - S t)%nat with (n - n0)%nat by lia. pose proof (w_high wb g WB (next o)).
            pose proof (pow_nneg lam (n - n0) l0). nra. }
          rewrite (mean_const m p Rw) in H0. lra.
        * unfold X. replace (S t <? n0)%nat with false by (symmetry; apply Nat.ltb_ge; lia).
          rewrite mean_times.
          specialize (stepb p I D Ap). replace (n - t)%nat with (S (n - S t)) by lia. cbn [pow].
          pose proof (pow_nneg lam (n - S t) l0). set (x := pow lam (n - S t)) in *. nra.
  Qed.
  End Lost.
End Goal.
