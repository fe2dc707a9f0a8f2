"""Two sizes of the same test: a small one for every commit, and the one of `make test-all` for the night."""

import os


def size(small: int, nightly: int) -> int:
    """How many random examples to draw."""
    return nightly if os.environ.get("RHL_NIGHTLY") else small
