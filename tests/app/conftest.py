"""Tables are as wide here as where nobody says how wide a line may be."""

import pytest


@pytest.fixture(autouse=True)
def _no_width(monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
