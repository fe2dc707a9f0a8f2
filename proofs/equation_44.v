(** Equation (44), as corrected: the three-point identity.

    It holds for every function g and every field of slopes, a gradient or not.
    For a quadratic g the slopes are its gradient, and D(x, y) is g(x - y). *)

From mathcomp Require Import all_ssreflect all_algebra.

Set Implicit Arguments.
Unset Strict Implicit.
Unset Printing Implicit Defensive.

Import GRing.Theory.
Local Open Scope ring_scope.

(** The tactic [ring] wants a ring whose operations are variables. *)
Section Cancelled.

Variables (T : Type) (o i : T) (add mul sub : T -> T -> T) (opp : T -> T).
Hypothesis theory : ring_theory o i add mul sub opp (@eq T).
Add Ring T : theory.
Local Notation "x + y" := (add x y).
Local Notation "x - y" := (sub x y).

Lemma cancelled ga gb gc p q r :
  p - q = ga - gb - q + (gb - gc - r) - (ga - gc - (p + r)).
Proof. ring. Qed.

End Cancelled.

Section ThreePoint.

Variable R : comRingType.
Variable n : nat.
Implicit Types x y a b c : 'rV[R]_n.

Let theory : ring_theory 0 1 +%R *%R (fun x y : R => x - y) -%R eq.
Proof.
split=> //; [exact: add0r | exact: addrC | exact: addrA | exact: mul1r
  | exact: mulrC | exact: mulrA | exact: mulrDl | exact: subrr].
Qed.

Definition dot x y : R := (x *m y^T) ord0 ord0.

Lemma dotBl x y a : dot (x - y) a = dot x a - dot y a.
Proof. by rewrite /dot mulmxBl !mxE. Qed.

Lemma dotDr x a b : dot x (a + b) = dot x a + dot x b.
Proof. by rewrite /dot linearD mulmxDr !mxE. Qed.

Lemma dotDl x y a : dot (x + y) a = dot x a + dot y a.
Proof. by rewrite /dot mulmxDl !mxE. Qed.

Lemma dotC x y : dot x y = dot y x.
Proof. by rewrite /dot -[x *m y^T]trmxK trmx_mul trmxK mxE. Qed.

(** The distance that g and its slopes induce. *)
Definition D (g : 'rV[R]_n -> R) (slope : 'rV[R]_n -> 'rV[R]_n) x y : R :=
  g x - g y - dot (slope y) (x - y).

(** [a] is the common minimiser, [b] the new one, [c] the proximal centre. *)
Theorem three_point g slope a b c :
  dot (slope c - slope b) (a - b)
  = D g slope a b + D g slope b c - D g slope a c.
Proof.
rewrite dotBl /D -[a - c](subrKA b) (dotDr _ (a - b)).
exact: (cancelled theory).
Qed.

Section Quadratic.

Variable Q : 'M[R]_n.

Definition quadratic x : R := dot (x *m Q) x.
Definition gradient x : 'rV[R]_n := x *m (Q + Q^T).

(** The slopes are the gradient: the rest is of second order. *)
Theorem gradient_expands x a :
  quadratic (x + a) = quadratic x + dot (gradient x) a + quadratic a.
Proof.
have turned : dot (a *m Q) x = dot (x *m Q^T) a.
  by rewrite dotC /dot trmx_mul mulmxA.
rewrite /quadratic /gradient mulmxDl mulmxDr !dotDl !dotDr turned.
by rewrite !addrA.
Qed.

Theorem quadratic_distance x y : D quadratic gradient x y = quadratic (x - y).
Proof.
have := gradient_expands y (x - y); rewrite [y + _]addrC subrK /D => ->.
by rewrite -addrA -opprD addrC addKr.
Qed.

(** Equation (44) for quadratic g. *)
Theorem three_point_quadratic a b c :
  dot (gradient c - gradient b) (a - b)
  = quadratic (a - b) + quadratic (b - c) - quadratic (a - c).
Proof. by rewrite (three_point quadratic gradient) !quadratic_distance. Qed.

End Quadratic.
End ThreePoint.

Print Assumptions three_point.
Print Assumptions gradient_expands.
Print Assumptions three_point_quadratic.
