(* Fronts of two objectives: vertices are attained,
  and between two corners with a common vertex no
   policy is beyond it, because what a policy has by weights is linear in the weights. *)
From Coq Require Import ZArith QArith Qreduction Qfield List Bool Lqa Lia.
From MDP Require Import Spec Checker Claims Arith Integers Start Bellman Goals.
From MDP Require Import LimitsChecker LimitsClaims LimitsProof FrontsChecker FrontsClaims.
Import ListNotations.
Open Scope Q_scope.

Lemma rest_of_ok q : rest_of q == 1 - q.
Proof.
  unfold rest_of. destruct q as [n d]. cbn [Qnum Qden]. rewrite !Qmake_Qdiv.
  unfold Z.sub. rewrite inject_Z_plus, inject_Z_opp. field. now apply inject_nz.
Qed.
Lemma rising_ok k k' : rising (k, k') = true -> share k < share k'.
Proof. unfold rising, Qlt. apply Z.ltb_lt. Qed.
Lemma rising_trans x y z : rising (x, y) = true -> rising (y, z) = true -> rising (x, z) = true.
Proof.
  intros A B. apply rising_ok in A, B. unfold rising. apply Z.ltb_lt.
  assert (C : share x < share z) by lra. exact C.
Qed.

(* Of corners that rise from 0 to 1, two neighbours are around each weight. *)
Lemma between_neighbours rel w l : forall x,
  forallb rising (combine (x :: l) l) = true -> forallb rel (combine (x :: l) l) = true ->
  share x <= w -> (exists y, In y l /\ w <= share y) ->
  exists k k', In k (x :: l) /\ In k' l /\ rel (k, k') = true /\ share k < share k' /\
    share k <= w <= share k'.
Proof.
  induction l as [|y l IH]; intros x R S Lo (z & I & Hi); [easy|].
  cbn [combine forallb] in R, S. apply andb_true_iff in R, S.
  destruct R as [R1 R2], S as [S1 S2]. destruct (Qlt_le_dec (share y) w) as [L|L].
  - destruct (IH y R2 S2 ltac:(lra)) as (k & k' & Ik & Ik' & X).
    { destruct I as [<-|I]; [lra|]. exists z. auto. }
    exists k, k'. split; [now right|]. split; [now right|exact X].
  - exists x, y. split; [now left|]. split; [now left|]. split; [exact S1|].
    split; [now apply rising_ok|lra].
Qed.

Section Front.
  Variables (m : model) (f : front) (hs : hints).
  Hypothesis X : check_front m f hs = true.

  Lemma front_parts : model_right m hs = true /\
    (forall v, In v (vertices f) -> vertex_right m hs f v = true) /\
    (forall k, In k (corners f) -> corner_right m hs f k = true) /\ covering m f = true.
  Proof.
    pose proof X as Y. unfold check_front in Y. rewrite !andb_true_iff, !forallb_forall in Y.
    tauto.
  Qed.
  Let M : model_right m hs = true. Proof. apply front_parts. Qed.
  Lemma f_wf : well_formed m. Proof. exact (l_wf m hs M). Qed.

  (* No policy exceeds the values of a corner. *)
  Lemma corner_bound k : In k (corners f) -> exists lam C, 0 <= lam < 1 /\ 0 <= C /\
    forall pi n, valid m pi ->
      share k * total m (objective (first_count f)) pi n +
      (1 - share k) * total m (objective (second_count f)) pi n <=
      sumQ (fun sq => snd sq * value (most k) (fst sq)) (start m) + pow lam n * C.
  Proof.
    intro I. destruct front_parts as (_ & _ & K & _). specialize (K k I).
    unfold corner_right in K.
    apply andb_true_iff in K. destruct K as [_ D].
    destruct (dual_bound m hs _ M D) as (lam & C & L & C0 & B). exists lam, C.
    split; [exact L|]. split; [exact C0|]. intros pi n va. specialize (B pi n va).
    cbn [weighted feasible dual] in B.
    rewrite (total_sum m pi (fun _ => 0) (limits (weighted f k)) n) in B.
    assert (Z0 : total m (fun _ => 0) pi n == 0).
    { unfold total. apply sumQ_zero. intros sq _. rewrite run_zero. ring. }
    rewrite Z0 in B. set (t1 := total m (objective (first_count f)) pi n).
    set (t2 := total m (objective (second_count f)) pi n).
    change (sumQ (fun l => price l * total m (amount l) pi n) (limits (weighted f k))) with
      (share k * t1 + (rest_of (share k) * t2 + 0)) in B.
    assert (Re : rest_of (share k) * t2 == (1 - share k) * t2) by (rewrite rest_of_ok;
      reflexivity).
    lra.
  Qed.
  Lemma corner_level k : In k (corners f) -> level_pos m (most k).
  Proof.
    intro I. destruct front_parts as (_ & _ & K & _). specialize (K k I).
    unfold corner_right in K.
    apply andb_true_iff in K. destruct K as [_ D]. exact (l_dual m hs _ D).
  Qed.
  Lemma start_term_ok x : level_pos m x ->
    positive (sum_of (map (start_term x) (start m))) /\
    quotient (sum_of (map (start_term x) (start m))) ==
      sumQ (fun sq => snd sq * value x (fst sq)) (start m).
  Proof.
    intro L. destruct (wf_start m f_wf) as [_ D].
    destruct (sum_of_ok (map (start_term x) (start m))) as [S E].
    { intros t I. apply in_map_iff in I. destruct I as ([s q] & <- & I).
      pose proof (L s (proj1 (D s q I))) as B. unfold start_term, positive. cbn [fst snd].
      destruct (x s) as [t b]. cbn [fst snd] in *. now apply Z.mul_pos_pos. }
    split; [exact S|]. rewrite E, sumQ_map. apply sumQ_ext. intros [s q] I.
    pose proof (L s (proj1 (D s q I))) as B. unfold start_term, value, quotient. cbn [fst snd].
    destruct (x s) as [t b]. cbn [fst snd] in *. rewrite inject_Z_mult, Q_num. field.
    split; apply inject_nz; [exact B|lia].
  Qed.
  Lemma attained_ok k v : In k (corners f) -> attained m k v = true ->
    sumQ (fun sq => snd sq * value (most k) (fst sq)) (start m) <=
    share k * first_total v + (1 - share k) * second_total v.
  Proof.
    intros I A. unfold attained in A. cbv zeta in A. apply Z.leb_le in A.
    destruct (start_term_ok _ (corner_level k I)) as [S1 E1].
    destruct (ratio_of_ok (first_total v)) as [a0 aq].
    destruct (ratio_of_ok (second_total v)) as [b0 bq].
    destruct (priced_ok _ (share k) a0) as [P1 Q1].
    destruct (priced_ok _ (rest_of (share k)) b0) as [P2 Q2].
    destruct (sum_of_ok [(-1, sum_of (map (start_term (most k)) (start m)));
      priced (ratio_of (first_total v)) (share k);
      priced (ratio_of (second_total v)) (rest_of (share k))]%Z) as [S E].
    { intros t [<-|[<-|[<-|[]]]]; assumption. }
    pose proof (nneg_quotient _ S A) as N. rewrite E in N. cbn [sumQ fst snd] in N.
    rewrite E1 in N. rewrite Q1, Q2, aq, bq, rest_of_ok in N.
    change (inject_Z (-1)) with (-1) in N. lra.
  Qed.

  (* Between two neighbours, the common vertex is as good as any policy. *)
  Lemma covered w : 0 <= w <= 1 -> exists v, In v (vertices f) /\
    forall pi, valid m pi -> in_the_limit (fun eps n =>
      w * total m (objective (first_count f)) pi n + (1 - w)
        * total m (objective (second_count f)) pi n
      <= w * first_total v + (1 - w) * second_total v + eps).
  Proof.
    intros [w0 w1]. destruct front_parts as (_ & _ & _ & Co). unfold covering in Co.
    rewrite !andb_true_iff in Co. destruct Co as [[[Lo Hi] Ri] Me].
    apply existsb_exists in Lo, Hi. destruct Lo as (a & Ia & A). destruct Hi as (b & Ib & B).
    apply Z.eqb_eq, Qnum_zero in A. apply is_one_ok in B.
    destruct (corners f) as [|x l] eqn:Cs; [easy|]. cbn [tl] in Ri, Me.
    assert (xa : share x <= share a).
    { destruct Ia as [<-|Ia]; [lra|]. destruct (neighbours rising rising_trans l x Ri) as [N _].
      specialize (N a Ia). apply rising_ok in N. lra. }
    assert (far : exists y, In y l /\ w <= share y).
    { destruct Ib as [<-|Ib]; [exfalso; lra|]. exists b. split; [exact Ib|lra]. }
    destruct (between_neighbours (meeting m f) w l x Ri Me ltac:(lra) far)
      as (k & k' & Ik & Ik' & Mt & Lt & [K1 K2]).
    rewrite <- Cs in Ik. assert (Jk : In k' (corners f)) by (rewrite Cs; now right).
    unfold meeting in Mt. apply existsb_exists in Mt. destruct Mt as (v & Iv & T).
    apply andb_true_iff in T. destruct T as [T1 T2]. exists v. split; [exact Iv|].
    apply (attained_ok k v Ik) in T1. apply (attained_ok k' v Jk) in T2.
    destruct (corner_bound k Ik) as (l1 & C1 & L1 & C10 & B1).
    destruct (corner_bound k' Jk) as (l2 & C2 & L2 & C20 & B2).
    intros pi va eps e0. destruct (pow_vanishes l1 C1 eps L1 C10 e0) as [N1 H1].
    destruct (pow_vanishes l2 C2 eps L2 C20 e0) as [N2 H2]. exists (N1 + N2)%nat. intros n Ln.
    specialize (H1 n ltac:(lia)). specialize (H2 n ltac:(lia)).
    specialize (B1 pi n va). specialize (B2 pi n va).
    set (t1 := total m (objective (first_count f)) pi n) in *.
    set (t2 := total m (objective (second_count f)) pi n) in *.
    set (s := share k) in *. set (s' := share k') in *.
    assert (D1 : s * t1 + (1 - s) * t2 <= s * first_total v + (1 - s) * second_total v + eps)
      by lra.
    assert (D2 : s' * t1 + (1 - s') * t2 <= s' * first_total v + (1 - s') * second_total v + eps)
      by lra.
    set (d := first_total v - t1) in *. set (e := second_total v - t2) in *.
    assert (G1 : 0 <= s * d + (1 - s) * e + eps) by (unfold d, e; lra).
    assert (G2 : 0 <= s' * d + (1 - s') * e + eps) by (unfold d, e; lra).
    assert (G : 0 <= (s' - s) * (w * d + (1 - w) * e + eps)).
    { setoid_replace ((s' - s) * (w * d + (1 - w) * e + eps)) with
        ((s' - w) * (s * d + (1 - s) * e + eps) + (w - s) * (s' * d + (1 - s') * e + eps))
          by ring.
      assert (0 <= (s' - w) * (s * d + (1 - s) * e + eps)) by (apply Qmult_le_0_compat; lra).
      assert (0 <= (w - s) * (s' * d + (1 - s') * e + eps)) by (apply Qmult_le_0_compat; lra).
      lra. }
    assert (0 <= w * d + (1 - w) * e + eps).
    { destruct (Qlt_le_dec (w * d + (1 - w) * e + eps) 0) as [Bad|Ok]; [exfalso|exact Ok].
      assert (0 < (s' - s) * - (w * d + (1 - w) * e + eps)) by (apply Qmult_lt_0_compat; lra).
      lra. }
    unfold d, e in *. lra.
  Qed.

  (* A policy whose equations values solve earns these values. *)
  Lemma values_attained act c x q : policy_right m act = true -> level_right m x = true ->
    (forall p, In p (pairs m) -> ends hs (state p) = true -> objective c p == 0) ->
    (forall p, In p (pairs m) -> value_pair m hs act c x p = true) -> is_total m x q = true ->
    tends_to m c (stationary m act) q.
  Proof.
    intros P L ce Eq T. apply (level_right_ok m act _ P) in L.
    destruct front_parts as (_ & _ & K & Co). unfold covering in Co. rewrite !andb_true_iff in Co.
    destruct Co as [[[Lo _] _] _]. apply existsb_exists in Lo. destruct Lo as (k & Ik & _).
    specialize (K k Ik). unfold corner_right in K. apply andb_true_iff in K. destruct K as [_ D].
    destruct (end_potential m hs _ M D) as (lam & w & La & wb & w1 & step).
    destruct (bounded m (value x)) as (C & C0 & B). pose proof f_wf as wf.
    destruct (wf_discount m wf) as [g0 _]. pose proof (stationary_plays m act P) as pl.
    assert (end0 : forall s, is_state m s -> ends hs s = true -> value x s == 0).
    { intros s Ss E. destruct (policy_pair m act s P Ss) as (p & I & <- & Tk).
      specialize (Eq p I). unfold value_pair in Eq. rewrite Tk, E in Eq. cbn [negb] in Eq.
      apply Z.eqb_eq in Eq. apply zero_quotient; [|exact Eq]. now apply L. }
    assert (sur : forall p, In p (pairs m) -> taken act p = true ->
      surplus_of (discount m) (objective c p) p (value x) == 0).
    { intros p I Tk. pose proof (wf_rows m wf p I) as R. specialize (Eq p I).
      unfold value_pair in Eq. rewrite Tk in Eq. cbn [negb] in Eq.
      destruct (ends hs (state p)) eqn:E.
      - destruct (end_pair m hs _ M D p I E) as (_ & _ & S & _). unfold surplus_of.
        rewrite (ce p I E), (mean_ext p _ (fun _ => value x (state p)))
          by (intros o Io; now rewrite (S o Io)).
        rewrite (mean_const m p R), (end0 _ (proj1 R) E). ring.
      - apply Z.eqb_eq in Eq. destruct (ratio_of_ok (c (state p) (action p))) as [c0 cq].
        exact (proj1 (surplus_eq m _ _ _ p x R L c0 cq) Eq). }
    assert (near0 : forall s, is_state m s -> - (C * w s) <= value x s <= C * w s).
    { intros s Ss. specialize (B s Ss). specialize (wb s). destruct (ends hs s) eqn:E.
      - rewrite (end0 s Ss E). nra.
      - specialize (w1 s E). nra. }
    assert (each : forall n s, is_state m s ->
      value x s - pow lam n * C * w s <=
        run (objective c) (discount m) (fun _ => 0) (stationary m act) n [] s <=
      value x s + pow lam n * C * w s).
    { intros n s Ss. split.
      - apply (weighted_lower m (fun p => taken act p = true) (fun _ => True) (objective c)
          (discount m) lam C (fun _ => 0) w (value x) _ wf); auto; try lra.
        + intros p I Tk _. rewrite (sur p I Tk). lra.
        + intros t St _. specialize (near0 t St). lra.
      - apply (weighted_upper m (fun p => taken act p = true) (fun _ => True) (objective c)
          (discount m) lam C (fun _ => 0) w (value x) _ wf); auto; try lra.
        + intros p I Tk _. rewrite (sur p I Tk). lra.
        + intros t St _. specialize (near0 t St). lra. }
    destruct (start_term_ok x L) as [S1 E1].
    assert (Qt : q == sumQ (fun sq => snd sq * value x (fst sq)) (start m)).
    { unfold is_total in T. apply Z.eqb_eq in T. destruct (ratio_of_ok q) as [q0 qq].
      destruct (sum_of_ok [(1, sum_of (map (start_term x) (start m))); (-1, ratio_of q)]%Z)
        as [S E].
      { intros t [<-|[<-|[]]]; assumption. }
      pose proof (zero_quotient _ S T) as Z0. rewrite E in Z0. cbn [sumQ fst snd] in Z0.
      rewrite E1, qq in Z0. change (inject_Z 1) with 1 in Z0.
      change (inject_Z (-1)) with (-1) in Z0. lra. }
    assert (C2 : 0 <= 2 * C) by lra. destruct (wf_start m wf) as [One St].
    intros eps e0. destruct (pow_vanishes lam (2 * C) eps La C2 e0) as [N HN]. exists N.
    intros n Ln. specialize (HN n Ln). unfold total.
    assert (k0 : 0 <= pow lam n * C).
    { assert (0 <= pow lam n) by (apply pow_nneg; lra). nra. }
    assert (up : sumQ (fun sq => snd sq * run (objective c) (discount m) (fun _ => 0)
      (stationary m act) n [] (fst sq)) (start m) <=
      sumQ (fun sq => snd sq * value x (fst sq) + snd sq * (pow lam n * (2 * C))) (start m)).
    { apply sumQ_le. intros [s a] I. cbn [fst snd]. destruct (St s a I) as [Ss a0].
      destruct (each n s Ss) as [_ U]. specialize (wb s).
      assert (pow lam n * C * w s <= pow lam n * (2 * C)) by nra. nra. }
    assert (lo : sumQ (fun sq => snd sq * value x (fst sq)) (start m) <=
      sumQ (fun sq => snd sq * run (objective c) (discount m) (fun _ => 0)
      (stationary m act) n [] (fst sq) + snd sq * (pow lam n * (2 * C))) (start m)).
    { apply sumQ_le. intros [s a] I. cbn [fst snd]. destruct (St s a I) as [Ss a0].
      destruct (each n s Ss) as [U _]. specialize (wb s).
      assert (pow lam n * C * w s <= pow lam n * (2 * C)) by nra. nra. }
    rewrite sumQ_plus, sumQ_times_right, One in up, lo. lra.
  Qed.
End Front.

Theorem front_sound m f hs : check_front m f hs = true -> front_holds m f.
Proof.
  intro X. pose proof (front_parts m f hs X) as (M & Ve & K & Co).
  split; [exact (f_wf m f hs X)|]. split; [|exact (covered m f hs X)].
  intros v I. specialize (Ve v I). unfold vertex_right in Ve.
  rewrite !andb_true_iff, !forallb_forall in Ve.
  destruct Ve as [[[[[[P L1] L2] E1] E2] T1] T2].
  split; [exact (plays_valid m _ _ (stationary_plays m _ P))|].
  unfold covering in Co. rewrite !andb_true_iff in Co. destruct Co as [[[Lo _] _] _].
  apply existsb_exists in Lo. destruct Lo as (k & Ik & _). specialize (K k Ik).
  unfold corner_right in K. apply andb_true_iff in K. destruct K as [_ D].
  assert (at_end : forall l p, In l (limits (weighted f k)) -> In p (pairs m) ->
    ends hs (state p) = true -> amount l p == 0).
  { intros l p Il Ip E. destruct (end_pair m hs _ M D p Ip E) as (_ & A & _). now apply A. }
  split.
  - apply (values_attained m f hs X _ _ (first_value v)); auto. intros p Ip E.
    exact (at_end (Limit (first_count f) 0 (share k)) p (or_introl eq_refl) Ip E).
  - apply (values_attained m f hs X _ _ (second_value v)); auto. intros p Ip E.
    exact (at_end (Limit (second_count f) 0 (rest_of (share k)))
      p (or_intror (or_introl eq_refl)) Ip E).
Qed.
