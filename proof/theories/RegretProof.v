(* Verdicts on a policy: in n steps it earns what the only policy of its model earns. *)
From Coq Require Import ZArith QArith Qreduction Qfield List Bool Lqa Lia.
From MDP Require Import Spec Checker Claims Arith Integers Goals Soundness.
From MDP Require Import LimitsChecker LimitsProof RegretChecker RegretClaims.
Import ListNotations.
Open Scope Q_scope.

(* ---- lists ---------------------------------------------------------------------------------- *)

Lemma grouped_pairs l s :
  grouped (map (fun p => (state p, p)) l) s = filter (fun p => (state p =? s)%Z) l.
Proof.
  unfold grouped. rewrite filter_of_map, map_map. cbn [fst snd]. now rewrite map_id.
Qed.
Lemma sumQ_among {A} (f : A -> Q) (a b : A -> bool) l :
  (forall x, In x l -> b x = false -> f x == 0) ->
  sumQ f (filter a (filter b l)) == sumQ f (filter a l).
Proof.
  induction l as [|x l IH]; intro H; [reflexivity|]. cbn [filter].
  assert (H' : forall y, In y l -> b y = false -> f y == 0) by (intros; apply H; auto; now right).
  specialize (IH H'). destruct (b x) eqn:e; cbn [filter].
  - destruct (a x); cbn [sumQ]; now rewrite IH.
  - destruct (a x); cbn [sumQ]; rewrite IH; [|reflexivity].
    rewrite (H x (or_introl eq_refl) e). ring.
Qed.

(* ---- the draw ------------------------------------------------------------------------------- *)

Section Drawn.
  Variables (m : model) (v : verdict).
  Hypotheses (wf : well_formed m)
    (shares : forall p, In p (pairs m) -> share_right v p = true).
  Let weightQ (p : pair) : Q := share_of v p.
  Let among (s : Z) : list pair :=
    filter (fun p => (state p =? s)%Z) (filter (drawn v) (pairs m)).

  Lemma common_ok l : forall u, (forall p, In p l -> (0 < denominator p)%Z) -> (0 < u)%Z ->
    let unit := fold_left (common v) l u in
    (0 < unit)%Z /\ (u | unit)%Z /\ forall p, In p l -> (below_of v p | unit)%Z.
  Proof.
    induction l as [|p l IH]; intros u D u0; cbn [fold_left].
    - split; [exact u0|]. split; [apply Z.divide_refl|easy].
    - assert (b0 : (0 < below_of v p)%Z).
      { unfold below_of. pose proof (D p (or_introl eq_refl)). lia. }
      assert (c0 : (0 < common v u p)%Z).
      { unfold common. assert (0 <= Z.lcm u (below_of v p))%Z by apply Z.lcm_nonneg.
        assert (Z.lcm u (below_of v p) <> 0)%Z; [|lia]. intro X. apply Z.lcm_eq_0 in X. lia. }
      destruct (IH (common v u p) (fun q I => D q (or_intror I)) c0) as (U & V & W).
      split; [exact U|]. split.
      + apply Z.divide_trans with (2 := V). apply Z.divide_lcm_l.
      + intros q [<-|I]; [|now apply W]. apply Z.divide_trans with (2 := V). apply Z.divide_lcm_r.
  Qed.

  (* The mean of a draw is the mean of its pairs' means, by their shares. *)
  Lemma drawn_sum s l (f : Z -> Q -> Q) : (forall p, In p l -> In p (pairs m)) ->
    sumQ (fun o => prob (draw v s l) o * f (next o) (reward o)) (outcomes (draw v s l)) ==
    sumQ (fun p => weightQ p * sumQ (fun o => prob p o * f (next o) (reward o)) (outcomes p)) l.
  Proof.
    intro I. assert (D : forall p, In p l -> (0 < denominator p)%Z).
    { intros p Ip. now apply (wf_rows m wf p (I p Ip)). }
    destruct (common_ok l 1 D ltac:(lia)) as (U & _ & W).
    cbn [outcomes draw]. rewrite sumQ_flat. apply sumQ_ext. intros p Ip.
    unfold drawn_outcomes. rewrite sumQ_map, <- sumQ_times. apply sumQ_ext. intros o _.
    unfold prob. cbn [weight next reward drawn_outcome denominator draw].
    set (unit := fold_left (common v) l 1%Z) in *. destruct (W p Ip) as [k K].
    assert (b0 : (0 < below_of v p)%Z) by (unfold below_of; pose proof (D p Ip); lia).
    assert (k0 : (0 < k)%Z) by nia.
    rewrite K, Z.div_mul by lia. rewrite !inject_Z_mult.
    assert (B : inject_Z (below_of v p) ==
      inject_Z (denominator p) * inject_Z (Zpos (Qden (share_of v p)))).
    { unfold below_of. now rewrite inject_Z_mult. }
    rewrite B, (Q_num (share_of v p)). unfold weightQ. field.
    repeat split; apply inject_nz; auto; lia.
  Qed.
  Lemma drawn_mean s l f : (forall p, In p l -> In p (pairs m)) ->
    mean (draw v s l) f == sumQ (fun p => weightQ p * mean p f) l.
  Proof. intro I. exact (drawn_sum s l (fun t _ => f t) I). Qed.
  Lemma drawn_reward s l : (forall p, In p l -> In p (pairs m)) ->
    mean_reward (draw v s l) == sumQ (fun p => weightQ p * mean_reward p) l.
  Proof. intro I. exact (drawn_sum s l (fun _ x => x) I). Qed.

  Lemma among_in s p : In p (among s) -> In p (pairs m) /\ state p = s.
  Proof.
    unfold among. rewrite !filter_In. intros [[I _] E]. apply Z.eqb_eq in E. auto.
  Qed.
  (* What the policy takes by its shares: a share of 0 counts for nothing. *)
  Lemma choices_sum (X : pair -> Q) h s :
    sumQ (fun c => snd c * X (fst c)) (randomised m (share v) h s) ==
    sumQ (fun p => weightQ p * X p) (among s).
  Proof.
    unfold randomised. rewrite sumQ_map. cbn [fst snd]. symmetry. unfold among.
    apply (sumQ_among (fun p => weightQ p * X p)). intros p I N.
    specialize (shares p I). unfold share_right in shares. unfold drawn in N.
    apply Z.leb_le in shares. apply Z.ltb_ge in N. unfold weightQ.
    assert (Z : share_of v p == 0) by (apply Qnum_zero; lia). rewrite Z. ring.
  Qed.

  Let mi := drawn_model m v.
  Variable act : Z -> Z.
  Hypotheses (wi : well_formed mi) (P : policy_right mi act = true).

  Lemma drawn_pair p : In p (pairs mi) -> p = draw v (state p) (among (state p)).
  Proof.
    intro I. unfold mi, drawn_model in I. cbn [pairs] in I. apply in_map_iff in I.
    destruct I as (q & <- & _). rewrite grouped_pairs. reflexivity.
  Qed.
  Lemma only_pair h s : is_state m s ->
    exists p, stationary mi act h s = [(p, 1)] /\ In p (pairs mi) /\ state p = s /\
      p = draw v s (among s).
  Proof.
    intro Ss. unfold stationary. destruct (find _ (pairs mi)) as [p|] eqn:F.
    - apply find_some in F. destruct F as [I F]. split_and. reflect. exists p.
      split; [reflexivity|]. split; [exact I|]. split; [assumption|].
      pose proof (drawn_pair p I) as Y. congruence.
    - exfalso. destruct (policy_pair mi act s P Ss) as (p & I & Es & T).
      apply (find_none _ _ F) in I. unfold taken in T. rewrite Z.eqb_eq in T. subst s.
      rewrite Z.eqb_refl in I. cbn in I. rewrite T, Z.eqb_refl in I. discriminate.
  Qed.

  Lemma drawn_total s : is_state m s -> sumQ weightQ (among s) == 1.
  Proof.
    intro Ss. destruct (only_pair [] s Ss) as (p & _ & I & _ & E).
    pose proof (mean_const mi p (wf_rows mi wi p I) 1) as C. rewrite E in C.
    rewrite drawn_mean in C by (intros q Iq; now apply (among_in s)). rewrite <- C.
    apply sumQ_ext. intros q Iq. destruct (among_in s q Iq) as [Iq' _].
    rewrite (mean_const m q (wf_rows m wf q Iq')). ring.
  Qed.
  Lemma randomised_valid : valid m (randomised m (share v)).
  Proof.
    intros h s Ss. split.
    - intros p q I. unfold randomised in I. apply in_map_iff in I. destruct I as (x & E & I).
      apply filter_In in I. destruct I as [I S]. apply Z.eqb_eq in S. inversion E. subst x q.
      repeat split; auto. specialize (shares p I). unfold share_right in shares.
      apply Z.leb_le in shares. now apply Qnum_nneg.
    - pose proof (choices_sum (fun _ => 1) [] s) as X.
      rewrite (sumQ_ext snd (fun c => snd c * 1)) by (intros; ring).
      change (randomised m (share v) h s) with (randomised m (share v) [] s).
      rewrite X, <- (drawn_total s Ss). apply sumQ_ext. intros. ring.
  Qed.

  (* In n steps the policy gets what the only policy of its model gets. *)
  Lemma run_drawn (c ci : pair -> Q) gamma f :
    (forall s, is_state m s -> ci (draw v s (among s)) == sumQ (fun p => weightQ p * c p) (among s))
    -> forall n h h' s, is_state m s ->
    run ci gamma f (stationary mi act) n h' s == run c gamma f (randomised m (share v)) n h s.
  Proof.
    intro R. induction n; intros h h' s Ss; [reflexivity|]. cbn [run].
    destruct (only_pair h' s Ss) as (p & St & I & _ & E). rewrite St. cbn [sumQ fst snd].
    set (F := run ci gamma f (stationary mi act) n ((s, action p) :: h')) in *.
    rewrite (choices_sum (fun p => c p +
      gamma * mean p (run c gamma f (randomised m (share v)) n ((s, action p) :: h))) h s).
    rewrite E. rewrite (R s Ss), drawn_mean by (intros q Iq; now apply (among_in s)).
    rewrite (sumQ_ext (fun p0 => weightQ p0 * (c p0 +
      gamma * mean p0 (run c gamma f (randomised m (share v)) n ((s, action p0) :: h))))
      (fun p0 => weightQ p0 * c p0 + gamma * (weightQ p0 * mean p0 F))).
    - rewrite sumQ_plus, sumQ_times. ring.
    - intros q Iq. destruct (among_in s q Iq) as [Iq' _].
      assert (M : mean q (run c gamma f (randomised m (share v)) n ((s, action q) :: h)) ==
        mean q F); [|rewrite M; ring].
      apply sumQ_ext. intros o Io. unfold F.
      rewrite (IHn ((s, action q) :: h) ((s, action p) :: h') (next o)); [reflexivity|].
      destruct (wf_rows m wf q Iq') as (_ & _ & _ & N). now apply N.
  Qed.
  Lemma earns_drawn gamma n h s : is_state m s ->
    earns mi gamma (stationary mi act) n h s == earns m gamma (randomised m (share v)) n h s.
  Proof.
    unfold earns. apply run_drawn. intros t St. unfold r.
    change (maximise mi) with (maximise m). destruct (maximise m).
    - apply drawn_reward. intros q Iq. now apply (among_in t).
    - rewrite drawn_reward by (intros q Iq; now apply (among_in t)).
      rewrite (sumQ_ext (fun p => weightQ p * - mean_reward p)
        (fun p => (-(1)) * (weightQ p * mean_reward p))) by (intros; ring).
      rewrite sumQ_times. ring.
  Qed.
  Lemma chance_drawn set n h s : is_state m s ->
    chance set (stationary mi act) n h s == chance set (randomised m (share v)) n h s.
  Proof.
    unfold chance. apply run_drawn. intros t St. symmetry. apply sumQ_zero. intros. ring.
  Qed.
End Drawn.

(* ---- what the policy is worth --------------------------------------------------------------- *)

Lemma both_eventually F G : eventually F -> eventually G -> eventually (fun n => F n /\ G n).
Proof.
  intros [N HN] [K HK]. exists (N + K)%nat. intros n L. split; [apply HN|apply HK]; lia.
Qed.
Lemma eventually_impl (F G : nat -> Prop) : (forall n, F n -> G n) -> eventually F ->
  eventually G.
Proof. intros I [N H]. exists N. auto. Qed.
Lemma near_one_impl (F G : Q -> Prop) : (forall gamma, F gamma -> G gamma) -> near_one F ->
  near_one G.
Proof. intros I (d & d0 & H). exists d. auto. Qed.

Section Worth.
  Variables (m : model) (v : verdict).
  Let mi := drawn_model m v.
  Let pi := randomised m (share v).
  Let best := stationary mi (actions (own v)).
  Hypotheses (H : holds mi (own v)) (B : valid mi best)
    (E : forall gamma n h s, is_state m s -> earns mi gamma best n h s == earns m gamma pi n h s)
    (C : forall set n h s, is_state m s -> chance set best n h s == chance set pi n h s)
    (U : forall h rank order infinite, claims (own v) = Reaching h rank order infinite ->
      missing_is_least m = true -> forall s, is_state m s -> infinite s <> 1%Z)
    (F : form_of (claims (own v)) <> (-1)%Z).

  Lemma worth_value V : between mi best V V -> earns_value m pi V.
  Proof.
    intros (lam & K & L & K0 & X). exists lam, K. split; [exact L|]. split; [exact K0|].
    intros s n h Ss. destruct (X s Ss) as (Up & Lo & Mi).
    specialize (Up best n h B). specialize (Lo n h). specialize (Mi best n h B).
    change (discount mi) with (discount m) in *. rewrite (E _ _ _ _ Ss) in Up, Lo.
    change (beside_goal mi) with (beside_goal m) in Mi. rewrite (C _ _ _ _ Ss) in Mi.
    repeat split; assumption.
  Qed.
  Lemma worth_average g h : average_optimum mi best g h -> earns_average m pi g h.
  Proof.
    intros (K & K0 & X). exists K. split; [exact K0|]. intros s n hy Ss.
    destruct (X s n hy Ss) as [_ Y]. now rewrite (E _ _ _ _ Ss) in Y.
  Qed.
  Lemma worth_limit g h : limit_total mi best g h -> earns_limit m pi g h.
  Proof.
    intros X s hy Ss. destruct (X s hy Ss) as (Z & Pl & Mn). split; [|split].
    - intros g0 eps e0. specialize (Z g0 eps e0). revert Z. apply near_one_impl.
      intros gamma [Up Lo]. pose proof (both_eventually _ _ Lo (Up best B)) as Y. revert Y.
      apply eventually_impl. intros n Y. now rewrite (E _ _ _ _ Ss) in Y.
    - intros gp b. specialize (Pl gp b). revert Pl. apply near_one_impl. intros gamma.
      apply eventually_impl. intros n Y. now rewrite (E _ _ _ _ Ss) in Y.
    - intros gn b. specialize (Mn gn b). revert Mn. apply near_one_impl. intros gamma Y.
      specialize (Y best B). revert Y. apply eventually_impl. intros n Y.
      now rewrite (E _ _ _ _ Ss) in Y.
  Qed.
  Lemma miss_drawn g h s : is_state m s -> may_miss g best h s -> may_miss g pi h s.
  Proof.
    intros Ss (d & d0 & X). exists d. split; [exact d0|]. revert X. apply eventually_impl.
    intros n X. unfold missed in *. now rewrite (C _ _ _ _ Ss) in X.
  Qed.
  Lemma worth_until g h rank order infinite :
    claims (own v) = Reaching h rank order infinite ->
    goal_optimum mi g best (value h) infinite -> earns_until m g pi (value h) infinite.
  Proof.
    intros Cl X s hy Ss. destruct (X s hy Ss) as (Or & Fi & Ne & Ab & _). split.
    - intro I0. destruct (Fi I0) as (Ar & Va & _). split.
      + intros eps e0. specialize (Ar eps e0). revert Ar. apply eventually_impl. intros n Y.
        unfold missed in *. now rewrite (C _ _ _ _ Ss) in Y.
      + intros eps e0. specialize (Va eps e0). revert Va. apply eventually_impl. intros n Y.
        now rewrite (E _ _ _ _ Ss) in Y.
    - intro N. destruct Or as [Y|[Y|Y]]; [congruence| |].
      + destruct (Ne Y) as [L Mi]. change (missing_is_least mi) with (missing_is_least m) in L.
        rewrite L. split; [|exact Y]. apply miss_drawn; auto.
      + destruct (missing_is_least m) eqn:L.
        * destruct (U h rank order infinite Cl eq_refl s Ss Y).
        * split; [|exact Y]. apply miss_drawn; auto.
  Qed.

  Lemma worth : is_worth m pi (own v).
  Proof.
    pose proof H as X. unfold holds in X. cbv zeta in X. destruct X as (_ & _ & X).
    unfold is_worth. revert X. pose proof worth_until as Un. pose proof F as F'. revert Un F'.
    case (claims (own v)); [intros h rank|intros low high rank|intros [] g h w|
      intros h rank order inf]; intros Un F' X.
    - destruct X as (Y & _ & S & _). split; [now apply worth_value|exact S].
    - now destruct F'.
    - destruct X as (Y & _ & S & _). split; [now apply worth_average|exact S].
    - destruct X as (D & _ & Y & S & _). split; [exact D|]. split; [now apply worth_limit|exact S].
    - destruct X as (g & G & Y & S & _). exists g. split; [exact G|]. split; [|exact S].
      now apply (Un g h rank order inf).
  Qed.
End Worth.

(* ---- what it loses -------------------------------------------------------------------------- *)

Lemma is_most_ok m x : is_most m x = true <-> x = the_most m.
Proof. unfold the_most. destruct x; cbn; destruct (maximise m); split; easy. Qed.
Lemma is_least_ok m x : is_least m x = true <-> x = the_least m.
Proof. unfold the_least. destruct x; cbn; destruct (maximise m); split; easy. Qed.

Lemma regret_right_ok m v : regret_right m v = true ->
  regret_is m (start_value (optimum v)) (start_value (own v)) (regret v).
Proof.
  unfold regret_right, regret_is. destruct (regret v) as [q| |]; [| |easy].
  - unfold is_difference, loses, difference. destruct (start_value (optimum v)) as [a| |]; [|easy|easy].
    destruct (start_value (own v)) as [b| |]; [|easy|easy]. intro X. apply Z.eqb_eq in X.
    exists a, b. split; [reflexivity|]. split; [reflexivity|].
    assert (Y : inject_Z (signed m (Qnum a * Zpos (Qden b) - Qnum b * Zpos (Qden a))) *
      inject_Z (Zpos (Qden q)) ==
      inject_Z (Qnum q) * (inject_Z (Zpos (Qden a)) * inject_Z (Zpos (Qden b))))
      by (rewrite <- !inject_Z_mult, X; reflexivity).
    assert (Z : inject_Z (Qnum a * Zpos (Qden b) - Qnum b * Zpos (Qden a)) ==
      (a - b) * (inject_Z (Zpos (Qden a)) * inject_Z (Zpos (Qden b)))).
    { unfold Z.sub. rewrite inject_Z_plus, inject_Z_opp, !inject_Z_mult, !Q_num. ring. }
    rewrite (signed_ok m _ _ Z), Q_num in Y. unfold own_sign.
    assert (a0 : 0 < inject_Z (Zpos (Qden a))) by (apply inject_pos; lia).
    assert (b0 : 0 < inject_Z (Zpos (Qden b))) by (apply inject_pos; lia).
    assert (q0 : 0 < inject_Z (Zpos (Qden q))) by (apply inject_pos; lia).
    set (da := inject_Z (Zpos (Qden a))) in *. set (db := inject_Z (Zpos (Qden b))) in *.
    set (dq := inject_Z (Zpos (Qden q))) in *.
    assert (n0 : ~ da * db * dq == 0).
    { assert (0 < da * db * dq) by (repeat apply Qmult_lt_0_compat; assumption). lra. }
    apply (Qmult_inj_r _ _ (da * db * dq) n0). destruct (maximise m); lra.
  - unfold is_apart. rewrite orb_true_iff, !andb_true_iff, !negb_true_iff.
    assert (no : forall (f : bool) (Y : Prop), (f = true <-> Y) -> f = false -> ~ Y).
    { intros f Y I N y. apply I in y. congruence. }
    intros [[X Y]|[X Y]]; [left|right].
    + split; [now apply is_most_ok|]. exact (no _ _ (is_most_ok m _) Y).
    + split; [now apply is_least_ok|]. exact (no _ _ (is_least_ok m _) Y).
Qed.

Theorem regret_sound m v hs hs_own : check_regret m v hs hs_own = true -> verdict_holds m v.
Proof.
  unfold check_regret, verdict_holds. intro X. rewrite !andb_true_iff in X.
  destruct X as [[[[[O Sh] W] Fo] Un] R]. rewrite forallb_forall in Sh, Un.
  pose proof (sound _ _ _ O) as HO. pose proof (sound _ _ _ W) as HW.
  pose proof HO as (wf & _). pose proof HW as (wi & B & _).
  pose proof W as W'. unfold check in W'. rewrite !andb_true_iff in W'.
  destruct W' as [[[_ P] _] _].
  assert (E := earns_drawn m v wf Sh (actions (own v)) P).
  assert (C := chance_drawn m v wf Sh (actions (own v)) P).
  unfold same_form in Fo. apply andb_true_iff in Fo. destruct Fo as [Fo F0].
  apply Z.eqb_eq in Fo. apply Z.leb_le in F0.
  pose proof O as O'. unfold check in O'. rewrite !andb_true_iff in O'.
  destruct O' as [[[_ Po] _] _].
  split; [exact HO|]. split; [exact (randomised_valid m v wf Sh (actions (own v)) wi P)|].
  split; [|split; [exact Fo|now apply regret_right_ok]].
  apply worth; auto.
  - intros h rank order infinite Cl L s Ss I1.
    destruct (policy_pair m _ s Po Ss) as (p & I & <- & _). specialize (Un p I).
    unfold unbounded in Un. rewrite Cl, L in Un. unfold above in Un. rewrite I1 in Un.
    discriminate.
  - rewrite <- Fo. lia.
Qed.
