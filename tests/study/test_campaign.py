"""What a task finds depends on neither chunks nor workers, agrees with one run alone, and survives lost workers."""

import pickle
from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from contextlib import nullcontext
from dataclasses import replace

import numpy as np
import pytest

from rhl import InputError, LinearPlant, Saturation, simulate
from rhl.scheme import default_scheme, window_scheme
from rhl.study.backends import in_process, processes
from rhl.study.campaign import (
    PLANT_VARIABLES,
    RUN_VARIABLES,
    Backend,
    Campaign,
    LostWorkersError,
    Task,
    run,
    summary,
)
from rhl.study.choices import Choice
from rhl.study.compare import compare
from rhl.study.ensembles import BenchmarkPlants, Drawn, RandomPlants

PLANTS = RandomPlants(1, 6, n=(2, 3), p=(1, 2), conditioning=10.0)
CAMPAIGN = Campaign(PLANTS, (Choice("default"), Choice("window", "window")), steps=30, chunk=5)


class Kept:
    """Results in memory."""

    def __init__(self, done=()):
        self.found = dict.fromkeys(done)
        self.written = []

    def done(self):
        return set(self.found)

    def write(self, task, found):
        self.found[task] = found
        self.written.append(task)


def gathered(campaign, kept):
    """Every variable as one array, whatever the chunks."""
    tasks = sorted(kept.found, key=lambda task: (task.scheme is not None, task.scheme or 0, task.first))
    assert tasks == list(campaign.tasks())
    return {
        name: np.concatenate([kept.found[task][name] for task in tasks if name in kept.found[task]])
        for name in (*PLANT_VARIABLES, *RUN_VARIABLES)
    }


def results(campaign, backend=None):
    kept = Kept()
    run(campaign, kept, backend or in_process())
    return gathered(campaign, kept)


def differing(one, other):
    return [name for name in one if not np.array_equal(one[name], other[name])]


@pytest.mark.parametrize("settings", [{}, {"noise": 0.01}, {"input_bound": 0.5}])
def test_chunks_do_not_matter(settings):
    campaign = replace(CAMPAIGN, **settings)
    found = [results(replace(campaign, chunk=chunk)) for chunk in (24, 5, 1)]
    assert [differing(found[0], other) for other in found[1:]] == [[], []]


def test_workers_do_not_matter():
    told = []
    kept = Kept()
    run(CAMPAIGN, kept, processes(2), progress=told.append)
    assert differing(gathered(CAMPAIGN, kept), results(CAMPAIGN)) == []
    assert told == list(range(16))
    assert sorted(kept.written, key=str) == sorted(CAMPAIGN.tasks(), key=str)


def test_other_seeds_steps_and_noise_do():
    found = results(CAMPAIGN)
    assert "peak" in differing(found, results(replace(CAMPAIGN, plants=replace(PLANTS, seed=2))))
    assert "final_size" in differing(found, results(replace(CAMPAIGN, steps=31)))
    assert "peak" in differing(found, results(replace(CAMPAIGN, noise=1e-3)))
    assert "largest_input" in differing(found, results(replace(CAMPAIGN, input_bound=0.01)))


def test_what_is_done_is_not_done_again():
    tasks = list(CAMPAIGN.tasks())
    kept = Kept(tasks[::2])
    told = []
    run(CAMPAIGN, kept, in_process(), progress=told.append)
    assert kept.written == tasks[1::2]
    assert told[0] == len(tasks[::2])


@pytest.mark.parametrize("base", ["default", "window"])
def test_a_run_is_that_of_simulate_alone(base):
    campaign = Campaign(PLANTS, (Choice(base, base, order_factor=1.5),), steps=40, input_bound=2.0)
    found = campaign.evaluate(Task(0, 0, len(PLANTS)))
    for i in (0, 7, 23):
        one = PLANTS.draw(i)
        _, p, q, bound = one.size
        scheme = (default_scheme if base == "default" else window_scheme)(p, q, int(np.ceil(1.5 * bound)))
        plant = LinearPlant(one.F, one.G, one.H)
        trace = simulate(scheme, plant, one.z0, 40, actuator=Saturation(-2.0, 2.0), record="signals")
        assert found["peak"][i] == np.abs(trace.y).max() / np.abs(trace.y[0]).max()
        assert found["largest_input"][i] == np.abs(trace.v).max() <= 2.0
        assert found["final_size"][i] == np.abs(trace.y[-20:]).max() / np.abs(trace.y[0]).max()


def test_scores_are_those_of_compare():
    plants = BenchmarkPlants(("toy", "ac1", "rea", "he1"))
    campaign = Campaign(plants, (Choice("window_scheme", "window"), Choice("default_scheme")), steps=60)
    for at, choice in enumerate(campaign.schemes):
        found = campaign.evaluate(Task(at, 0, 4))
        for i in range(4):
            one = plants.draw(i)
            score = {score.method: score for score in compare(LinearPlant(one.F, one.G, one.H), one.z0, one.bound, 60)}[
                choice.label
            ]
            settled = None if found["settled_at"][i] < 0 else found["settled_at"][i]
            assert (found["at_rest"][i], settled) == (score.at_rest, score.settled_at)
            # One run is compiled as a whole and the other may be taken step by step.
            assert np.isclose(found["peak"][i], score.peak, rtol=1e-9)
            assert np.isclose(found["largest_input"][i], score.largest_input, rtol=1e-9)


class Given:
    """An ensemble of given plants of one state, which are told apart by F."""

    def __init__(self, *F):
        self.F = F

    def __len__(self):
        return len(self.F)

    def draw(self, i):
        return Drawn([[self.F[i]]], [[1.0 if abs(self.F[i]) < 2 else 1e-12]], [[1.0]], [1.0], 1)

    def sizes(self):
        return {(1, 1, 1)}

    def errors(self, i):
        return np.random.SeedSequence(i)

    def labels(self):
        return []


def test_rest_and_divergence_are_told_apart():
    found = Campaign(Given(0.5, 1.2, 1e9), (Choice("w", "window"),), steps=60).evaluate(Task(0, 0, 3))
    assert found["at_rest"].tolist() == [True, True, False]
    assert found["diverged_at"][0] == found["diverged_at"][1] == -1 < found["diverged_at"][2] < 60
    assert np.isposinf([found[name][2] for name in ("peak", "largest_input", "final_size")]).all()
    assert found["settled_at"][2] == -1 < min(found["settled_at"][:2])
    assert not any(np.isnan(values).any() for values in found.values())


def test_noise_is_the_plants_own_and_of_its_size():
    quiet, noisy = (
        Campaign(Given(0.5, 0.5), (Choice("d"), Choice("w", "window")), steps=60, noise=noise) for noise in (0.0, 0.02)
    )
    assert max(quiet.evaluate(Task(0, 0, 2))["final_size"]) < 1e-6
    found = noisy.evaluate(Task(1, 0, 2))["final_size"]
    assert found[0] != found[1]
    assert np.all((found > 0.01) & (found < 0.2))


def test_facts():
    found = Campaign(Given(0.5, 1.2), (Choice("d"),), steps=20).evaluate(Task(None, 0, 2))
    assert found["spectral_radius"].tolist() == [0.5, 1.2]
    assert found["stabilizability_margin"][0] == np.inf
    assert np.isclose(found["stabilizability_margin"][1], 1 / np.hypot(1.2, 1))
    assert set(found) == set(PLANT_VARIABLES)


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"steps": 19}, "steps must be an integer of at least 20, got 19"),
        ({"chunk": 0}, "chunk must be an integer of at least 1, got 0"),
        ({"noise": -1.0}, "noise must be a number of at least 0, got -1.0"),
        ({"input_bound": 0.0}, "input_bound must be a positive finite number, got 0.0"),
        ({"schemes": ()}, "schemes must have at least one entry, got none"),
        ({"schemes": (Choice("a"), Choice("a"))}, "schemes must have distinct labels, got 'a' twice"),
        ({"schemes": ("default",)}, "schemes must be a Choice, got 'default'"),
    ],
)
def test_campaigns_that_are_refused(settings, sentence):
    with pytest.raises(InputError, match=sentence):
        replace(CAMPAIGN, **settings)


class Failing(Executor):
    """Loses its workers at some of the tasks that it is given."""

    def __init__(self, at):
        self.at, self.count = at, 0

    def submit(self, fn, /, *args, **kwargs):
        self.count += 1
        future = Future()
        if self.count in self.at:
            future.set_exception(BrokenProcessPool("a process was terminated"))
        else:
            future.set_result(fn(*args, **kwargs))
        return future


def failing(*at):
    executor = Failing(at)
    return Backend(lambda: nullcontext(executor), 3, (BrokenProcessPool,)), executor


def test_lost_workers_are_replaced():
    backend, executor = failing(2, 7, 8)
    assert differing(results(CAMPAIGN, backend), results(CAMPAIGN)) == []
    assert executor.count > len(list(CAMPAIGN.tasks()))


def test_workers_lost_again_and_again():
    backend, _ = failing(*range(4, 100))
    kept = Kept()
    with pytest.raises(LostWorkersError, match="workers must stay until their tasks are done, got 4 losses"):
        run(CAMPAIGN, kept, backend)
    assert set(kept.written) < set(CAMPAIGN.tasks())
    run(CAMPAIGN, kept, in_process())
    assert differing(gathered(CAMPAIGN, kept), results(CAMPAIGN)) == []


def test_other_errors_are_let_through():
    class Faulty(Given):
        def draw(self, i):
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(Campaign(Faulty(1.0), (Choice("d"),)), Kept(), in_process())


def test_a_campaign_can_be_sent():
    copy = pickle.loads(pickle.dumps(CAMPAIGN))
    assert copy == CAMPAIGN
    assert copy != replace(CAMPAIGN, plants=replace(PLANTS, seed=2))


def test_summary():
    xr = pytest.importorskip("xarray")
    peak = np.array([np.arange(1.0, 101.0), np.full(100, np.inf)])
    found = xr.Dataset(
        {
            "peak": (("scheme", "plant"), peak),
            "at_rest": (("scheme", "plant"), peak <= 95),
            "diverged_at": (("scheme", "plant"), np.where(np.isinf(peak), 7, -1)),
        },
        {"scheme": ["a", "b"]},
    )
    peaks = ("peak_50", "peak_90", "peak_99")
    assert summary(found) == [
        {
            "scheme": "a",
            "plants": 100,
            "at_rest": 0.95,
            **dict(zip(peaks, (50.0, 90.0, 99.0), strict=True)),
            "diverged": 0.0,
        },
        {"scheme": "b", "plants": 100, "at_rest": 0.0, **dict.fromkeys(peaks, np.inf), "diverged": 1.0},
    ]
