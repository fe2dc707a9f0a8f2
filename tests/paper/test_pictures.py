"""Pictures, sliders and maps show what is on record; a place or a setting that changes is noticed."""

import json

import numpy as np
import pytest

from rhl.paper import motion
from tests.pictures import PICTURES, RECORD, SETTINGS, of_text

KEPT = json.loads(RECORD.read_text(encoding="utf-8"))
# The numbers come from runs whose last digits depend on the processor, and some are written with one decimal place.
RTOL = 1e-4


def test_every_picture_is_on_record():
    assert list(KEPT) == list(PICTURES)


@pytest.mark.parametrize("name", PICTURES)
def test_a_picture_shows_what_is_on_record(name):
    found, kept = PICTURES[name](), KEPT[name]
    if name == SETTINGS:
        assert found == pytest.approx(kept, rel=1e-9)
    else:
        assert found[0] == kept[0]
        assert np.allclose(found[1:], kept[1:], rtol=RTOL, atol=RTOL * kept[2])


def test_another_place_is_noticed():
    angles = np.linspace(1, 0, 9)
    drawn = of_text(motion.link(angles, 2.0, "A.", "B.", np.arange(9.0))._repr_html_())
    moved = of_text(motion.link(angles + 0.02, 2.0, "A.", "B.", np.arange(9.0))._repr_html_())
    assert np.allclose(drawn, KEPT["moving link"], rtol=RTOL)
    assert not np.allclose(moved, KEPT["moving link"], rtol=RTOL, atol=RTOL * drawn[2])
