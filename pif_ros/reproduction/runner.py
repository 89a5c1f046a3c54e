"""Runs seeds on as many cores as there are, or on a cluster."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from tempfile import TemporaryDirectory

from joblib import delayed, Parallel, parallel_config
from pif_ros.reproduction.catalogue import find, run
from pif_ros.reproduction.study import Outcome
from tqdm import tqdm


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


@contextmanager
def dask(scheduler: str) -> Iterator[None]:
    """Take the workers of a Dask cluster, which have this package too."""
    from dask.distributed import Client
    with Client(scheduler), parallel_config(backend='dask'):
        yield
