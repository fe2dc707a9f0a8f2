"""A Dask cluster and worker processes give what one process gives, also where a worker is killed in mid-campaign."""

import multiprocessing
import os
import signal

import pytest

from rhl import InputError
from rhl.study.backends import cluster, in_process, processes
from rhl.study.campaign import Campaign, Task, run
from rhl.study.choices import Choice
from rhl.study.ensembles import RandomPlants
from rhl.study.store import Store

distributed = pytest.importorskip("distributed")

CAMPAIGN = Campaign(RandomPlants(1, 12, n=(2, 3)), (Choice("d"), Choice("w", "window")), steps=20, chunk=2)


def workers():
    """Worker processes of this one's that are none of Dask's."""
    return [child for child in multiprocessing.active_children() if "Dask" not in child.name]


class Watched:
    """Results that do something once some of them are there."""

    def __init__(self, store, count, then):
        self.store, self.count, self.then = store, count, then

    def done(self):
        return self.store.done()

    def write(self, task, found):
        self.store.write(task, found)
        self.count -= 1
        if self.count == 0:
            self.then()


class Empty:
    """Results of which there are none yet."""

    def done(self):
        return set()


def digest(path, backend, count=-1, then=lambda: None):
    store = Store.create(path, CAMPAIGN, "", {})
    run(CAMPAIGN, Watched(store, count, then), backend)
    assert store.done() == set(CAMPAIGN.tasks())
    return store.digest()


@pytest.fixture(scope="module")
def alone(tmp_path_factory):
    return digest(tmp_path_factory.mktemp("alone") / "a", in_process())


@pytest.fixture(scope="module")
def local():
    """Two worker processes with one thread each."""
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=":0", silence_logs=50
    ) as local:
        yield local


def test_a_cluster(local, alone, tmp_path):
    assert digest(tmp_path / "a", cluster(local.scheduler_address)) == alone


def test_a_cluster_that_loses_a_worker(local, alone, tmp_path):
    victim = next(iter(local.workers.values())).pid
    assert digest(tmp_path / "a", cluster(local.scheduler_address), 3, lambda: os.kill(victim, signal.SIGKILL)) == alone
    assert victim not in [worker.pid for worker in local.workers.values()]


def test_schedulers_that_are_refused():
    with pytest.raises(
        InputError, match=r"--scheduler must be the address of a Dask scheduler .*'nonsense': missing port"
    ):
        cluster("nonsense")
    with pytest.raises(
        InputError, match=r"--scheduler must be the address of a Dask scheduler .* got 'tcp://127\.0\.0\.1:1'"
    ):
        cluster("tcp://127.0.0.1:1", timeout=0.5)
    with (
        distributed.LocalCluster(n_workers=0, dashboard_address=":0", silence_logs=50) as empty,
        pytest.raises(InputError, match="--scheduler must have workers, got none at"),
    ):
        cluster(empty.scheduler_address)


def test_processes_that_lose_a_worker(alone, tmp_path):
    killed = []

    def kill():
        victim = workers()[0]
        killed.append(victim.pid)
        victim.kill()

    assert digest(tmp_path / "a", processes(2), 3, kill) == alone
    assert killed
    assert workers() == []


def test_what_interrupts_a_task_is_raised():
    class Interrupted(Campaign):
        def evaluate(self, task: Task):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run(Interrupted(CAMPAIGN.plants, CAMPAIGN.schemes), Empty(), in_process())


def test_numbers_of_workers():
    with pytest.raises(InputError, match="workers must be an integer of at least 1, got 0"):
        processes(0)
