"""Drawings that move: they go through the run's own angles, and stand still until asked."""

import re

import numpy as np
from bs4 import BeautifulSoup

from rhl.paper import motion

ALT = "A link turns upright and stays."


def test_a_link_goes_through_every_angle_once_when_asked():
    angles = np.linspace(1.0, 0.0, 11)
    page = BeautifulSoup(motion.link(angles, 2.0, ALT, "A link.")._repr_html_(), "html.parser")
    (moves,) = page.select("animatetransform")
    assert np.allclose([float(value) for value in moves["values"].split(";")], np.degrees(angles), atol=0.01)
    assert (moves["begin"], moves["dur"]) == ("indefinite", "2s")
    assert page.svg["aria-label"] == ALT
    assert "beginElement" in page.button["onclick"]


def test_a_cart_moves_its_link_and_stays_in_the_picture():
    base = np.array([0.0, 50.0, -20.0])
    page = BeautifulSoup(motion.link(np.zeros(3), 2.0, ALT, "A link.", base)._repr_html_(), "html.parser")
    along = next(moves["values"] for moves in page.select("animatetransform") if moves["type"] == "translate")
    places = np.array([float(pair.split()[0]) for pair in along.split(";")])
    assert places.min() > 0
    assert places.max() < 360
    assert np.allclose(np.diff(places) / np.diff(base), np.diff(places)[0] / 50.0, rtol=1e-3)


def test_words_of_a_drawing_are_text():
    markup = motion.link(np.zeros(3), 2.0, 'A "link" turns <b>.', "A link & more.")._repr_html_()
    assert re.search(r'aria-label="A &quot;link&quot; turns &lt;b&gt;\."', markup)
    assert "A link &amp; more." in markup
