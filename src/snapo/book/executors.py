"""Executors, which compute jobs: processes of this machine, Dask, Ray, or a user's executor.

snapo starts no cluster: it joins one. Anyone who can reach the port of a scheduler can run code
there: an address outside this machine needs TLS (Dask) or a token (Ray), or `--trust-network`.
"""

import importlib
import ipaddress
import logging
import multiprocessing
import os
import sys
import threading
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from functools import partial
from typing import Any
from urllib.parse import urlsplit

from snapo.case.error import CaseError
from snapo.engine.workers import Work, WorkerPool

IN_FLIGHT = 1000  # jobs that an executor of others has at most: it shares them out itself


def worker_pools(
    where: str, workers: int | None = None, trust_network: bool = False
) -> list[WorkerPool]:
    """The places where jobs run, from `--on WHERE`; "" is this machine, with one process for each
    core.

    **Raises:** `CaseError` if there is no such place, or if its network is open to others.
    """
    if not where:
        return _processes(workers)
    kind, _, address = where.partition(":")
    if kind == "dask":
        return [_dask(address, trust_network)]
    if kind == "ray":
        return [_ray(address, trust_network)]
    return _named(where)


def _processes(workers: int | None) -> list[WorkerPool]:
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else [0]
    count = workers or len(cores)
    # One job in work and the next one: a worker does not wait for the driver.
    return [WorkerPool(partial(_process, cores[i % len(cores)]), 2) for i in range(count)]


def _process(core: int) -> Executor:
    context = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(1, mp_context=context, initializer=start_worker, initargs=(core,))


def start_worker(core: int) -> None:
    """A worker uses one core for its kernels and for XLA, does not return its memory to the system,
    and ends with its driver, because nothing else would end it if the driver is killed."""
    from snapo.study.prepare import keep_memory

    if (driver := multiprocessing.parent_process()) is not None:
        threading.Thread(target=_end_with, args=(driver,), daemon=True).start()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {core})
    keep_memory()


def _end_with(driver: Any) -> None:
    driver.join()
    os._exit(1)


def _named(where: str) -> list[WorkerPool]:
    """The executors of MODULE:FACTORY; the factory returns one executor or several."""
    module, _, name = where.partition(":")
    sys.path.insert(0, os.getcwd())
    try:
        made = getattr(importlib.import_module(module), name)()
        executors = [made] if hasattr(made, "submit") else list(made)
    except (ImportError, AttributeError, ValueError, TypeError) as error:
        allowed = (
            "it must be dask:ADDRESS, ray:ADDRESS, or MODULE:FUNCTION of a function that returns "
            f"an executor ({error})"
        )
        raise CaseError("--on", "", where, allowed) from None
    finally:
        sys.path.pop(0)
    count = max(2, IN_FLIGHT // len(executors))
    return [WorkerPool.of(executor, count) for executor in executors]


def _dask(address: str, trust_network: bool) -> WorkerPool:
    try:
        from distributed import Client  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise _missing("dask") from None
    parts = urlsplit(address if "//" in address else f"tcp://{address}")
    if parts.scheme != "tls" and not trust_network and not _loopback(parts.hostname):
        message = "this scheduler has no TLS (tls://…): anyone who can reach it can run code there"
        raise _open(f"dask:{address}", message)
    try:
        client = Client(address, timeout=20)
    except (OSError, ValueError, TimeoutError, TypeError) as error:
        raise CaseError("--on", "", f"dask:{address}", f"no scheduler answers: {error}") from None

    def make() -> Executor:
        return client.get_executor(pure=False)

    threads = sum(client.nthreads().values())  # pyright: ignore[reportAttributeAccessIssue]
    return WorkerPool(make, IN_FLIGHT, client.close, max(1, threads))


def _ray(address: str, trust_network: bool) -> WorkerPool:
    try:
        import ray  # pyright: ignore[reportMissingImports]
    except ImportError:
        raise _missing("ray") from None
    parts = urlsplit(address if "//" in address else f"ray://{address}")
    token = os.environ.get("RAY_AUTH_MODE") == "token"
    near = address in ("auto", "local") or _loopback(parts.hostname)
    if not near and not token and not trust_network:
        message = (
            "this cluster has no token (RAY_AUTH_MODE=token): anyone who can reach it can run "
            "code there"
        )
        raise _open(f"ray:{address}", message)
    try:
        ray.init(address=address, logging_level=logging.ERROR, log_to_driver=False)
    except (OSError, ValueError, ConnectionError, RuntimeError) as error:
        raise CaseError("--on", "", f"ray:{address}", f"no cluster answers: {error}") from None
    cores = int(ray.cluster_resources().get("CPU", 1))
    return WorkerPool(RayExecutor, IN_FLIGHT, ray.shutdown, max(1, cores))


class RayExecutor:
    """Ray as an executor of `concurrent.futures`, which Ray does not provide (ray issue 29456)."""

    def __init__(self):
        import ray  # pyright: ignore[reportMissingImports]

        self.remote: Any = ray.remote(num_cpus=1, max_retries=0)(_called)

    def submit(self, fn: Work, job: bytes, /) -> "Future[bytes]":
        return self.remote.remote(fn, job).future()

    def shutdown(self, wait: bool = True) -> None:
        """Does nothing: the cluster was not started by snapo."""


def _called(work: Work, job: bytes) -> bytes:
    return work(job)


def _missing(extra: str) -> CaseError:
    return CaseError("--on", "", extra, f'{extra} is missing: pip install "snapo[{extra}]"')


def _open(where: str, message: str) -> CaseError:
    allowed = f"{message}; --trust-network accepts this risk"
    return CaseError("--on", "", where, allowed)


def _loopback(host: str | None) -> bool:
    if host == "localhost":
        return True
    try:
        return ipaddress.ip_address(host or "").is_loopback
    except ValueError:
        return False
