(** Lemma 4 fails as stated: proximal iterates that stay away from X.

    Let f(x,k) = 2^-k x^2 on the line and D(x,y) = (x-y)^2 / 2, without mixing.
    Zero is the only common minimiser. The iterates from 1 fall, and stay above
    0.069. *)

From mathcomp Require Import all_ssreflect all_algebra.

Set Implicit Arguments.
Unset Strict Implicit.
Unset Printing Implicit Defensive.

Import Order.TTheory GRing.Theory Num.Theory.
Local Open Scope ring_scope.

(** The tactic [ring] wants a ring whose operations are variables. *)
Section Completed.

Variables (T : Type) (o i : T) (add mul sub : T -> T -> T) (opp : T -> T).
Hypothesis theory : ring_theory o i add mul sub opp (@eq T).
Add Ring T : theory.
Local Notation "x + y" := (add x y).
Local Notation "x * y" := (mul x y).
Local Notation "x - y" := (sub x y).

Lemma completed w h y z (d := i + (i + i) * w) :
  w * (y * y) + (y - d * z) * (y - d * z) * h
  = w * (z * z) + (z - d * z) * (z - d * z) * h
    + d * h * ((y - z) * (y - z))
    + w * ((y - z) * (y + z)) * (i - (h + h)).
Proof. rewrite /d; ring. Qed.

End Completed.

Section Counterexample.

Variable R : realFieldType.
Implicit Types x y : R.

(** The functions, the distance, and what one proximal step minimises. *)
Definition weight k : R := 2^-1 ^+ k.
Definition f k x : R := weight k * x ^+ 2.
Definition D x y : R := (x - y) ^+ 2 / 2.
Definition objective k centre y : R := f k y + D y centre.

Definition step k x : R := x / (1 + 2 * weight k).

Fixpoint iterate k : R :=
  if k is j.+1 then step j (iterate j) else 1.

Lemma weight_gt0 k : 0 < weight k.
Proof. by rewrite exprn_gt0 // invr_gt0 ltr0n. Qed.

Lemma weightS k : weight k = 2 * weight k.+1.
Proof. by rewrite /weight exprS mulrA divff ?mul1r // pnatr_eq0. Qed.

Lemma divisor_gt0 k : 0 < 1 + 2 * weight k.
Proof. by rewrite addr_gt0 ?ltr01 // mulr_gt0 ?ltr0n // weight_gt0. Qed.

(** X = {0}: zero minimises every f(.,k), and no other point minimises one. *)
Theorem common_minimiser x k : (forall y, f k x <= f k y) <-> x = 0.
Proof.
split=> [least | -> y].
  have := least 0; rewrite /f expr0n mulr0 pmulr_rle0 ?weight_gt0 // => le0.
  by apply/eqP; rewrite -sqrf_eq0 eq_le le0 sqr_ge0.
by rewrite /f expr0n mulr0 mulr_ge0 ?sqr_ge0 // ltW ?weight_gt0.
Qed.

Let theory : ring_theory 0 1 +%R *%R (fun x y : R => x - y) -%R eq.
Proof.
split=> //; [exact: add0r | exact: addrC | exact: addrA | exact: mul1r
  | exact: mulrC | exact: mulrA | exact: mulrDl | exact: subrr].
Qed.

(** With z the step, so that x = (1 + 2 w) z, the square is completed. *)
Lemma square k x y :
  objective k x y = objective k x (step k x)
                    + (1 + 2 * weight k) / 2 * (y - step k x) ^+ 2.
Proof.
have xE : x = (1 + 2 * weight k) * step k x.
  by rewrite mulrC divfK // gt_eqF // divisor_gt0.
have half : 1 - (2^-1 + 2^-1) = 0 :> R.
  by rewrite -mulr2n -mulr_natl divff ?subrr // pnatr_eq0.
move: (step k x) xE => z ->; rewrite /objective /f /D !expr2.
rewrite [LHS](completed theory _ 2^-1) half.
by rewrite !mulr0 addr0.
Qed.

(** The step is the proximal step (20), and its minimiser is unique. *)
Theorem step_optimal k x y :
  objective k x (step k x) <= objective k x y
  /\ (objective k x y <= objective k x (step k x) -> y = step k x).
Proof.
have pos : 0 < (1 + 2 * weight k) / 2 by rewrite divr_gt0 ?divisor_gt0 ?ltr0n.
rewrite (square k x y); split.
  by rewrite ler_addl mulr_ge0 ?sqr_ge0 // ltW.
rewrite ger_addl pmulr_rle0 // => le0.
by apply/eqP; rewrite -subr_eq0 -sqrf_eq0 eq_le le0 sqr_ge0.
Qed.

Lemma iterate_ge0 k : 0 <= iterate k.
Proof.
by elim: k => [|k IH]; rewrite ?ler01 //= divr_ge0 // ltW ?divisor_gt0.
Qed.

(** The iterates fall; so they have a limit. *)
Theorem decreasing k : iterate k.+1 <= iterate k.
Proof.
rewrite [iterate k.+1]/= ler_pdivr_mulr ?divisor_gt0 //.
rewrite ler_pemulr ?iterate_ge0 // ler_addl mulr_ge0 ?ler0n //.
by rewrite ltW ?weight_gt0.
Qed.

Lemma weight_le1 k : weight k <= 1.
Proof.
by rewrite exprn_ile1 ?invr_ge0 ?ler0n // invf_le1 ?ltr0n // ler1n.
Qed.

Lemma fourth : iterate 4 = 4 / 45.
Proof.
have n0 m : (m.+1%:R : R) != 0 by rewrite pnatr_eq0.
have s1 : 1 + 2 = 3 :> R by rewrite -(natrD _ 1 2).
have s2 : 1 + 1 = 2 :> R by rewrite -(natrD _ 1 1).
have s3 : 1 + 2^-1 = 3 / 2 :> R.
  apply: (mulIf (n0 1%N)); rewrite mulrDl mulVf ?divfK ?n0 // mul1r.
  by rewrite -(natrD _ 2 1).
have s4 : 1 + 4^-1 = 5 / 4 :> R.
  apply: (mulIf (n0 3%N)); rewrite mulrDl mulVf ?divfK ?n0 // mul1r.
  by rewrite -(natrD _ 4 1).
rewrite /= /step -(weightS 0) -(weightS 1) -(weightS 2) /weight expr0 expr1.
rewrite exprVn -natrX mulr1 s1 s2 s3 s4 !invf_div -[1 / 3 / 2]mulrA -invfM.
rewrite !mulf_div -!natrM mul1r; apply/eqP; rewrite eqr_div ?n0 //.
by rewrite -!natrM eqr_nat.
Qed.

(** From k = 4 on 405 x is at least 4 (7 + 32 weight k), and that above 28. *)
Lemma stays k : 4 * (7 + 32 * weight k.+4) <= 405 * iterate k.+4.
Proof.
elim: k => [|k].
  have -> : 32 * weight 4 = 2 * weight 0.
    rewrite (weightS 0) (weightS 1) (weightS 2) (weightS 3).
    by rewrite !mulrA -!natrM.
  rewrite fourth /weight expr0 mulr1 mulrA ler_pdivl_mulr ?ltr0n //.
  by rewrite -natrD -!natrM ler_nat.
rewrite [iterate k.+1.+4]/= /step mulrA ler_pdivl_mulr ?divisor_gt0 //.
apply: le_trans; rewrite (weightS k.+4) -mulrA ler_pmul2l ?ltr0n //.
set w := weight k.+1.+4.
have small : 32 * w <= 1.
  suff <- : weight k = 32 * w by exact: weight_le1.
  rewrite (weightS k) (weightS k.+1) (weightS k.+2) (weightS k.+3).
  by rewrite (weightS k.+4) !mulrA -!natrM.
have -> : (7 + 32 * w) * (1 + 2 * (2 * w)) = 7 + 60 * w + 4 * w * (32 * w).
  rewrite mulrA -natrM mulrDl !mulrDr !mulr1 mulrA -natrM !addrA.
  by rewrite -[7 + _ + _]addrA -mulrDl -natrD [4 * w * _]mulrC.
have -> : 7 + 32 * (2 * w) = 7 + 60 * w + 4 * w.
  by rewrite mulrA -natrM -addrA -mulrDl -natrD.
rewrite ler_add2l -[leRHS]mulr1 ler_pmul2l // mulr_gt0 ?ltr0n //.
exact: weight_gt0.
Qed.

(** Lemma 4 says that the limit is in X = {0}. It is at least 28/405, and that
    is 0.0691... *)
Theorem bounded_away k : 28 / 405 <= iterate k.
Proof.
do 4! apply: le_trans (decreasing _).
rewrite ler_pdivr_mulr ?ltr0n // mulrC; apply: le_trans (stays k).
rewrite mulrDr -natrM ler_addl mulrA -natrM.
by rewrite mulr_ge0 ?ler0n // ltW ?weight_gt0.
Qed.

End Counterexample.

Print Assumptions common_minimiser.
Print Assumptions step_optimal.
Print Assumptions decreasing.
Print Assumptions bounded_away.
