(* What the integers of the checker mean in rationals, and what its tests of the model,
  of the policy
   and of levels show. *)
From Coq Require Import ZArith QArith Qreduction Qfield List Bool Lqa Lia.
From MDP Require Import Spec Checker Arith.
Import ListNotations.
Open Scope Q_scope.

(* ---- ratios ---------------------------------------------------------------------------------
  *)

Definition quotient (x : ratio) : Q := inject_Z (fst x) / inject_Z (snd x).
Definition positive (x : ratio) : Prop := (0 < snd x)%Z.

Lemma inject_nz z : (0 < z)%Z -> ~ inject_Z z == 0.
Proof. intro H. apply inject_pos in H. lra. Qed.

Lemma Q_num q : inject_Z (Qnum q) == q * inject_Z (Zpos (Qden q)).
Proof.
  destruct q as [n d]. cbn [Qnum Qden]. rewrite (Qmake_Qdiv n d). field. now apply inject_nz.
Qed.
Lemma ratio_of_ok q : positive (ratio_of q) /\ quotient (ratio_of q) == q.
Proof.
  destruct q as [n d]. unfold positive, quotient, ratio_of. cbn [fst snd Qnum Qden].
  split; [lia|]. now rewrite <- Qmake_Qdiv.
Qed.
Lemma quotient_top x z : positive x -> quotient x == z -> inject_Z (fst x) == inject_Z (snd x)
  * z.
Proof.
  unfold positive, quotient. intros P H. apply inject_pos in P. rewrite <- H. field. lra.
Qed.
Lemma is_one_ok q : is_one q = true <-> q == 1.
Proof. unfold is_one, Qeq. destruct q as [n d]. cbn. rewrite Z.eqb_eq. lia. Qed.
Lemma Qnum_nneg q : (0 <= Qnum q)%Z <-> 0 <= q.
Proof. unfold Qle. destruct q as [n d]. cbn. lia. Qed.
Lemma Qnum_zero q : Qnum q = 0%Z <-> q == 0.
Proof. unfold Qeq. destruct q as [n d]. cbn. lia. Qed.

(* A term is added as it is to rationals. *)
Lemma add_term_ok sum term : positive sum -> positive (snd term) ->
  positive (add_term sum term) /\
  quotient (add_term sum term) == quotient sum + inject_Z (fst term) * quotient (snd term).
Proof.
  destruct sum as [top below], term as [times [t b]]. unfold positive, quotient, add_term.
  cbn [fst snd]. intros B Bt. destruct (Z.eqb_spec b below) as [->|_]; cbn [fst snd].
  - split; [exact B|]. rewrite inject_Z_plus, inject_Z_mult. field. now apply inject_nz.
  - set (u := Z.lcm below b). set (k := (u / below)%Z). set (k' := (u / b)%Z).
    assert (U : (0 < u)%Z).
    { assert (0 <= u)%Z by apply Z.lcm_nonneg. assert (u <> 0)%Z; [|lia].
      intro U0. apply Z.lcm_eq_0 in U0. lia. }
    assert (K : u = (below * k)%Z).
    { unfold k. destruct (Z.divide_lcm_l below b) as [q D]. fold u in D.
      rewrite D, Z.div_mul by lia. ring. }
    assert (K' : u = (b * k')%Z).
    { unfold k'. destruct (Z.divide_lcm_r below b) as [q D]. fold u in D.
      rewrite D, Z.div_mul by lia. ring. }
    assert (k0 : (0 < k)%Z) by nia. assert (k0' : (0 < k')%Z) by nia.
    split; [exact U|]. rewrite inject_Z_plus.
    setoid_replace ((inject_Z (top * k) + inject_Z (times * t * k')) / inject_Z u) with
      (inject_Z (top * k) / inject_Z u + inject_Z (times * t * k') / inject_Z u)
      by (field; now apply inject_nz).
    rewrite K at 1. rewrite K'. rewrite !inject_Z_mult. field.
    repeat split; apply inject_nz; assumption.
Qed.
Lemma sum_of_ok l : (forall term, In term l -> positive (snd term)) ->
  positive (sum_of l) /\
  quotient (sum_of l) == sumQ (fun term => inject_Z (fst term) * quotient (snd term)) l.
Proof.
  assert (F : forall l sum, positive sum -> (forall term, In term l -> positive (snd term)) ->
    positive (fold_left add_term l sum) /\
    quotient (fold_left add_term l sum) ==
      quotient sum + sumQ (fun term => inject_Z (fst term) * quotient (snd term)) l).
  { clear l. induction l as [|x l IH]; intros sum B H; cbn [fold_left sumQ].
    - split; [exact B|lra].
    - destruct (add_term_ok sum x B (H x (or_introl eq_refl))) as [P V].
      destruct (IH _ P (fun y I => H y (or_intror I))) as [P' V'].
      split; [exact P'|]. rewrite V', V. ring. }
  intro H. destruct (F l (0, 1)%Z ltac:(reflexivity) H) as [P V]. split; [exact P|].
  unfold sum_of. rewrite V. unfold quotient at 1. cbn [fst snd].
  change (inject_Z 0) with 0. field.
Qed.

(* ---- the surplus ----------------------------------------------------------------------------
  *)

Definition level_pos (m : model) (x : level) := forall s, is_state m s -> (0 < snd (x s))%Z.

(* c + γ Σ p(s') x(s') - x(s) *)
Definition surplus_of (gamma c : Q) (p : pair) (x : Z -> Q) : Q :=
  c + gamma * mean p x - x (state p).

Lemma surplus_ok m gamma c p x : row_ok m p -> level_pos m x -> positive c ->
  exists K, 0 < K /\
    inject_Z (surplus gamma c p x) == K * surplus_of gamma (quotient c) p (value x).
Proof.
  intros R L c0. pose proof R as (Ss & D & _ & O). unfold surplus.
  set (scale := (Zpos (Qden gamma) * denominator p)%Z). set (ahead := map _ (outcomes p)).
  assert (scale0 : (0 < scale)%Z) by (unfold scale; lia).
  destruct (sum_of_ok ((- scale, x (state p))%Z :: ahead)) as [P V].
  { intros term [<-|I]; [now apply L|]. apply in_map_iff in I. destruct I as (o & <- & Io).
    apply L. now apply O. }
  destruct (sum_of ((- scale, x (state p))%Z :: ahead)) as [top below].
  assert (S : sumQ (fun term => inject_Z (fst term) * quotient (snd term)) ahead ==
    inject_Z scale * (gamma * mean p (value x))).
  { unfold ahead. rewrite sumQ_map. cbn [fst snd].
    rewrite (sumQ_ext _ (fun o => (inject_Z (Qnum gamma) * inject_Z (denominator p)) *
      (prob p o * value x (next o)))).
    - rewrite sumQ_times. fold (mean p (value x)). unfold scale. rewrite inject_Z_mult, Q_num.
      ring.
    - intros o _. change (value x (next o)) with (quotient (x (next o))).
      rewrite inject_Z_mult. unfold prob. field. apply inject_pos in D. lra. }
  cbn [sumQ fst snd] in V. rewrite S in V. change (quotient (x (state p))) with
    (value x (state p)) in V.
  assert (T := quotient_top _ _ P V). cbn [fst snd] in T, P. unfold positive in P, c0.
  cbn [snd] in P. exists (inject_Z (snd c) * inject_Z scale * inject_Z below).
  apply inject_pos in c0, scale0, P. split.
  - apply Qmult_lt_0_compat; [apply Qmult_lt_0_compat|]; assumption.
  - rewrite inject_Z_plus, !inject_Z_mult, T, inject_Z_opp. unfold surplus_of, quotient.
    field. lra.
Qed.

(* The integer has the sign of the surplus. *)
Section Sign.
  Variables (m : model) (gamma q : Q) (c : ratio) (p : pair) (x : level).
  Hypotheses (R : row_ok m p) (L : level_pos m x) (c0 : positive c) (cq : quotient c == q).
  Lemma surplus_value : exists K, 0 < K /\
    inject_Z (surplus gamma c p x) == K * surplus_of gamma q p (value x).
  Proof.
    destruct (surplus_ok m gamma c p x R L c0) as (K & K0 & H). exists K. split; [exact K0|].
    rewrite H. unfold surplus_of. now rewrite cq.
  Qed.
  Lemma surplus_le : (surplus gamma c p x <= 0)%Z -> surplus_of gamma q p (value x) <= 0.
  Proof.
    destruct surplus_value as (K & K0 & H). intro G. rewrite Zle_Qle, H in G.
    change (inject_Z 0) with 0 in G. nra.
  Qed.
  Lemma surplus_ge : (0 <= surplus gamma c p x)%Z -> 0 <= surplus_of gamma q p (value x).
  Proof.
    destruct surplus_value as (K & K0 & H). intro G. rewrite Zle_Qle, H in G.
    change (inject_Z 0) with 0 in G. nra.
  Qed.
  Lemma surplus_lt : (surplus gamma c p x < 0)%Z -> surplus_of gamma q p (value x) < 0.
  Proof.
    destruct surplus_value as (K & K0 & H). intro G. rewrite Zlt_Qlt, H in G.
    change (inject_Z 0) with 0 in G. nra.
  Qed.
  Lemma surplus_gt : (0 < surplus gamma c p x)%Z -> 0 < surplus_of gamma q p (value x).
  Proof.
    destruct surplus_value as (K & K0 & H). intro G. rewrite Zlt_Qlt, H in G.
    change (inject_Z 0) with 0 in G. nra.
  Qed.
  Lemma surplus_eq : surplus gamma c p x = 0%Z <-> surplus_of gamma q p (value x) == 0.
  Proof.
    split; intro G.
    - apply Qle_antisym; [apply surplus_le|apply surplus_ge]; lia.
    - destruct surplus_value as (K & K0 & H). rewrite G in H. unfold Qeq in H. cbn in H. nia.
  Qed.
End Sign.

(* ---- rewards --------------------------------------------------------------------------------
  *)

Lemma reward_sum_ok p : (0 < denominator p)%Z -> positive (reward_sum p) /\
  quotient (reward_sum p) == inject_Z (denominator p) * mean_reward p.
Proof.
  intro D. unfold reward_sum. set (l := map _ (outcomes p)). destruct (sum_of_ok l) as [P V].
  { intros term I. apply in_map_iff in I. destruct I as (o & <- & _). apply ratio_of_ok. }
  split; [exact P|]. rewrite V. unfold l, mean_reward, prob. rewrite sumQ_map, <- sumQ_times.
  apply sumQ_ext. intros o _. cbn [fst snd]. destruct (ratio_of_ok (reward o)) as [_ ->].
  field. now apply inject_nz.
Qed.
Lemma signed_ok m x q : inject_Z x == q -> inject_Z (signed m x) == if maximise m then q else - q.
Proof. intro H. unfold signed. destruct (maximise m); [|rewrite inject_Z_opp]; now rewrite H. Qed.
Lemma earned_ok m p : (0 < denominator p)%Z ->
  positive (earned m p) /\ quotient (earned m p) == r m p.
Proof.
  intro D. unfold earned, r. destruct (reward_sum_ok p D) as [P V].
  assert (T := quotient_top _ _ P V). destruct (reward_sum p) as [top below].
  unfold positive, quotient in *. cbn [fst snd] in *. split; [lia|].
  rewrite (signed_ok _ _ _ T), inject_Z_mult. apply inject_pos in P, D.
  destruct (maximise m); field; lra.
Qed.
Lemma stays_ok m p : row_ok m p ->
  stays p = true <-> mean_reward p == 0 /\ forall o, In o (outcomes p) -> next o = state p.
Proof.
  intros (_ & D & _). unfold stays. destruct (reward_sum_ok p D) as [P V].
  assert (T := quotient_top _ _ P V). unfold positive in P. apply inject_pos in P, D.
  rewrite andb_true_iff, Z.eqb_eq, forallb_forall. split; intros [H N]; split.
  - rewrite H in T. change (inject_Z 0) with 0 in T.
    destruct (Qmult_integral _ _ (Qeq_sym _ _ T)) as [Z|Z]; [lra|].
    destruct (Qmult_integral _ _ Z); lra.
  - intros o I. apply Z.eqb_eq. now apply N.
  - rewrite H in T. assert (Z : inject_Z (fst (reward_sum p)) == 0) by (rewrite T; ring).
    unfold Qeq in Z. cbn in Z. lia.
  - intros o I. apply Z.eqb_eq. now apply N.
Qed.

(* ---- the model ------------------------------------------------------------------------------
  *)

Ltac split_and := repeat match goal with
  | H : (_ && _)%bool = true |- _ => apply andb_true_iff in H; destruct H end.
Ltac reflect := repeat match goal with
  | H : (_ <=? _)%Z = true |- _ => apply Z.leb_le in H
  | H : (_ <? _)%Z = true |- _ => apply Z.ltb_lt in H
  | H : (_ =? _)%Z = true |- _ => apply Z.eqb_eq in H
  | H : forallb _ _ = true |- _ => rewrite forallb_forall in H end.

Lemma in_range_ok m s : in_range m s = true <-> is_state m s.
Proof. unfold in_range, is_state. rewrite andb_true_iff, Z.leb_le, Z.ltb_lt. tauto. Qed.
Lemma fold_add l : forall sum, fold_left Z.add l sum = (sum + fold_left Z.add l 0)%Z.
Proof.
  induction l as [|x l IH]; intro sum; cbn [fold_left]; [lia|]. rewrite IH, (IH (0 + x)%Z). lia.
Qed.
Lemma sumZ_fold {A} (f : A -> Z) l : fold_left Z.add (map f l) 0%Z = sumZ f l.
Proof.
  induction l as [|x l IH]; [reflexivity|]. cbn [map fold_left sumZ]. rewrite fold_add, IH. lia.
Qed.
Lemma row_right_ok m p : row_right m p = true -> row_ok m p.
Proof.
  unfold row_right, row_ok.
  rewrite !andb_true_iff, in_range_ok, Z.ltb_lt, Z.eqb_eq, sumZ_fold, forallb_forall.
  intros [[[S D] W] O]. repeat (split; [assumption|]). intros o I. specialize (O o I).
  now rewrite andb_true_iff, in_range_ok, Z.ltb_lt in O.
Qed.

(* If neighbours of a list are in a transitive relation, then so are all that follow each other.
*)
Section Neighbours.
  Context {A : Type} (rel : A * A -> bool).
  Hypothesis trans : forall x y z, rel (x, y) = true -> rel (y, z) = true -> rel (x, z) = true.
  Lemma neighbours l : forall x, forallb rel (combine (x :: l) l) = true ->
    (forall y, In y l -> rel (x, y) = true) /\
    match l with [] => True | y :: l => forallb rel (combine (y :: l) l) = true end.
  Proof.
    induction l as [|y l IH]; intros x H; [easy|]. cbn [combine forallb] in H.
    apply andb_true_iff in H. destruct H as [H1 H2]. destruct (IH y H2) as [H3 _].
    split; [|exact H2]. intros z [<-|I]; [exact H1|]. now apply trans with y, H3.
  Qed.
End Neighbours.
Lemma before_trans p q s :
  before (p, q) = true -> before (q, s) = true -> before (p, s) = true.
Proof.
  unfold before. rewrite !orb_true_iff, !andb_true_iff, !Z.ltb_lt, !Z.eqb_eq. lia.
Qed.
Lemma in_order_once l : in_order l = true -> NoDup (map (fun p => (state p, action p)) l).
Proof.
  unfold in_order. destruct l as [|p l]; [constructor|]. cbn [tl]. revert p.
  induction l as [|q l IH]; intros p H; (constructor; [|]); try constructor; try easy.
  - intro I'. assert (I : In (state p, action p) (map (fun p => (state p, action p)) (q :: l)))
      by exact I'.
    apply in_map_iff in I. destruct I as (s & Es & I).
    destruct (neighbours before before_trans _ _ H) as [B _]. specialize (B s I).
    unfold before in B. inversion Es as [[E1 E2]].
    rewrite orb_true_iff, andb_true_iff, !Z.ltb_lt, Z.eqb_eq in B. lia.
  - destruct (neighbours before before_trans _ _ H) as [_ N]. specialize (IH q N).
    now inversion IH.
  - destruct (neighbours before before_trans _ _ H) as [_ N]. specialize (IH q N).
    now inversion IH.
Qed.

Record good (m : model) (hs : hints) : Prop := {
  wf : well_formed m;
  ends_ok : forall s, ends hs s = true -> is_end m s }.
Lemma model_right_ok m hs : model_right m hs = true -> good m hs.
Proof.
  unfold model_right. intro H. split_and. reflect. rename H2 into St, H1 into Go, H0 into En.
  assert (rows : forall p, In p (pairs m) -> row_ok m p) by (intros; apply row_right_ok; auto).
  assert (of : forall (f : Z -> bool),
    (forall p, In p (pairs m) -> negb (f (state p)) || stays p = true) ->
    forall s, f s = true -> is_end m s).
  { intros f F s fs p I <-. specialize (F p I). rewrite fs in F. cbn in F.
    apply (stays_ok m p); auto. }
  split; [split|]; auto.
  - unfold Qle. cbn. lia.
  - now apply in_order_once.
  - unfold start_right in St. set (l := map _ (start m)) in St. destruct (sum_of_ok l) as [P V].
    { intros term I. apply in_map_iff in I. destruct I as (sq & <- & _). apply ratio_of_ok. }
    destruct (sum_of l) as [top below]. apply andb_true_iff in St.
      destruct St as [Eq St]. reflect. subst top. split.
    + unfold l in V. rewrite sumQ_map in V.
      rewrite (sumQ_ext snd (fun sq : Z * Q => inject_Z 1 * quotient (ratio_of (snd sq)))).
      * unfold positive in P. cbn [fst snd] in V, P. rewrite <- V. unfold quotient.
        cbn [fst snd]. field.
        now apply inject_nz.
      * intros sq _. destruct (ratio_of_ok (snd sq)) as [_ ->]. change (inject_Z 1) with 1. ring.
    + intros s q I. specialize (St (s, q) I). cbn [fst snd] in St. split_and. reflect.
      rewrite in_range_ok in *. split; [assumption|]. now apply Qnum_nneg.
  - intros g G. unfold goal_right in Go. rewrite G in Go. split_and. reflect.
    rewrite is_one_ok in *. split; [assumption|]. intros s _. now apply of.
  - now apply of.
Qed.

(* ---- the policy -----------------------------------------------------------------------------
  *)

Lemma count_ok l : forall i right n, fold_left count l (i, right) = (n, true) ->
  right = true /\ forall s, (i <= s < n)%Z -> In s l.
Proof.
  induction l as [|x l IH]; intros i right n H; cbn [fold_left] in H.
  - inversion H. split; [reflexivity|]. intros s S. lia.
  - cbn [count] in H. destruct (IH _ _ _ H) as [R All]. split_and. reflect. subst x.
    split; [reflexivity || assumption|]. intros s S.
    destruct (Z.eq_dec s i) as [->|]; [now left|]. right. apply All. lia.
Qed.
Lemma policy_pair m a s : policy_right m a = true -> is_state m s ->
  exists p, In p (pairs m) /\ state p = s /\ taken a p = true.
Proof.
  unfold policy_right. intros H S. destruct (fold_left _ _ _) as [n right] eqn:F.
  apply andb_true_iff in H. destruct H as [-> H]. apply Z.eqb_eq in H. subst n.
  destruct (count_ok _ _ _ _ F) as [_ All]. specialize (All s S). apply in_map_iff in All.
  destruct All as (p & <- & I). apply filter_In in I. exists p. tauto.
Qed.
Lemma stationary_plays m a : policy_right m a = true -> plays m (fun p => taken a p = true)
  (stationary m a).
Proof.
  intros H h s S. unfold stationary.
  destruct (find _ (pairs m)) as [p|] eqn:F.
  - apply find_some in F. destruct F as [I F]. split_and. reflect. split; [|cbn; lra].
    intros p' q' [Eq|[]]. inversion Eq. subst p' q'. repeat split; try assumption; [lra|].
    unfold taken. apply Z.eqb_eq. congruence.
  - exfalso. destruct (policy_pair m a s H S) as (p & I & Es & T).
    apply (find_none _ _ F) in I. unfold taken in T. rewrite Z.eqb_eq in T. subst s.
    rewrite Z.eqb_refl in I. cbn in I. rewrite T, Z.eqb_refl in I. discriminate.
Qed.
Lemma plays_valid m D pi : plays m D pi -> valid m pi.
Proof.
  intros P h s S. destruct (P h s S) as [H S1]. split; [|exact S1]. intros p q I.
  destruct (H p q I) as (? & ? & ? & _). auto.
Qed.
Lemma level_right_ok m a x : policy_right m a = true -> level_right m x = true -> level_pos m x.
Proof.
  unfold level_right. intros Hp H s S. reflect.
  destruct (policy_pair m a s Hp S) as (p & I & <- & _).
  specialize (H p I). now reflect.
Qed.
Lemma rank_right_ok m a rk : policy_right m a = true -> rank_right m rk = true -> forall s,
  is_state m s -> (0 <= rk s)%Z.
Proof.
  unfold rank_right. intros Hp H s S. reflect.
  destruct (policy_pair m a s Hp S) as (p & I & <- & _).
  specialize (H p I). now reflect.
Qed.
