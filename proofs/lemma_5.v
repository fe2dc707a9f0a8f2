(** Lemma 5: few mixtures of two pairs can be uncontrollable.

    Mix the pair (A, B) with the pair (A1, B1), weight lam on the second. What
    tells controllability is a polynomial in lam, which has few roots.

    - [weights_of_the_paper]: 2 n^2 + 1 different weights are enough.
    - [enough_weights]: n (n + 1) / 2 + 1 are.
    - [enough_nonzero_weights]: one fewer is enough where none of them is zero
      and the first pair is not controllable.

    Each holds for any order and any number of inputs. *)

From mathcomp Require Import all_ssreflect fingroup perm all_algebra.

Set Implicit Arguments.
Unset Strict Implicit.
Unset Printing Implicit Defensive.

Import GRing.Theory Num.Theory.
Local Open Scope ring_scope.

(** ** Mixtures, and polynomials for matrices *)

(** [A^k B], the k-th block of the controllability matrix. *)
Definition block (R : comRingType) n q (A : 'M[R]_n) (B : 'M[R]_(n, q)) k :=
  iter k (mulmx A) B.

Lemma map_block (R S : comRingType) (f : {rmorphism R -> S}) n q
    (A : 'M[R]_n) (B : 'M[R]_(n, q)) k :
  map_mx f (block A B k) = block (map_mx f A) (map_mx f B) k.
Proof. by elim: k => //= k <-; rewrite map_mxM. Qed.

Section Mixtures.

Variable F : fieldType.

(** The mixture of two matrices with weight [lam]. *)
Definition mix m p (X X1 : 'M[F]_(m, p)) (lam : F) := X + lam *: (X1 - X).

Lemma mix0 m p (X X1 : 'M_(m, p)) : mix X X1 0 = X.
Proof. by rewrite /mix scale0r addr0. Qed.

Lemma mix1 m p (X X1 : 'M_(m, p)) : mix X X1 1 = X1.
Proof. by rewrite /mix scale1r addrC subrK. Qed.

(** The same with the weight left open: entries are polynomials in it. *)
Definition line m p (X X1 : 'M[F]_(m, p)) : 'M[{poly F}]_(m, p) :=
  map_mx polyC X + 'X *: map_mx polyC (X1 - X).

Lemma line_at m p (X X1 : 'M_(m, p)) lam :
  map_mx (horner_eval lam) (line X X1) = mix X X1 lam.
Proof.
apply/matrixP => i j; rewrite !mxE /= horner_evalE.
by rewrite hornerD hornerM hornerX !hornerC.
Qed.

(** [size] is the degree plus one, and 0 for the polynomial 0. *)
Lemma size_line m p (X X1 : 'M_(m, p)) i j : (size (line X X1 i j) <= 2)%N.
Proof.
rewrite !mxE (leq_trans (size_add _ _)) // geq_max.
rewrite (leq_trans (size_polyC_leq1 _)) //=.
rewrite (leq_trans (size_mul_leq _ _)) // size_polyX /=.
by rewrite ltnS size_polyC_leq1.
Qed.

(** Degrees add up: below, d and e bound degrees. *)
Lemma size_times (p q : {poly F}) d e :
  (size p <= d.+1)%N -> (size q <= e.+1)%N -> (size (p * q)%R <= (d + e).+1)%N.
Proof.
move=> sp sq; rewrite (leq_trans (size_mul_leq _ _)) // -subn1 leq_subLR.
by rewrite (leq_trans (leq_add sp sq)) // add1n addSn addnS.
Qed.

Lemma size_block n q (A A1 : 'M_n) (B B1 : 'M_(n, q)) k i j :
  (size (block (line A A1) (line B B1) k i j) <= k.+2)%N.
Proof.
elim: k i => [|k IH] i; first exact: size_line.
rewrite /block iterS mxE (leq_trans (size_sum _ _ _)) //.
by apply/bigmax_leqP => l _; rewrite (@size_times _ _ 1 k.+1) ?size_line ?IH.
Qed.

(** Of a determinant whose (i, j) entry has degree d j at most. *)
Lemma size_det n (M : 'M[{poly F}]_n) (d : 'I_n -> nat) :
  (forall i j, size (M i j) <= (d j).+1)%N ->
  (size (\det M) <= (\sum_j d j).+1)%N.
Proof.
move=> sM; rewrite /determinant (leq_trans (size_sum _ _ _)) //.
apply/bigmax_leqP => s _; rewrite size_Msign.
rewrite (leq_trans (size_prod_leq _ _)) // cardT size_enum_ord.
rewrite leq_subLR addnS ltnS [X in (_ + X)%N](reindex_inj (@perm_inj _ s)) /=.
rewrite -[X in (X + _)%N]card_ord -sum1_card -big_split.
by apply: leq_sum => i _; apply: sM.
Qed.

(** A polynomial that is nonzero where a property holds has few roots. *)
Lemma few_roots (p : {poly F}) (good : pred F) d (weights : seq F) :
  p != 0 -> (size p <= d.+1)%N -> (forall lam, good lam = (p.[lam] != 0)) ->
  uniq weights -> (d < size weights)%N ->
  exists2 lam, lam \in weights & good lam.
Proof.
move=> p_neq0 sp goodE different many.
apply/hasP; apply: contraLR many => /hasPn bad.
rewrite -leqNgt -ltnS (leq_trans _ sp) //; apply: max_poly_roots => //.
by apply/allP => lam /bad; rewrite goodE negbK.
Qed.

End Mixtures.

(** The columns of B, A B, ..., A^(n-1) B span the whole space. *)
Definition controllable (F : fieldType) n q (A : 'M[F]_n) (B : 'M[F]_(n, q)) :=
  row_full (\sum_(k < n) <<(block A B k)^T>>)%MS.

(** ** The paper's count, for any number of inputs *)

Section Paper.

Variable F : realFieldType.
Variables n q : nat.

(** C C' with the controllability matrix C = [B, A B, ..., A^(n-1) B]. *)
Definition gram (R : comRingType) (A : 'M[R]_n) (B : 'M[R]_(n, q)) : 'M[R]_n :=
  \sum_(k < n) block A B k *m (block A B k)^T.

Lemma gram_kernel (A : 'M[F]_n) (B : 'M[F]_(n, q)) (v : 'rV_n) :
  v *m gram A B = 0 -> forall k : 'I_n, v *m block A B k = 0.
Proof.
move=> vW; pose w k := v *m block A B k.
have sq k : (w k *m (w k)^T) 0 0 = \sum_j w k 0 j ^+ 2.
  by rewrite mxE; apply: eq_bigr => j _; rewrite [_^T _ _]mxE expr2.
have : \sum_(k < n) (w k *m (w k)^T) 0 0 = 0.
  rewrite -summxE; have -> : \sum_(k < n) w k *m (w k)^T = v *m gram A B *m v^T.
    rewrite /gram mulmx_sumr mulmx_suml; apply: eq_bigr => k _.
    by rewrite /w trmx_mul !mulmxA.
  by rewrite vW mul0mx mxE.
move/eqP; rewrite psumr_eq0 => [/allP zero k|k _]; last first.
  by rewrite sq sumr_ge0 // => j _; rewrite sqr_ge0.
have := zero k (mem_index_enum _); rewrite /= sq psumr_eq0 => [/allP zero'|j _].
  apply/rowP => j; rewrite [RHS]mxE; apply/eqP; rewrite -sqrf_eq0.
  exact: zero' (mem_index_enum _).
exact: sqr_ge0.
Qed.

Lemma controllable_gram (A : 'M[F]_n) (B : 'M[F]_(n, q)) :
  controllable A B = (\det (gram A B) != 0).
Proof.
rewrite -unitfE -unitmxE -row_free_unit; apply/idP/idP => [full|].
  rewrite -kermx_eq0; apply/eqP/row_matrixP => i; rewrite row0.
  have := gram_kernel (sub_kermxP (row_sub i (kermx (gram A B)))).
  set v := row i _ => v0; have := submx_full 1%:M full.
  case/sub_sumsmxP => u one; apply: trmx_inj; rewrite trmx0 -[LHS]mul1mx one.
  rewrite mulmx_suml big1 // => k _.
  have /submxP[D ->] : (<<(block A B k)^T>> <= (block A B k)^T)%MS.
    by rewrite genmxE.
  by rewrite -!mulmxA -trmx_mul v0 trmx0 !mulmx0.
rewrite row_free_unit -row_full_unit /controllable => full.
rewrite -sub1mx (submx_trans (submx_full _ full)) //; apply: summx_sub => k _.
by rewrite (sumsmx_sup k) // genmxE submxMl.
Qed.

Variables (A A1 : 'M[F]_n) (B B1 : 'M[F]_(n, q)).

Lemma size_gram :
  (size (\det (gram (line A A1) (line B B1))) <= (2 * n ^ 2).+1)%N.
Proof.
have -> : (2 * n ^ 2 = \sum_(j < n) (n + n))%N.
  by rewrite sum_nat_const card_ord addnn -muln2 mulnA mulnn mulnC.
apply: size_det => i j; rewrite summxE (leq_trans (size_sum _ _ _)) //.
apply/bigmax_leqP => k _; rewrite mxE (leq_trans (size_sum _ _ _)) //.
apply/bigmax_leqP => l _; rewrite [_^T _ _]mxE (@size_times _ _ _ n n) //.
  by rewrite (leq_trans (size_block _ _ _ _ _ _ _)) // !ltnS ltn_ord.
by rewrite (leq_trans (size_block _ _ _ _ _ _ _)) // !ltnS ltn_ord.
Qed.

Lemma gram_at lam :
  (\det (gram (line A A1) (line B B1))).[lam]
  = \det (gram (mix A A1 lam) (mix B B1 lam)).
Proof.
rewrite -[LHS]/(horner_eval lam _) -det_map_mx /gram raddf_sum.
congr (\det _); apply: eq_bigr => k _.
by rewrite /= map_mxM -map_trmx map_block !line_at.
Qed.

(** Lemma 5: of 2 n^2 + 1 different weights one keeps the pair controllable. *)
Theorem weights_of_the_paper (weights : seq F) :
  controllable A1 B1 -> uniq weights -> (2 * n ^ 2 < size weights)%N ->
  exists2 lam, lam \in weights & controllable (mix A A1 lam) (mix B B1 lam).
Proof.
move=> good; apply: few_roots size_gram _ => [|lam]; last first.
  by rewrite gram_at controllable_gram.
apply: contraTneq good => p0; rewrite controllable_gram.
by rewrite -[A1](mix1 A) -[B1](mix1 B) -gram_at p0 horner0 eqxx.
Qed.

End Paper.

(** ** The sharper count, for any number of inputs and over any field *)

Section Sharper.

Variable F : fieldType.
Variables n q : nat.

(** Columns of the controllability matrix: the i-th is A^k b_j, (k, j) = f i. *)
Definition columns (R : comRingType) (A : 'M[R]_n) (B : 'M[R]_(n, q)) m
    (f : 'I_m -> nat * 'I_q) : 'M[R]_(n, m) :=
  \matrix_(l, i) block A B (f i).1 l (f i).2.

Section Choice.

Variables (A : 'M[F]_n) (B : 'M[F]_(n, q)).

Lemma block_col k j m (f : 'I_m -> nat * 'I_q) i :
  f i = (k, j) -> row i (columns A B f)^T = row j (block A B k)^T.
Proof. by move=> fi; apply/rowP => l; rewrite !mxE fi. Qed.

(** If all A^k b_j, k <= m, lie in the span of some A^k b_j, k < m, all do. *)
Lemma closed m (f : 'I_m -> nat * 'I_q) :
  (forall i, (f i).1 <= i)%N ->
  (forall k, (k <= m)%N -> ((block A B k)^T <= (columns A B f)^T)%MS) ->
  forall k, ((block A B k)^T <= (columns A B f)^T)%MS.
Proof.
move=> early within; elim=> [|k IH]; first exact: within.
have -> : (block A B k.+1)^T = (block A B k)^T *m A^T by rewrite -trmx_mul.
rewrite (submx_trans (submxMr _ IH)) //; apply/row_subP => i.
rewrite row_mul; case fi: (f i) => [l j]; rewrite (block_col fi) -row_mul.
rewrite -trmx_mul (submx_trans (row_sub _ _)) // (within l.+1) //.
by rewrite (leq_trans _ (ltn_ord i)) // ltnS (leq_trans _ (early i)) ?fi.
Qed.

(** Independent columns can be chosen one by one, the i-th with k <= i. *)
Lemma choice m : controllable A B -> (m <= n)%N ->
  exists f : 'I_m -> nat * 'I_q,
    (forall i, (f i).1 <= i)%N /\ row_free (columns A B f)^T.
Proof.
move=> full; elim: m => [|m IH] lemn.
  have f : 'I_0 -> nat * 'I_q by case.
  by exists f; split; [case | rewrite /row_free -leqn0 rank_leq_row].
have [f [early free]] := IH (ltnW lemn); set M := (columns A B f)^T in free.
have [k [j out]] : exists k : 'I_m.+1, exists j,
    ~~ (row j (block A B k)^T <= M)%MS.
  case: (boolP [forall k : 'I_m.+1, ((block A B k)^T <= M)%MS]).
    move=> /forallP within; case/negP: (ltnn m); apply: leq_trans lemn _.
    have all k : ((block A B k)^T <= M)%MS.
      apply: closed => // l lelm.
      exact: (within (Ordinal (lelm : l < m.+1)%N)).
    rewrite -(mxrank1 F n) (leq_trans _ (rank_leq_row M)) // mxrankS //.
    rewrite (submx_trans (submx_full _ full)) //.
    by apply/sumsmx_subP => k _; rewrite genmxE.
  by rewrite negb_forall => /existsP[k /row_subPn[j out]]; exists k, j.
pose g i := oapp f (val k, j) (unlift ord_max i).
have gf i : g (lift ord_max i) = f i by rewrite /g liftK.
have gm : g ord_max = (val k, j) by rewrite /g unlift_none.
exists g; split=> [i|].
  case: (unliftP ord_max i) => [l ->|->]; last by rewrite gm leq_ord.
  by rewrite gf lift_max.
have grows : (M < M + row j (block A B k)^T)%MS.
  by rewrite ltmxE addsmxSl addsmx_sub submx_refl.
have more := rank_ltmx grows; rewrite (eqnP free) in more.
rewrite /row_free eqn_leq rank_leq_row (leq_trans more) // mxrankS //.
rewrite addsmx_sub -(block_col gm) row_sub andbT; apply/row_subP => i.
case fi: (f i) => [l c]; rewrite (block_col fi).
by rewrite -(block_col (etrans (gf i) fi)) row_sub.
Qed.

(** What the choice is for: a minor of low degree that is not zero. *)
Lemma columns_det (f : 'I_n -> nat * 'I_q) :
  row_free (columns A B f)^T = (\det (columns A B f) != 0).
Proof. by rewrite row_free_unit unitmx_tr unitmxE unitfE. Qed.

(** Conversely, independent columns with k < n make the pair controllable. *)
Lemma minor_controllable (f : 'I_n -> nat * 'I_q) :
  (forall i, (f i).1 < n)%N -> \det (columns A B f) != 0 -> controllable A B.
Proof.
move=> early; rewrite -columns_det row_free_unit -row_full_unit => full.
rewrite /controllable -sub1mx (submx_trans (submx_full _ full)) //.
apply/row_subP => i; case fi: (f i) => [k j]; rewrite (block_col fi).
have ltkn : (k < n)%N by have := early i; rewrite fi.
by rewrite (sumsmx_sup (Ordinal ltkn)) // genmxE row_sub.
Qed.

End Choice.

(** 1 + 2 + ... + n. *)
Lemma gauss m : (\sum_(k < m) k.+1 = (m * m.+1)./2)%N.
Proof.
elim: m => [|m IH]; first by rewrite big_ord0.
rewrite big_ord_recr IH [nat_of_ord _]/=.
have -> : (m.+1 * m.+2 = m * m.+1 + m.+1.*2)%N.
  by rewrite [(m * _)%N]mulnC -muln2 -mulnDr addn2.
by rewrite halfD odd_double andbF add0n doubleK.
Qed.

Variables (A A1 : 'M[F]_n) (B B1 : 'M[F]_(n, q)).

Lemma size_columns (f : 'I_n -> nat * 'I_q) :
  (forall i, (f i).1 <= i)%N ->
  (size (\det (columns (line A A1) (line B B1) f)) <= ((n * n.+1)./2).+1)%N.
Proof.
move=> early; rewrite -gauss size_det // => i j; rewrite mxE.
by rewrite (leq_trans (size_block _ _ _ _ _ _ _)) // !ltnS early.
Qed.

Lemma columns_at (f : 'I_n -> nat * 'I_q) lam :
  (\det (columns (line A A1) (line B B1) f)).[lam]
  = \det (columns (mix A A1 lam) (mix B B1 lam) f).
Proof.
rewrite -[LHS]/(horner_eval lam _) -det_map_mx; congr (\det _).
by apply/matrixP => i j; rewrite !mxE -!line_at -map_block mxE.
Qed.

Hypothesis good : controllable A1 B1.

(** Of n (n + 1) / 2 + 1 different weights one keeps the pair controllable. *)
Theorem enough_weights (weights : seq F) :
  uniq weights -> ((n * n.+1)./2 < size weights)%N ->
  exists2 lam, lam \in weights & controllable (mix A A1 lam) (mix B B1 lam).
Proof.
move=> different many; have [f [early free]] := choice good (leqnn n).
pose p := \det (columns (line A A1) (line B B1) f).
have p_neq0 : p != 0.
  apply: contraTneq free => p0; rewrite columns_det negbK.
  by rewrite -[A1](mix1 A) -[B1](mix1 B) -columns_at -/p p0 horner0.
have [lam found kept] := @few_roots F p [pred lam | p.[lam] != 0] _ weights
  p_neq0 (size_columns early) (fun=> erefl) different many.
exists lam => //; apply: (minor_controllable (f := f)).
  by move=> i; rewrite (leq_ltn_trans (early i)).
by rewrite -columns_at.
Qed.

(** If the first pair is not controllable, n (n + 1) / 2 nonzero weights do. *)
Theorem enough_nonzero_weights (weights : seq F) :
  ~~ controllable A B ->
  uniq weights -> 0 \notin weights -> ((n * n.+1)./2 <= size weights)%N ->
  exists2 lam, lam \in weights & controllable (mix A A1 lam) (mix B B1 lam).
Proof.
move=> bad different nonzero many.
have [||lam] := @enough_weights (0 :: weights); rewrite /= ?nonzero //.
rewrite in_cons => /orP[/eqP-> | found kept]; last by exists lam.
by rewrite !mix0 (negPf bad).
Qed.

End Sharper.

Print Assumptions weights_of_the_paper.
Print Assumptions enough_weights.
Print Assumptions enough_nonzero_weights.
