"""Two sizes of the same test: a small one for every commit, and the one of `make test-all` for the night."""

import os

_NIGHTLY = bool(os.environ.get("RHL_NIGHTLY"))

# Of the claims' random cases. The ledger's page judges every claim with seed 0, so a commit tries another one.
SEEDS = range(5) if _NIGHTLY else (1,)


def size(small: int, nightly: int) -> int:
    """How many random examples to draw, plants to run, or cases to try."""
    return nightly if _NIGHTLY else small
