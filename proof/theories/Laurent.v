(* Gain g, bias h and a third level w: average rewards, and totals at discount 1 as limits.

   Write d(x) = P x - x. With e = 1 - γ, i = 1 / e and j = 1 / γ let X = i g + j h + e j² w. Then

       r + γ P X - X = γ i d(g) + (r - g + d(h)) + e j (d(w) - h) - e² j² w,

   in which for γ near 1 each term is small beside the one before.
   So, if of each pair the first of
   the three that is not 0 is negative, then X and a term of order e bound discounted values. *)
From Coq Require Import ZArith QArith Qreduction Qabs Qfield List Bool Lqa Lia.
From MDP Require Import Spec Checker Arith Integers Bellman.
Import ListNotations.
Open Scope Q_scope.

Lemma absorb (x : Q) : exists B, 0 <= B /\ - B <= x <= B.
Proof.
  exists (Qabs x). pose proof (Qabs_nonneg x). pose proof (Qle_Qabs x).
  pose proof (Qle_Qabs (- x)).
  rewrite Qabs_opp in H1. lra.
Qed.

(* The first of three numbers that is not 0 is negative; and what holds of γ, e, i and j. *)
Definition lex (a b c : Q) : Prop := a < 0 \/ (a == 0 /\ (b < 0 \/ (b == 0 /\ c <= 0))).
Record near (de gamma e i j : Q) : Prop := {
  n_ga : gamma == 1 - e; n_e : 0 < e <= de; n_i : e * i == 1; n_j : gamma * j == 1; n_de :
    0 < de <= 1 # 2 }.
Lemma near_j de gamma e i j : near de gamma e i j -> 1 <= j <= 2 /\ 2 <= i /\ 1 # 2 <= gamma < 1.
Proof. intros []. assert ((1#2) <= gamma < 1) by lra. split; [split|split]; nra. Qed.
Lemma near_le de de' gamma e i j : near de gamma e i j -> de <= de' <= 1 # 2 ->
  near de' gamma e i j.
Proof. intros [] H. split; lra || assumption. Qed.
(* Then the sum above is at most 0 for all γ from some 1 - δ on: of one pair, and of all. *)
Lemma lex_small a b c : lex a b c -> exists de, 0 < de <= 1 # 2 /\
  forall gamma e i j, near de gamma e i j -> gamma * i * a + b + e * j * c <= 0.
Proof.
  destruct (absorb b) as (B & B0 & Bb). destruct (absorb c) as (C & C0 & Cc).
  intros [a0|[a0 [b0|[b0 c0]]]].
  - set (d := - a / (2 * (B + C) - 2 * a)).
    assert (T : d * (2 * (B + C) - 2 * a) == - a) by (unfold d; field; lra).
    assert (d0 : 0 < d) by (unfold d; apply Qlt_shift_div_l; lra).
    assert (d1 : d <= 1 # 2) by (unfold d; apply Qle_shift_div_r; lra).
    exists d. split; [lra|]. intros gamma e i j N. destruct (near_j _ _ _ _ _ N) as (J & I & G).
    destruct N.
    assert (2 * (B + C) * d <= - a) by nra.
    assert (id : 1 <= i * d) by nra.
    assert (2 * (B + C) <= i * - a).
    { apply Qle_trans with (2 * (B + C) * (i * d)); [nra|].
      setoid_replace (2 * (B + C) * (i * d)) with (i * (2 * (B + C) * d)) by ring. nra. }
    assert (B + C <= gamma * (i * - a)) by nra.
    assert (ej : 0 <= e * j <= 1) by nra.
    assert (e * j * c <= C) by nra.
    setoid_replace (gamma * i * a) with (- (gamma * (i * - a))) by ring. lra.
  - set (d := - b / (2 * C - 2 * b)).
    assert (T : d * (2 * C - 2 * b) == - b) by (unfold d; field; lra).
    assert (d0 : 0 < d) by (unfold d; apply Qlt_shift_div_l; lra).
    assert (d1 : d <= 1 # 2) by (unfold d; apply Qle_shift_div_r; lra).
    exists d. split; [lra|]. intros gamma e i j N. destruct (near_j _ _ _ _ _ N) as (J & I & G).
    destruct N.
    assert (ej : 0 <= e * j <= 2 * d) by nra.
    assert (e * j * c <= 2 * d * C) by nra. rewrite a0. nra.
  - exists (1 # 2). split; [lra|]. intros gamma e i j N.
    destruct (near_j _ _ _ _ _ N) as (J & I & G). destruct N.
    assert (0 <= e * j) by nra. rewrite a0, b0. nra.
Qed.
Lemma lex_all (a b c : pair -> Q) l : (forall p, In p l -> lex (a p) (b p) (c p)) -> exists de,
  0 < de <= 1 # 2 /\
  forall gamma e i j, near de gamma e i j -> forall p, In p l ->
    gamma * i * a p + b p + e * j * c p <= 0.
Proof.
  induction l as [|p l IH]; intro H; [exists (1 # 2); split; [lra|easy]|].
  destruct IH as (d & d0 & F); [intros; apply H; now right|].
  destruct (lex_small _ _ _ (H p (or_introl eq_refl))) as (d' & d0' & F').
  destruct (Qlt_le_dec d d') as [L|L]; [exists d|exists d']; (split; [assumption|]);
    intros gamma e i j N q [<-|I]; auto.
  - apply F'. apply near_le with (1 := N). lra.
  - apply (F gamma e i j); [apply near_le with (1 := N); lra|assumption].
Qed.
(* And some multiple of g, added to h, makes up for what the first is short of. *)
Lemma lex_times (a b c : pair -> Q) l : (forall p, In p l -> lex (a p) (b p) (c p)) -> exists M,
  0 <= M /\
  forall p, In p l -> b p + M * a p <= 0.
Proof.
  assert (neg : forall a b c, lex a b c -> a <= 0) by (unfold lex; intros; lra).
  induction l as [|p l IH]; intro H; [exists 0; split; [lra|easy]|].
  destruct IH as (M & M0 & F); [intros; apply H; now right|].
  destruct (Qlt_le_dec (a p) 0) as [A|A].
  - destruct (absorb (b p)) as (B & B0 & Bb). set (k := B / - a p).
    assert (k0 : 0 <= k) by (unfold k; apply Qle_shift_div_l; lra).
    assert (K : k * - a p == B) by (unfold k; field; lra).
    exists (M + k). split; [lra|]. intros q [<-|I]; [nra|].
    specialize (F q I). specialize (neg _ _ _ (H q (or_intror I))). nra.
  - exists M. split; [exact M0|]. intros q [<-|I]; [|auto].
    destruct (H p (or_introl eq_refl)) as [X|[X Y]]; [lra|]. rewrite X. lra.
Qed.

(* ---- the three tests in rationals
  -------------------------------------------------------------- *)

Section Tests.
  Variables (m : model) (g h w : level) (p : pair).
  Hypotheses (R : row_ok m p) (Lg : level_pos m g) (Lh : level_pos m h) (Lw : level_pos m w).
  Let positive_at x : level_pos m x -> positive (x (state p)).
  Proof. intro L. apply L. apply R. Qed.

  Lemma g_surplus_ok : let d := surplus_of 1 0 p (value g) in
    ((g_surplus g p < 0)%Z -> d < 0) /\ (g_surplus g p = 0%Z <-> d == 0) /\
    ((g_surplus g p <= 0)%Z -> d <= 0).
  Proof.
    unfold g_surplus. assert (c0 : positive (0, 1)%Z) by reflexivity.
    assert (cq : quotient (0, 1)%Z == 0) by reflexivity. cbv zeta.
    pose proof (surplus_eq m 1 _ _ p g R Lg c0 cq).
    pose proof (surplus_lt m 1 _ _ p g R Lg c0 cq).
    pose proof (surplus_le m 1 _ _ p g R Lg c0 cq). tauto.
  Qed.
  Lemma h_surplus_ok : let d := surplus_of 1 (r m p - value g (state p)) p (value h) in
    ((h_surplus m g h p < 0)%Z -> d < 0) /\ (h_surplus m g h p = 0%Z <-> d == 0) /\
    ((h_surplus m g h p <= 0)%Z -> d <= 0).
  Proof.
    unfold h_surplus. destruct (earned_ok m p) as [r0 rq]; [apply R|].
    pose proof (positive_at g Lg) as g0. unfold value at 1 3 5.
    destruct (earned m p) as [top below], (g (state p)) as [t b].
    unfold positive, quotient in *. cbn [fst snd] in *.
    set (c := (top * b - below * t, below * b)%Z).
    assert (c0 : positive c) by (unfold positive, c; cbn [snd]; now apply Z.mul_pos_pos).
    assert (cq : quotient c == r m p - inject_Z t / inject_Z b).
    { unfold quotient, c. cbn [fst snd]. rewrite <- rq. apply inject_pos in r0, g0.
      unfold Z.sub. rewrite inject_Z_plus, inject_Z_opp, !inject_Z_mult. field. split; lra. }
    pose proof (surplus_eq m 1 _ _ p h R Lh c0 cq).
    pose proof (surplus_lt m 1 _ _ p h R Lh c0 cq).
    pose proof (surplus_le m 1 _ _ p h R Lh c0 cq). cbv zeta. tauto.
  Qed.
  Lemma w_surplus_ok : let d := surplus_of 1 (- value h (state p)) p (value w) in
    ((w_surplus h w p < 0)%Z -> d < 0) /\ (w_surplus h w p = 0%Z <-> d == 0) /\
    ((w_surplus h w p <= 0)%Z -> d <= 0).
  Proof.
    unfold w_surplus. pose proof (positive_at h Lh) as h0. unfold value at 1 3 5.
    destruct (h (state p)) as [t b]. unfold positive, quotient in *. cbn [fst snd] in *.
    assert (c0 : positive (- t, b)%Z) by exact h0.
    assert (cq : quotient (- t, b)%Z == - (inject_Z t / inject_Z b)).
    { unfold quotient. cbn [fst snd]. apply inject_pos in h0. rewrite inject_Z_opp. field. lra. }
    pose proof (surplus_eq m 1 _ _ p w R Lw c0 cq).
    pose proof (surplus_lt m 1 _ _ p w R Lw c0 cq).
    pose proof (surplus_le m 1 _ _ p w R Lw c0 cq). cbv zeta. tauto.
  Qed.
End Tests.

Section Expansion.
  Variables (m : model) (hs : hints) (a : Z -> Z) (g h w : level).
  Hypotheses (M : model_right m hs = true) (P : policy_right m a = true) (H :
    expansion m a g h w = true).
  Let G := value g. Let Hb := value h. Let W := value w.
  Let da (p : pair) := surplus_of 1 0 p G.
  Let db (p : pair) := surplus_of 1 (r m p - G (state p)) p Hb.
  Let dc (p : pair) := surplus_of 1 (- Hb (state p)) p W.

  Lemma exp_wf : well_formed m. Proof. now apply (model_right_ok m hs). Qed.
  Lemma exp_pairs : forall p, In p (pairs m) -> lex (da p) (db p) (dc p) /\
    (taken a p = true -> da p == 0 /\ db p == 0 /\ dc p == 0).
  Proof.
    intros p I. pose proof H as X. unfold expansion in X. rewrite !andb_true_iff in X.
    destruct X as [[[Lg Lh] Lw] F]. rewrite forallb_forall in F. specialize (F p I).
    apply (level_right_ok m a _ P) in Lg, Lh, Lw.
    pose proof (wf_rows m exp_wf p I) as R. pose proof R as (Ss & _).
    destruct (g_surplus_ok m g p R Lg) as (le & Ge & _).
    destruct (h_surplus_ok m g h p R Lg Lh) as (lh & He & _).
    destruct (w_surplus_ok m h w p R Lh Lw) as (lw & We & Wl).
    unfold expansion_pair, first_surplus in F. unfold lex, da, db, dc, G, Hb, W.
    apply andb_true_iff in F. destruct F as [F1 F2]. apply Z.leb_le in F1.
    destruct (Z.eqb_spec (g_surplus g p) 0) as [z1|z1].
    - destruct (Z.eqb_spec (h_surplus m g h p) 0) as [z2|z2].
      + split; [right; split; [now apply Ge|right; split; [now apply He|now apply Wl]]|].
        intro T. rewrite T in F2. cbn [negb orb] in F2. apply Z.eqb_eq in F2.
        split; [now apply Ge|]. split; [now apply He|now apply We].
      + split; [right; split; [now apply Ge|left; apply lh; lia]|].
        intro T. rewrite T in F2. cbn [negb orb] in F2. apply Z.eqb_eq in F2. lia.
    - split; [left; apply le; lia|].
      intro T. rewrite T in F2. cbn [negb orb] in F2. apply Z.eqb_eq in F2. lia.
  Qed.

  Lemma exp_valid : valid m (stationary m a).
  Proof. eapply plays_valid, stationary_plays, P. Qed.

  (* The policy earns n g + h in n steps, up to a constant, and no policy more than n g. *)
  Theorem average_sound : exists C, 0 <= C /\ forall s n hy, is_state m s ->
    (forall pi, valid m pi -> earns m 1 pi n hy s <= inject_Z (Z.of_nat n) * G s + C) /\
    inject_Z (Z.of_nat n) * G s + Hb s - C <= earns m 1 (stationary m a) n hy s <=
    inject_Z (Z.of_nat n) * G s + Hb s + C.
  Proof.
    destruct (lex_times da db dc (pairs m)) as (t & t0 & T); [intros; now apply exp_pairs|].
    set (X := fun s => Hb s + t * G s). destruct (bounded m X) as (C1 & C10 & B1).
    destruct (bounded m Hb) as (C2 & C20 & B2).
    exists (2 * C1 + C2). split; [lra|]. intros s n hy Ss.
    assert (da0 : forall p, In p (pairs m) -> da p <= 0).
    { intros p I. destruct (exp_pairs p I) as [L _]. unfold lex in L. lra. }
    split; [|split].
    - intros pi V. apply Qle_trans with (inject_Z (Z.of_nat n) * G s + X s + C1);
        [|specialize (B1 s Ss); lra].
      apply (run_upper m (fun _ => True) (fun _ => True) (r m) 1 (fun _ => 0)
        (fun n s => inject_Z (Z.of_nat n) * G s + X s + C1) pi exp_wf); auto; try lra.
      + intros q Sq _. cbn [Z.of_nat]. change (inject_Z 0) with 0. specialize (B1 q Sq). lra.
      + intros k p I _ _. rewrite mean_plus, mean_plus, mean_times,
          (mean_const m p (wf_rows m exp_wf p I)).
        unfold X. rewrite mean_plus, mean_times. specialize (T p I). specialize (da0 p I).
        unfold da, db, surplus_of in *. rewrite Nat2Z.inj_succ, <- Z.add_1_r, inject_Z_plus.
        change (inject_Z 1) with 1. set (z := inject_Z (Z.of_nat k)).
        assert (0 <= z) by (apply inject_nneg; lia). nra.
    - apply Qle_trans with (inject_Z (Z.of_nat n) * G s + Hb s + - C2); [lra|].
      apply (run_lower m (fun p => taken a p = true) (fun _ => True) (r m) 1 (fun _ => 0)
        (fun n s => inject_Z (Z.of_nat n) * G s + Hb s + - C2) _ exp_wf); auto; try lra.
      + now apply stationary_plays.
      + intros q Sq _. cbn [Z.of_nat]. change (inject_Z 0) with 0. specialize (B2 q Sq). lra.
      + intros k p I Tp _. rewrite mean_plus, mean_plus, mean_times,
          (mean_const m p (wf_rows m exp_wf p I)).
        destruct (exp_pairs p I) as [_ Eq]. destruct (Eq Tp) as (e1 & e2 & _).
        unfold da, db, surplus_of in *.
        rewrite Nat2Z.inj_succ, <- Z.add_1_r, inject_Z_plus. change (inject_Z 1) with 1.
        set (z := inject_Z (Z.of_nat k)).
        assert (z * mean p G == z * G (state p)) by (setoid_replace (mean p G) with (G (state p))
          by lra; reflexivity). lra.
    - apply Qle_trans with (inject_Z (Z.of_nat n) * G s + Hb s + C2); [|lra].
      apply (run_upper m (fun p => taken a p = true) (fun _ => True) (r m) 1 (fun _ => 0)
        (fun n s => inject_Z (Z.of_nat n) * G s + Hb s + C2) _ exp_wf); auto; try lra.
      + now apply stationary_plays.
      + intros q Sq _. cbn [Z.of_nat]. change (inject_Z 0) with 0. specialize (B2 q Sq). lra.
      + intros k p I Tp _. rewrite mean_plus, mean_plus, mean_times,
          (mean_const m p (wf_rows m exp_wf p I)).
        destruct (exp_pairs p I) as [_ Eq]. destruct (Eq Tp) as (e1 & e2 & _).
        unfold da, db, surplus_of in *.
        rewrite Nat2Z.inj_succ, <- Z.add_1_r, inject_Z_plus. change (inject_Z 1) with 1.
        set (z := inject_Z (Z.of_nat k)).
        assert (z * mean p G == z * G (state p)) by (setoid_replace (mean p G) with (G (state p))
          by lra; reflexivity). lra.
  Qed.

  (* And so does every policy whose pairs satisfy the first two equations. *)
  Theorem average_pairs_sound : exists C, 0 <= C /\ forall pi,
    plays m (fun p => da p == 0 /\ db p == 0) pi -> forall s n hy, is_state m s ->
    inject_Z (Z.of_nat n) * G s + Hb s - C <= earns m 1 pi n hy s <=
    inject_Z (Z.of_nat n) * G s + Hb s + C.
  Proof.
    destruct (bounded m Hb) as (C & C0 & B). exists C. split; [exact C0|]. intros pi pl s n hy Ss.
    assert (step : forall c k p, In p (pairs m) -> da p == 0 /\ db p == 0 ->
      r m p + 1 * mean p (fun t => inject_Z (Z.of_nat k) * G t + Hb t + c) ==
      inject_Z (Z.of_nat (S k)) * G (state p) + Hb (state p) + c).
    { intros c k p I [e1 e2].
      rewrite mean_plus, mean_plus, mean_times, (mean_const m p (wf_rows m exp_wf p I)).
      unfold da, db, surplus_of in *. rewrite Nat2Z.inj_succ, <- Z.add_1_r, inject_Z_plus.
      change (inject_Z 1) with 1. set (z := inject_Z (Z.of_nat k)).
      assert (z * mean p G == z * G (state p)) by (setoid_replace (mean p G) with (G (state p))
        by lra; reflexivity). lra. }
    split.
    - apply Qle_trans with (inject_Z (Z.of_nat n) * G s + Hb s + - C); [lra|].
      apply (run_lower m (fun p => da p == 0 /\ db p == 0) (fun _ => True) (r m) 1 (fun _ => 0)
        (fun n s => inject_Z (Z.of_nat n) * G s + Hb s + - C) pi exp_wf); auto; try lra.
      + intros q Sq _. cbn [Z.of_nat]. change (inject_Z 0) with 0. specialize (B q Sq). lra.
      + intros k p I Dp _. rewrite (step (- C) k p I Dp). apply Qle_refl.
    - apply (run_upper m (fun p => da p == 0 /\ db p == 0) (fun _ => True) (r m) 1 (fun _ => 0)
        (fun n s => inject_Z (Z.of_nat n) * G s + Hb s + C) pi exp_wf); auto; try lra.
      + intros q Sq _. cbn [Z.of_nat]. change (inject_Z 0) with 0. specialize (B q Sq). lra.
      + intros k p I Dp _. rewrite (step C k p I Dp). apply Qle_refl.
  Qed.

  (* The optimum of discounted values is g / (1 - γ) + h, up to a term of order 1 - γ. *)
  Theorem limit_sound : exists K de, 0 <= K /\ 0 < de <= 1 # 2 /\
    forall gamma, 1 - de <= gamma < 1 -> forall s n hy, is_state m s ->
    let rest := K * (1 - gamma) + pow gamma n * (K / (1 - gamma)) in
    (forall pi, valid m pi -> earns m gamma pi n hy s <= G s / (1 - gamma) + Hb s + rest) /\
    G s / (1 - gamma) + Hb s - rest <= earns m gamma (stationary m a) n hy s.
  Proof.
    destruct (lex_all da db dc (pairs m)) as (de & de0 & L); [intros; now apply exp_pairs|].
    destruct (bounded m G) as (Cg & Cg0 & Bg). destruct (bounded m Hb) as (Ch & Ch0 & Bh).
    destruct (bounded m W) as (Cw & Cw0 & Bw). set (K := Cg + 2 * Ch + 8 * Cw).
    exists K, de. split; [unfold K; lra|]. split; [exact de0|].
    intros gamma Hga s n hy Ss. cbv zeta. set (e := 1 - gamma). set (i := 1 / e).
    set (j := 1 / gamma).
    assert (N : near de gamma e i j).
    { unfold i, j, e. split; try lra; try (field; lra). }
    pose proof (near_j _ _ _ _ _ N) as (J & I2 & Ghalf). pose proof N as [Nga Ne Ni Nj _].
    specialize (L gamma e i j N).
    set (X := fun s => i * G s + j * Hb s + e * j * j * W s).
    assert (jj : 1 <= j * j <= 4) by nra.
    assert (ejj : 0 <= e * j * j <= 4 * e) by nra.
    assert (CX : forall p, In p (pairs m) -> surplus_of gamma (r m p) p X ==
      gamma * i * da p + db p + e * j * dc p - e * e * (j * j) * W (state p)).
    { intros p I. unfold surplus_of at 1. unfold X. rewrite mean_plus, mean_plus, !mean_times.
      unfold da, db, dc, surplus_of. set (eg := mean p G). set (eh := mean p Hb).
      set (ew := mean p W).
      unfold i, j, e. field. split; lra. }
    assert (scaled : forall v V x C, 0 <= v <= V -> 0 <= C -> - C <= x <= C -> - (V * C) <=
      v * x <= V * C).
    { intros v V x C v0 C0 x0. assert (v * C <= V * C) by (apply Qmult_le_compat_r; lra).
      assert (0 <= v * (C - x)) by (apply Qmult_le_0_compat; lra).
      assert (0 <= v * (C + x)) by (apply Qmult_le_0_compat; lra). lra. }
    assert (We : forall s, is_state m s -> - (4 * (e * e) * Cw) <= e * e * (j * j) * W s <=
      4 * (e * e) * Cw).
    { intros q Sq. apply scaled; auto. assert (ee : 0 <= e * e) by nra. clear - ee jj.
      set (u := e * e) in *. set (v := j * j) in *. split; nra. }
    assert (Xb : forall s, is_state m s -> - (Cg * i + 2 * Ch + 4 * e * Cw) <= X s <=
      Cg * i + 2 * Ch + 4 * e * Cw).
    { intros q Sq. specialize (Bg q Sq). specialize (Bh q Sq). specialize (Bw q Sq). unfold X.
      assert (A1 := scaled i i (G q) Cg ltac:(lra) Cg0 Bg).
      assert (A2 := scaled j 2 (Hb q) Ch ltac:(lra) Ch0 Bh).
      assert (A3 := scaled (e * j * j) (4 * e) (W q) Cw ltac:(lra) Cw0 Bw). lra. }
    assert (Ki : Cg * i + 2 * Ch + 8 * e * Cw <= K / e).
    { apply Qle_shift_div_l; [lra|]. unfold K.
      assert ((Cg * i) * e == Cg) by (setoid_replace (Cg * i * e) with (Cg * (e * i)) by ring;
        rewrite Ni; ring).
      assert (e * Ch <= Ch) by nra. assert (0 <= e * Cw <= Cw) by nra.
      assert (e * (e * Cw) <= Cw) by nra. lra. }
    assert (close : forall s, is_state m s -> - (K * e - 4 * e * Cw) <= X s - (G s / e + Hb s) <=
      K * e - 4 * e * Cw).
    { intros q Sq. unfold X. specialize (Bh q Sq). specialize (Bw q Sq).
      setoid_replace (G q / e) with (i * G q) by (unfold i; field; lra).
      assert (jm : 0 <= j - 1 <= 2 * e) by (assert (e * j == j - 1) by (unfold e; lra); nra).
      assert (A2 := scaled (j - 1) (2 * e) (Hb q) Ch ltac:(lra) Ch0 Bh).
      assert (A3 := scaled (e * j * j) (4 * e) (W q) Cw ltac:(lra) Cw0 Bw).
      assert (0 <= Cg * e) by nra.
      assert (0 <= e * Ch) by nra. unfold K. nra. }
    assert (c0 : 0 <= K / e) by (apply Qle_shift_div_l; [lra|]; unfold K; lra).
    assert (one : forall p, In p (pairs m) -> gamma * mean p (fun _ => 1) <= gamma * 1).
    { intros p I. rewrite (mean_const m p (wf_rows m exp_wf p I)). lra. }
    specialize (close s Ss). assert (ec : 0 <= e * Cw) by nra. split.
    - intros pi V.
      apply Qle_trans with (X s + 4 * e * Cw + pow gamma n * (K / e) * 1); [|lra].
      apply (weighted_upper m (fun _ => True) (fun _ => True) (r m) gamma gamma (K / e)
        (fun _ => 0) (fun _ => 1)
        (fun s => X s + 4 * e * Cw) pi exp_wf); auto; try lra.
      + intros p I _ _. unfold surplus_of.
        rewrite mean_plus, (mean_const m p (wf_rows m exp_wf p I)).
        specialize (CX p I). unfold surplus_of at 1 in CX. specialize (L p I).
        assert (Ss' : is_state m (state p)) by apply (wf_rows m exp_wf p I).
        specialize (We _ Ss'). nra.
      + intros q Sq _. specialize (Xb q Sq). lra.
    - apply Qle_trans with (X s + - (4 * e * Cw) - pow gamma n * (K / e) * 1); [lra|].
      apply (weighted_lower m (fun p => taken a p = true) (fun _ => True) (r m)
        gamma gamma (K / e) (fun _ => 0) (fun _ => 1)
        (fun s => X s + - (4 * e * Cw)) _ exp_wf); auto; try lra.
      + now apply stationary_plays.
      + intros p I T _. unfold surplus_of.
        rewrite mean_plus, (mean_const m p (wf_rows m exp_wf p I)).
        specialize (CX p I). unfold surplus_of at 1 in CX. destruct (exp_pairs p I) as [_ Z].
        destruct (Z T) as (z1 & z2 & z3). rewrite z1, z2, z3 in CX.
        assert (Ss' : is_state m (state p)) by apply (wf_rows m exp_wf p I).
        specialize (We _ Ss'). nra.
      + intros q Sq _. specialize (Xb q Sq). lra.
  Qed.
End Expansion.
