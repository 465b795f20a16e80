(* The value of the start, and whether the optimum is unique: what the checker's tests show. *)
From Coq Require Import ZArith QArith Qreduction Qfield List Bool Lqa Lia.
From MDP Require Import Spec Checker Claims Arith Integers.
Import ListNotations.
Open Scope Q_scope.

(* ---- the value of the start -----------------------------------------------------------------
  *)

Lemma is_mean_ok m x v : well_formed m -> level_pos m x -> is_mean m x v = true ->
  start_mean m (value x) v.
Proof.
  intros wf L. unfold is_mean, start_mean. destruct v as [q| |]; try discriminate.
  set (l := map (start_term x) (start m)). destruct (sum_of_ok l) as [P V].
  { intros term I. apply in_map_iff in I. destruct I as ([s p] & <- & I).
    destruct (wf_start m wf) as [_ W]. specialize (L s (proj1 (W s p I))).
    unfold start_term, positive. cbn [fst snd]. destruct (x s) as [t b]. cbn [fst snd] in *.
    now apply Z.mul_pos_pos. }
  assert (S : quotient (sum_of l) == sumQ (fun sq => snd sq * value x (fst sq)) (start m)).
  { rewrite V. unfold l. rewrite sumQ_map. apply sumQ_ext. intros [s p] I.
    destruct (wf_start m wf) as [_ W]. specialize (L s (proj1 (W s p I))).
    unfold start_term, value, quotient. cbn [fst snd]. destruct (x s) as [t b].
    cbn [fst snd] in *. rewrite inject_Z_mult, Q_num. field.
    split; apply inject_nz; [exact L|lia]. }
  assert (T := quotient_top _ _ P S). destruct (sum_of l) as [top below]. intro X. reflect.
  unfold positive in P. cbn [fst snd] in P, T. apply inject_pos in P.
  assert (d0 : 0 < inject_Z (Zpos (Qden q))) by (apply inject_pos; lia).
  assert (Y : inject_Z (signed m (Qnum q)) * inject_Z below ==
    inject_Z top * inject_Z (Zpos (Qden q))) by (rewrite <- !inject_Z_mult, X; reflexivity).
  rewrite (signed_ok m _ _ (Q_num q)), T in Y. unfold own_sign.
  set (d := inject_Z (Zpos (Qden q))) in *. set (b := inject_Z below) in *.
  set (sum := sumQ _ _) in *.
  assert (bd : ~ b * d == 0).
  { assert (0 < b * d) by now apply Qmult_lt_0_compat. lra. }
  apply (Qmult_inj_r _ _ (b * d) bd). destruct (maximise m); lra.
Qed.

Lemma may_begin_ok m s q : well_formed m -> In (s, q) (start m) -> begins (s, q) = true -> 0 < q.
Proof.
  intros wf I B. unfold begins in B. cbn [snd] in B. apply negb_true_iff, Z.eqb_neq in B.
  destruct (wf_start m wf) as [_ W]. destruct (W s q I) as [_ q0].
  destruct (Qlt_le_dec 0 q) as [|l]; [assumption|]. destruct B. apply Qnum_zero. lra.
Qed.
Lemma begins_ok s q : 0 < q -> begins (s, q) = true.
Proof.
  intro q0. unfold begins. cbn [snd]. apply negb_true_iff, Z.eqb_neq. intro H.
  apply Qnum_zero in H. lra.
Qed.

Lemma start_value_right_ok m sign x v : well_formed m -> level_pos m x ->
  start_value_right m sign x v = true -> start_is m sign (value x) v.
Proof.
  intros wf L. unfold start_value_right, start_is.
  assert (No : forall f : Z -> bool,
    existsb (fun sq => begins sq && f (fst sq)) (start m) = false ->
    forall s, may_begin m s -> f s = false).
  { intros f X s (q & I & q0). destruct (f s) eqn:e; [|reflexivity].
    assert (existsb (fun sq : Z * Q => begins sq && f (fst sq)) (start m) = true); [|congruence].
    apply existsb_exists. exists (s, q). split; [exact I|]. rewrite (begins_ok s q q0). exact e. }
  assert (Yes : forall f : Z -> bool,
    existsb (fun sq => begins sq && f (fst sq)) (start m) = true ->
    exists s, may_begin m s /\ f s = true).
  { intros f X. apply existsb_exists in X. destruct X as ([s q] & I & X).
    apply andb_true_iff in X. destruct X as [B e]. exists s. split; [|exact e].
    exists q. split; [exact I|]. now apply (may_begin_ok m s q wf). }
  assert (nu := No (fun s => 0 <? sign s)%Z). assert (nd := No (fun s => sign s <? 0)%Z).
  assert (yu := Yes (fun s => 0 <? sign s)%Z). assert (yd := Yes (fun s => sign s <? 0)%Z).
  cbv beta in *. destruct (existsb (fun sq => begins sq && (0 <? sign (fst sq)))%Z (start m));
    destruct (existsb (fun sq => begins sq && (sign (fst sq) <? 0))%Z (start m));
    cbn [negb andb]; intro X; try discriminate.
  - right. left. destruct (yu eq_refl) as (s & B & e). apply Z.ltb_lt in e.
    split; [exists s; auto|]. split; [intros t T; specialize (nd eq_refl t T); lia|].
    unfold is_most in X. destruct v, (maximise m); try discriminate; reflexivity.
  - right. right. destruct (yd eq_refl) as (s & B & e). apply Z.ltb_lt in e.
    split; [exists s; auto|]. split; [intros t T; specialize (nu eq_refl t T); lia|].
    unfold is_least in X. destruct v, (maximise m); try discriminate; reflexivity.
  - left. split; [|now apply is_mean_ok]. intros s B. specialize (nu eq_refl s B).
    specialize (nd eq_refl s B). lia.
Qed.

(* ---- uniqueness -----------------------------------------------------------------------------
  *)

Lemma apart_trans p q s : apart (p, q) = true -> apart (q, s) = true -> apart (p, s) = true.
Proof. unfold apart. rewrite !Z.ltb_lt. lia. Qed.
Lemma apart_once l : forallb apart (combine l (tl l)) = true ->
  forall p q, In p l -> In q l -> state p = state q -> p = q.
Proof.
  destruct l as [|x l]; [easy|]. cbn [tl]. revert x.
  induction l as [|y l IH]; intros x H p q Ip Iq E.
  - destruct Ip as [<-|[]], Iq as [<-|[]]. reflexivity.
  - destruct (neighbours apart apart_trans _ _ H) as [B N].
    destruct Ip as [<-|Ip], Iq as [<-|Iq]; [reflexivity| | |now apply (IH y)].
    + specialize (B q Iq). unfold apart in B. reflect. lia.
    + specialize (B p Ip). unfold apart in B. reflect. lia.
Qed.

Lemma find_pair_ok m s a p : find_pair m s a = Some p -> In p (pairs m) /\ state p = s /\
  action p = a.
Proof.
  unfold find_pair. intro F. apply find_some in F. destruct F as [I F]. split_and. reflect.
  auto.
Qed.

(* From a state of the way, optimal pairs reach the target. *)
Lemma target_reached_ok m c hs : target_reached m c hs = true -> well_formed m ->
  reached m (fun p => optimal m c p = true) (target hs).
Proof.
  intros X wf. unfold target_reached in X. rewrite !andb_true_iff in X. destruct X as [[P B] F].
  rewrite forallb_forall in F.
  assert (go : forall k s, (Z.to_nat (toward hs s) <= k)%nat -> on_way hs s = true ->
    is_state m s -> reached m (fun p => optimal m c p = true) s ->
    reached m (fun p => optimal m c p = true) (target hs)).
  { induction k as [|k IH]; intros s Lk W S R;
      destruct (policy_pair m (along hs) s P S) as (p & I & <- & T); specialize (F p I);
      cbv beta in F; rewrite W, T in F; cbn [andb negb orb] in F; unfold leads_on in F;
      unfold on_way in W; reflect;
      (destruct (Z.eqb_spec (toward hs (state p)) 0) as [Z0|Z0]; [reflect; now rewrite <- F|]).
    - lia.
    - apply andb_true_iff in F. destruct F as [O Fa]. unfold falls, some_next in Fa.
      apply existsb_exists in Fa. destruct Fa as (o & Io & Fa). apply andb_true_iff in Fa.
      destruct Fa as [Lo Wo]. apply Z.ltb_lt in Lo. apply (IH (next o)).
      + unfold on_way in Wo. reflect. lia.
      + exact Wo.
      + destruct (wf_rows m wf p I) as (_ & _ & _ & N). now apply N.
      + now apply by_pair with p. }
  apply existsb_exists in B. destruct B as ([s q] & I & B). apply andb_true_iff in B.
  destruct B as [B W]. cbn [fst] in W. apply (go _ s (le_n _) W).
  - destruct (wf_start m wf) as [_ D]. now apply (D s q).
  - apply at_start. exists q. split; [exact I|]. now apply (may_begin_ok m s q wf).
Qed.

Lemma unique_ok m c hs (is_unique : bool) : model_right m hs = true ->
  (if is_unique then one_each m c hs else two_somewhere m c hs) = true ->
  one_optimum m (fun p => optimal m c p = true) is_unique.
Proof.
  intros M X. pose proof (model_right_ok m hs M) as [wf en]. unfold one_optimum.
  destruct is_unique.
  - unfold one_each in X. rewrite !andb_true_iff in X. destruct X as [[S C] O].
    rewrite forallb_forall in S, C.
    assert (R : forall s, reached m (fun p => optimal m c p = true) s -> reach hs s = true).
    { intros s Rs. induction Rs as [s (q & I & q0)|p o Rs IH I Op Io].
      - specialize (S (s, q) I). rewrite (begins_ok s q q0) in S. exact S.
      - specialize (C p I). cbv beta in C. rewrite IH, Op in C. cbn [andb negb orb] in C.
        unfold all_next in C. rewrite forallb_forall in C. now apply C. }
    intros s Rs. destruct (ends hs s) eqn:e; [left; now apply en|right].
    intros p q Ip Iq Es Et Op Oq. apply (apart_once _ O); [| |congruence].
    + apply filter_In. split; [exact Ip|]. unfold matters. now rewrite Es, (R s Rs), e, Op.
    + apply filter_In. split; [exact Iq|]. unfold matters. now rewrite Et, (R s Rs), e, Oq.
  - unfold two_somewhere in X. rewrite !andb_true_iff in X.
    destruct X as [[[[R D] O1] O2] Lv]. apply target_reached_ok in R; [|exact wf].
    set (s := target hs) in *.
    unfold optimal_at in O1, O2. unfold leaves in Lv.
    destruct (find_pair m s (first hs)) as [p|] eqn:A1; [|discriminate].
    destruct (find_pair m s (second hs)) as [q|] eqn:A2; [|discriminate].
    destruct (find_pair m s (leaving hs)) as [l|] eqn:A3; [|discriminate].
    apply find_pair_ok in A1, A2, A3. destruct A1 as (I1 & S1 & E1), A2 as (I2 & S2 & E2),
      A3 as (I3 & S3 & _). exists s, p, q. repeat (split; [assumption || auto|]).
    + intro En. specialize (En l I3 S3). rewrite <- S3 in En.
      apply negb_true_iff in Lv. rewrite (proj2 (stays_ok m l (wf_rows m wf l I3)) En) in Lv.
      discriminate.
    + repeat (split; [assumption|]). apply negb_true_iff, Z.eqb_neq in D. congruence.
Qed.
