"""Jobs for worker processes on this machine or on a cluster, and for threads of this process."""

import logging
import os
import pickle
from collections.abc import Callable, Hashable, Iterable, Iterator
from concurrent.futures import BrokenExecutor, CancelledError, Executor, Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from itertools import islice, pairwise
from math import inf
from queue import SimpleQueue
from time import monotonic
from typing import TYPE_CHECKING, Any, NoReturn, TypeVar

from multiscale.errors import CaseError, MultiscaleError

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

USABLE = 0.8  # of the memory of a machine

Key = TypeVar("Key", bound=Hashable)
Result = TypeVar("Result")

IN_FLIGHT = 1024
"""Jobs that are submitted and not finished: enough for hundreds of workers, small in memory."""

LOST = 300.0
"""Time, s, without any worker of a cluster that had some, after which jobs are given up."""

_thread_counts: list[int] = []  # of the ``with threads(count)`` that the process is in


def run_jobs(
    function: Callable[..., Result],
    jobs: Iterable[tuple[Key, tuple[Any, ...]]],
    executor: Executor | None,
    finish: Callable[[Key, Result], None],
) -> None:
    """Call a function once for each job, and process the results in the order of completion.

    Jobs, a key and arguments each, are drawn only when they are submitted, so that any number of
    jobs needs little memory, and each finished job makes room for the next: a slow worker does not
    delay the others. ``finish(key, result)`` is called in this process. With an executor of
    ``concurrent.futures``, dask (``Client.get_executor()``) or mpi4py the function must be
    importable by name; workers call it with one thread for kernels, because they share the machine,
    unless their ``OMP_NUM_THREADS`` is set. A pool must spawn its processes: threads of kernels do
    not survive a fork. Without an executor, jobs run one after another with all threads.
    """
    if executor is None:
        for key, arguments in jobs:
            finish(key, function(*arguments))
        return
    pending, done = iter(jobs), 0
    in_flight: dict[Future[Result], Key] = {}
    ended: SimpleQueue[Future[Result]] = SimpleQueue()
    try:
        while True:
            for key, arguments in islice(pending, IN_FLIGHT - len(in_flight)):
                future = executor.submit(call_on_one_thread, _Job(function, arguments))
                in_flight[future] = key
                future.add_done_callback(ended.put)
            if not in_flight:
                return
            future = ended.get()
            finish(in_flight.pop(future), future.result())
            done += 1
    except BrokenExecutor as error:
        # the last line of the traceback names the exception of a result that cannot be loaded
        reason = str(error.__cause__ or "").strip(" \n'\"").splitlines()[-1:]
        reason = reason or ["perhaps for lack of memory, or because it was forked, not spawned"]
        raise MultiscaleError(
            f"a worker process died after {done} finished jobs ({reason[0]}); finished results "
            f"remain, so run again with fewer jobs"
        ) from error
    except CancelledError as error:
        raise MultiscaleError(
            f"the workers disappeared after {done} finished jobs; finished results remain, so run "
            f"again when workers are available"
        ) from error
    finally:
        for future in in_flight:
            future.cancel()


class _Job:
    """A call that its worker loads inside the job, so that a failed import ends no worker."""

    def __init__(self, function: Callable[..., Any], arguments: tuple[Any, ...]) -> None:
        self.function, self.arguments = function, arguments

    def __call__(self) -> Any:
        return self.function(*self.arguments)

    def __reduce__(self) -> tuple[Callable[[bytes], "_Job"], tuple[bytes]]:
        return _load_job, (pickle.dumps((self.function, self.arguments)),)


def _load_job(pickled: bytes) -> _Job:
    try:
        return _Job(*pickle.loads(pickled))
    except Exception as error:
        return _Job(_refuse, (f"{type(error).__name__}: {error}",))


def _refuse(reason: str) -> NoReturn:
    raise MultiscaleError(f"a worker process cannot load the function or data of its job: {reason}")


def call_on_one_thread(function: Callable[..., Result], *arguments: Any) -> Result:
    """Call a function with one thread for kernels, unless ``OMP_NUM_THREADS`` is set."""
    if "OMP_NUM_THREADS" in os.environ:
        return function(*arguments)
    with threads(1):
        return function(*arguments)


@contextmanager
def workers(jobs: int, dask: str | None) -> Iterator[Executor | None]:
    """Yield the workers of a dask scheduler, a pool of processes, or None for a single job."""
    if dask is not None:
        with _dask_workers(dask) as executor:
            yield executor
        return
    jobs = jobs or cores()
    if jobs == 1:
        yield None
        return
    with process_pool(jobs) as executor:
        yield executor


@contextmanager
def process_pool(jobs: int) -> Iterator["ProcessPoolExecutor"]:
    """Yield a pool of processes that end when this process is interrupted or killed."""
    from concurrent.futures import ProcessPoolExecutor
    from multiprocessing import active_children, get_context

    # spawn: a forked process would inherit locks of the kernels' threads
    spawn, others = get_context("spawn"), set(active_children())
    with ProcessPoolExecutor(jobs, mp_context=spawn, initializer=_begin_worker) as executor:
        try:
            yield executor
        except (KeyboardInterrupt, GeneratorExit):
            for worker in set(active_children()) - others:  # their results are not needed
                worker.terminate()
            raise


@contextmanager
def _dask_workers(address: str) -> Iterator[Executor]:
    try:
        from distributed import Client
        from distributed.scheduler import KilledWorker
    except ImportError as error:
        raise CaseError("--dask needs dask; install the extra 'cluster'") from error
    logging.getLogger("distributed.client").setLevel(logging.CRITICAL)  # errors below are sentences
    try:
        client = Client(address, timeout=10)  # type: ignore[no-untyped-call]
    except (OSError, ValueError) as error:
        raise CaseError(f"no dask scheduler answers at {address!r}: {error}") from error
    try:
        pool = client.get_executor()  # type: ignore[no-untyped-call]
        with client, _leaving_the_lost(client), pool as executor:
            yield executor
    except KilledWorker as error:
        raise MultiscaleError(
            "several workers of dask died of the same job, perhaps for lack of memory; finished "
            "results remain, so run again on larger workers"
        ) from error


@contextmanager
def _leaving_the_lost(client: Any) -> Iterator[None]:
    """Cancel all jobs after ``LOST`` seconds without a worker, counted from the last worker."""
    from threading import Event, Thread

    from distributed import Future

    ended = Event()

    def watch() -> None:
        seen: float | None = None
        while not ended.wait(min(LOST, 10.0) / 4.0):
            events = () if seen else client.get_events("all")
            if client.nthreads() or any(event["action"] == "add-worker" for _, event in events):
                seen = monotonic()
            elif seen is not None and monotonic() - seen > LOST:
                client.cancel([Future(key, client) for key in list(client.futures)])
                return

    watcher = Thread(target=watch, daemon=True)
    watcher.start()
    try:
        yield
    finally:
        ended.set()
        watcher.join()


def cores() -> int:
    """Count the cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


def usable_memory() -> float:
    """Return the memory of this machine that a solve may take, byte; infinite if unknown."""
    if not hasattr(os, "sysconf"):  # Windows
        return inf
    return USABLE * os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES")


def run_ranges(work: Callable[..., Any], items: int, *arguments: Any, least: int = 1) -> None:
    """Call ``work(begin, end, *arguments)`` on ranges of ``least`` items or more, by threads."""
    if items < 2 * least:
        work(0, items, *arguments)
        return
    count = min(thread_count(), items // least)
    first, *others = pairwise(items * k // count for k in range(count + 1))
    futures = [_pool(os.getpid()).submit(work, *bounds, *arguments) for bounds in others]
    work(*first, *arguments)
    for future in futures:
        future.result()


@cache
def _pool(process: int) -> ThreadPoolExecutor:
    """Create the pool of a process; a forked process inherits no threads."""
    return ThreadPoolExecutor(cores(), "kernels")


def thread_count() -> int:
    """Return the number set by :func:`threads`, else ``OMP_NUM_THREADS`` or all cores."""
    if _thread_counts:
        return _thread_counts[-1]
    setting = os.environ.get("OMP_NUM_THREADS", "").split(",")[0]
    return min(max(int(setting), 1), cores()) if setting.isdigit() else cores()


@contextmanager
def threads(count: int) -> Iterator[None]:
    """Run kernels on ``count`` threads."""
    _thread_counts.append(count)
    try:
        yield
    finally:
        _thread_counts.pop()


def _begin_worker() -> None:
    """Set one thread for this worker, leave Ctrl-C to its parent, and end it with its parent."""
    import signal
    from multiprocessing import parent_process
    from threading import Thread

    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.environ["OMP_NUM_THREADS"] = "1"  # of kernels, and of libraries that are loaded later
    parent = parent_process()

    def watch() -> None:
        if parent is not None:
            parent.join()
            os._exit(1)

    Thread(target=watch, daemon=True).start()
