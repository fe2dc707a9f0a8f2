"""Pictures of ideas: what they draw is the run, and what the picture says of it is so."""

import numpy as np
import pytest

from rhl import V3, InputError, SignalModel, solve
from rhl.paper import drawings
from rhl.paper.claims.proximal import Ridge, Squares, iterate
from rhl.paper.published import linear_example, robot_arm


@pytest.fixture(scope="module")
def linear():
    return linear_example().run()


def labelled(ax):
    return {line.get_label(): line.get_ydata() for line in ax.lines}


def test_window_and_plan_are_those_of_the_run(linear):
    above, below = drawings.window_and_plan(linear, 9).axes
    drawn = labelled(above)
    assert np.array_equal(drawn["measured up to $k$"], linear.y[:10, 0])
    assert np.array_equal(drawn["measured later"], linear.y[10:31, 0])
    for label, k in (("plan of $k$", 9), ("plan of $k+1$", 10)):
        assert np.array_equal(drawn[label], linear.steps[k].plan.x[:, 0])
    (applied,) = labelled(below)["the input that is applied"]
    assert applied == linear.v[9, 0] == linear.steps[9].plan.u[0, 0]
    now, then = (patch.get_bbox() for patch in above.patches)
    assert (now.x0, now.x1, then.x0, then.x1) == (1, 9, 2, 10)  # the window of eight transitions


@pytest.mark.parametrize("k", [7, 41])
def test_no_window_or_no_next_plan(linear, k):
    with pytest.raises(InputError, match=f"k must be from 8 to 40 for a full window and a next plan, got {k}"):
        drawings.window_and_plan(linear, k)


def test_the_arm_hangs_at_angle_zero():
    angles = robot_arm().run().z[:, 0]
    *links, tip = drawings.arm_positions(angles, 5).axes[0].lines
    assert len(links) == len(range(0, len(angles), 5))
    assert np.allclose(np.hypot(*tip.get_xydata().T), 1)
    assert np.allclose(tip.get_xydata()[-1], [0, -1], atol=0.05)
    assert tip.get_ydata().max() > 0.9  # it passes the top


def test_the_sum_of_plans_is_drawn_where_it_is():
    model, zero = SignalModel([[1.1, 0.5], [0.0, 0.9]], [[0.0], [1.0]]), np.zeros(2)
    x, r = np.array([2.0, -0.5]), np.array([-1.0, 0.6])
    parts = {
        "from x": solve(V3(model, 1.0, 1.0, zero, 8), x),
        "to r": solve(V3(model, 1.0, 1.0, r, 8), zero),
    }
    whole = solve(V3(model, 1.0, 1.0, r, 8), x)
    for name, total, adds_up in (("both", whole, True), ("to r only", parts["to r"], False)):
        for ax in drawings.superposed(parts, (name, total)).axes:
            drawn = labelled(ax)
            assert np.allclose(drawn["sum of the two"], drawn[name], atol=1e-9) == adds_up


def test_a_shifted_plan_begins_a_step_later():
    now = np.arange(8.0).reshape(4, 2), np.ones((3, 1))
    shifted = now[0] + 1, np.array([[1.0], [1.0], [0.0]])
    above, below = drawings.shifted_plan(now, shifted, now).axes
    assert [line.get_xdata()[0] for line in above.lines] == [0, 1, 1]
    assert labelled(below)["the appended input"] == [0.0]
    assert [text.get_text() for text in above.texts] == ["$r$", r"$\tilde r^+$", "$r^+$"]
    assert above.texts[1].xy == (4, shifted[0][-1, 0])


def test_projections_lie_on_their_lines():
    normals, common = np.array([[1.0, 0.5], [0.2, 1.0]]), np.array([0.5, 0.3])
    levels = normals @ common
    run = iterate(
        [Ridge(a, float(b)) for a, b in zip(normals, levels, strict=True)], Squares(), np.array([2.0, 1.0]), np.zeros(2)
    )
    ax = drawings.projections(normals, levels, run.centres, run.minimisers, common).axes[0]
    dotted = [line.get_xydata() for line in ax.lines if line.get_linestyle() == ":"]
    assert len(dotted) == 2
    for (begin, foot), a, b, centre, best in zip(dotted, normals, levels, run.centres, run.minimisers, strict=False):
        assert np.array_equal(begin, centre)
        assert abs(a @ foot - b) < 1e-12 < abs(a @ centre - b)
        # With squares the step goes towards the projection, and not as far.
        share = (best - centre) / (foot - centre)
        assert np.ptp(share) < 1e-9
        assert 0 < share[0] < 1
