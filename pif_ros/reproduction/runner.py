"""Runs seeds on as many cores as there are, or on a cluster."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from tempfile import TemporaryDirectory
from typing import Any

from joblib import delayed, Parallel, parallel_config
from pif_ros.reproduction.catalogue import find, run
from pif_ros.reproduction.study import Outcome
from tqdm import tqdm

#: Seconds for a scheduler to answer.
CONNECT = 10.0


def outcomes(name: str, seeds: Sequence[int], quick: bool) -> list[list[Outcome]]:
    """
    Return the outcomes of an example by case and seed; the first seed's have an exhibit.

    A seed of a case is one task for joblib, on the backend of the joblib.parallel_config around
    this, with a bar on a terminal.
    """
    with TemporaryDirectory(prefix='pif_ros_reproduce_') as scratch:
        count = len(find(name).cases(quick, scratch))
        tasks = [(case, seed) for case in range(count) for seed in seeds]
        running = Parallel(return_as='generator')(
            delayed(run)(name, case, seed, quick, seed == seeds[0], scratch)
            for case, seed in tasks)
        done = list(tqdm(running, desc=name, total=len(tasks), unit='seed', disable=None))
    return [done[k * len(seeds):(k + 1) * len(seeds)] for k in range(count)]


@contextmanager
def local(jobs: int) -> Iterator[None]:
    """Take so many processes of this machine, -1 for one per core, one thread each."""
    with parallel_config(backend='loky', n_jobs=jobs, inner_max_num_threads=1):
        yield


def cluster(scheduler: str) -> AbstractContextManager[None]:
    """
    Take the workers of a Dask cluster, which have this package too.

    Raises ValueError where there is no Dask, OSError where there is no scheduler.
    """
    try:
        from dask.distributed import Client
    except ModuleNotFoundError as error:
        raise ValueError(f'--backend: expected dask.distributed to be installed, got {error}')
    return _of_client(Client(scheduler, timeout=CONNECT))


@contextmanager
def _of_client(client: Any) -> Iterator[None]:
    with client, parallel_config(backend='dask'):
        yield
