"""The backends of a campaign: this process, worker processes, or a Dask cluster."""

from __future__ import annotations

import multiprocessing
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from concurrent.futures import CancelledError, Executor, Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing.connection import Connection
from typing import Any

from rhl._checks import describe, integer
from rhl.errors import InputError
from rhl.study.campaign import Backend, LostWorkersError

# Seconds that a cluster may be without workers before the campaign stops.
_PATIENCE = 60.0


class _InProcess(Executor):
    """Runs a task when it is submitted, so that an interrupt is raised there."""

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(fn(*args, **kwargs))
        except Exception as error:
            future.set_exception(error)
        return future


def in_process() -> Backend:
    """Return a backend that runs one task after the other in this process."""
    return Backend(_InProcess)


def processes(count: int) -> Backend:
    """Return a backend of that many worker processes, which end with this process in any case.

    Examples
    --------
    >>> processes(2).ahead  # so many tasks wait for them
    4
    """
    integer("workers", count, 1)

    @contextmanager
    def executor() -> Iterator[Executor]:
        context = multiprocessing.get_context("spawn")
        reader, writer = context.Pipe(duplex=False)
        pool = ProcessPoolExecutor(count, context, _begin_worker, (reader,))
        try:
            yield pool
        finally:
            # It ends the workers; after an early end their current tasks are no longer needed.
            writer.close()
            pool.shutdown(cancel_futures=True)
            reader.close()

    return Backend(executor, 2 * count, (BrokenProcessPool,))


def _begin_worker(reader: Connection) -> None:
    # Ctrl-C reaches every process of a terminal; the campaign's process decides how its workers end.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with, args=(reader,), daemon=True).start()


def _end_with(reader: Connection) -> None:
    """End this process when the other end of a pipe is closed, for instance since its process was killed."""
    with suppress(EOFError, OSError):
        reader.recv()
    os._exit(1)


def cluster(address: str, timeout: float = 10.0) -> Backend:
    """Return a backend of the workers of a Dask scheduler, which must have this library installed.

    InputError if no scheduler answers in ``timeout`` seconds, or it has no workers. If a worker is lost, Dask gives
    its tasks to others, a few times.

    Examples
    --------
    >>> cluster("127.0.0.1")
    Traceback (most recent call last):
    rhl.errors.InputError: --scheduler must be the address of a Dask scheduler that answers, got '127.0.0.1': ...
    """
    import distributed
    from distributed.comm.addressing import parse_address, parse_host_port
    from distributed.comm.core import CommClosedError

    client_of: Any = distributed.Client  # it has no types

    def connect() -> Any:
        try:
            # Checked here, because a client with an address without a port fails slowly and with many messages.
            parse_host_port(parse_address(address)[1])
            return client_of(address, timeout=timeout, set_as_default=False)
        except (OSError, ValueError) as error:
            what = " ".join(str(error).split()) or type(error).__name__
            raise InputError(
                f"--scheduler must be the address of a Dask scheduler that answers, got {describe(address)}: "
                f"{what[:120]}"
            ) from None

    with connect() as client:
        threads = sum(client.nthreads().values())
    if not threads:
        raise InputError(
            f"--scheduler must have workers, got none at {describe(address)}; start some with dask worker {address}"
        )
    seen = time.monotonic()
    open_clients: list[Any] = []

    def check() -> None:
        nonlocal seen
        client = open_clients[-1]
        if client.status == "running" and client.nthreads():
            seen = time.monotonic()
        elif time.monotonic() - seen > _PATIENCE:
            raise LostWorkersError(
                f"the scheduler must keep workers, got none for {_PATIENCE:g} s at {describe(address)}"
            )

    @contextmanager
    def executor() -> Iterator[Executor]:
        nonlocal seen
        seen = time.monotonic()
        try:
            opened = connect()
        except InputError as error:  # the scheduler answered before
            raise LostWorkersError(str(error)) from None
        with opened as client:
            open_clients.append(client)
            # Tasks that are submitted again must not get the earlier result or failure.
            pool = client.get_executor(pure=False)
            try:
                yield pool
            finally:
                pool.shutdown(wait=False)

    lost = (distributed.KilledWorker, CommClosedError, CancelledError)
    return Backend(executor, 2 * threads, lost, check)
