"""Linear algebra of small matrices."""

import math
import operator

from .arrays import array, zeros


class LinAlgError(ValueError):
    """A matrix is not what a factorisation needs."""


def cholesky(M):
    """Return the lower triangular factor of a positive definite matrix."""
    n = len(M)
    L = zeros((n, n))
    for j in range(n):
        pivot = M[j, j] - sum(L[j, k] ** 2 for k in range(j))
        if not pivot > 0:
            raise LinAlgError("the matrix is not positive definite")
        L[j, j] = math.sqrt(pivot)
        for i in range(j + 1, n):
            L[i, j] = (M[i, j] - sum(L[i, k] * L[j, k] for k in range(j))) / L[j, j]
    return L


def svd(M, compute_uv=True):
    """Return the singular values, largest first, by Jacobi's rotations of the shorter side's vectors."""
    if compute_uv or M.ndim != 2:
        raise NotImplementedError("only the singular values of one matrix")
    largest = max(max(abs(M).tolist(), key=max))
    if largest == 0:
        return zeros(min(M.shape))
    scaled = M / largest  # so that no square leaves the range of floating-point numbers
    rows = scaled.tolist() if M.shape[0] <= M.shape[1] else scaled.T.tolist()
    for _ in range(60):
        turned = False
        for i in range(len(rows)):
            for j in range(i + 1, len(rows)):
                a, b = rows[i], rows[j]
                aa, bb, ab = (sum(map(operator.mul, s, t)) for s, t in ((a, a), (b, b), (a, b)))
                if abs(ab) <= 1e-16 * math.sqrt(aa) * math.sqrt(bb):
                    continue
                turned = True
                zeta = (bb - aa) / (2 * ab)
                t = math.copysign(1.0, zeta) / (abs(zeta) + math.hypot(1.0, zeta))
                c = 1 / math.hypot(1.0, t)
                rows[i] = [c * (x - t * y) for x, y in zip(a, b, strict=True)]
                rows[j] = [c * (t * x + y) for x, y in zip(a, b, strict=True)]
        if not turned:
            break
    return array(sorted((largest * math.hypot(*row) for row in rows), reverse=True))


def eigvalsh(M):
    """Return the eigenvalues of a symmetric matrix, least first, by Jacobi's rotations."""
    A, n = M.tolist(), len(M)
    for _ in range(60):
        for p in range(n):
            for q in range(p + 1, n):
                if A[p][q] == 0:
                    continue
                zeta = (A[q][q] - A[p][p]) / (2 * A[p][q])
                t = math.copysign(1.0, zeta) / (abs(zeta) + math.hypot(1.0, zeta))
                c = 1 / math.hypot(1.0, t)
                for k in range(n):
                    x, y = A[k][p], A[k][q]
                    A[k][p], A[k][q] = c * (x - t * y), c * (t * x + y)
                for k in range(n):
                    x, y = A[p][k], A[q][k]
                    A[p][k], A[q][k] = c * (x - t * y), c * (t * x + y)
    return array(sorted(A[i][i] for i in range(n)))
