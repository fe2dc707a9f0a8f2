"""A step of the paper's linear example, by rhl and by others, each with its accuracy; many loops at once; memory."""

import tracemalloc

import numpy as np
import pytest

from benchmarks import peers
from rhl.horizon import first_input
from rhl.paper.published import replay_published
from rhl.simulation import simulate
from tests import oracle

# The 40 problems that the published data pose. Rounding their data to float64 already moves their exact answers by up
# to 8e-14 (``oracle.movement``), so that 1e-12 leaves one digit for the recursion.
FROZEN = replay_published().steps[-40:]
ACCURATE = 1e-12
# y, v and z of the example are 5 numbers, 40 bytes; this leaves as much again for what does not grow with the steps.
BYTES = 100
# That a peer's loop is the same scheme: the inputs, of order one, differ by its solver's error, which the steps that
# follow enlarge; by 20 at most among these peers.
ENLARGED = 100
BATCH_STEPS = 40


def exactly(done):
    """u_0 of a step's problem in extended precision."""
    of = done.plan.problem
    return oracle.riccati(of.model.A, of.model.B, of.Q, of.R, of.QN, of.weight, of.horizon, done.plan.x[0])


@pytest.fixture(scope="module")
def answers():
    """The exact u_0 of every frozen problem."""
    return [exactly(done) for done in FROZEN]


def worst(solver, answers):
    """The largest relative error of a solver's u_0 on the frozen problems."""
    found = (solver(d.problem.model.A, d.problem.model.B, float(d.problem.weight), d.plan.x[0]) for d in FROZEN)
    return max(oracle.relative_error(u, true) for u, true in zip(found, answers, strict=True))


def own(A, B, weight, x):
    """u_0 by rhl."""
    problem = FROZEN[0].problem
    model = type(problem.model)(A, B)
    return first_input(model, peers.SCHEME.factors, problem.horizon, np.asarray(weight), x)


def starts(members):
    """Initial states of a batch, around the example's."""
    return peers.EXAMPLE.z0 * np.linspace(0.5, 1.5, members)[:, None]


def run(members=None, steps=peers.STEPS):
    z0 = peers.EXAMPLE.z0 if members is None else starts(members)
    return simulate(peers.SCHEME, peers.PLANT, z0, steps)


def test_step(benchmark, answers):
    benchmark.group = "a step of the linear example, everything included"
    trace = benchmark.pedantic(run, rounds=40, warmup_rounds=2)
    in_the_loop = max(oracle.relative_error(done.v_computed, exactly(done)) for done in trace.steps)
    error = max(worst(own, answers), in_the_loop)
    benchmark.extra_info.update({"row": "rhl", "steps": peers.STEPS, "error of u_0": error})
    assert error <= ACCURATE


@pytest.mark.parametrize("name", peers.PEERS)
def test_step_of_a_peer(benchmark, answers, name):
    benchmark.group = "a step of the linear example, everything included"
    try:
        solver = peers.PEERS[name]()
    except ImportError as error:
        pytest.skip(f"{error.name} is not installed")
    error = worst(solver, answers)
    inputs = benchmark.pedantic(peers.loop, (solver,), rounds=10, warmup_rounds=1)
    benchmark.extra_info.update({"row": name, "steps": peers.STEPS, "error of u_0": error})
    np.testing.assert_allclose(inputs, run().v[:, 0], rtol=0, atol=ENLARGED * error)


@pytest.mark.parametrize("members", [100, 1000, 10000])
def test_batch(benchmark, members):
    benchmark.group = f"batches of closed loops, {BATCH_STEPS} steps each: time a plant"
    rounds = max(1, min(20, 5000 // members))
    trace = benchmark.pedantic(run, (members, BATCH_STEPS), rounds=rounds, warmup_rounds=members < 10000)
    assert np.all(trace.diverged_at < 0)
    benchmark.extra_info.update({"row": f"{members} plants", "steps": members})
    if benchmark.stats:
        benchmark.extra_info["systems a second and core"] = round(members / benchmark.stats.stats.median)


@pytest.mark.parametrize("members", [1000])
def test_memory(benchmark, members):
    benchmark.group = "what a batch's trace keeps"
    run(members, BATCH_STEPS)
    tracemalloc.start()
    before = tracemalloc.get_traced_memory()[0]
    trace = benchmark.pedantic(run, (members, BATCH_STEPS), rounds=1)
    kept, peak = (memory - before for memory in tracemalloc.get_traced_memory())
    tracemalloc.stop()
    assert len(trace) == BATCH_STEPS
    each = members * BATCH_STEPS
    benchmark.extra_info["row"] = f"{members} plants, {BATCH_STEPS} steps, while memory is traced"
    benchmark.extra_info["bytes kept a plant and step"] = round(kept / each)
    benchmark.extra_info["at most meanwhile"] = round(peak / each)
    assert kept / each <= BYTES
