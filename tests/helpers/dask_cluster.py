"""A Dask cluster of processes on this machine, whose members come and go."""

import os
import re
import subprocess
import sys
import time
from contextlib import contextmanager


class DaskCluster:
    """A scheduler and workers, each a process of its own."""

    def __init__(self, folder):
        self.folder = folder
        self.processes = []
        self.workers = []
        port_file = folder / "scheduler.txt"
        command = ["distributed.cli.dask_scheduler", "--port", "0", "--no-dashboard", "--host", "127.0.0.1"]
        self.scheduler = self._start(command, {}, port_file)
        self.address = self._said(port_file, r"tcp://[\d.]+:\d+")

    def _start(self, command, environment, log):
        environment = os.environ | {"OMP_NUM_THREADS": "1", "TMPDIR": str(self.folder)} | environment
        with log.open("w") as said:
            process = subprocess.Popen(
                [sys.executable, "-m", *command], stdout=said, stderr=said, env=environment, cwd=self.folder
            )
        self.processes.append(process)
        return process

    @staticmethod
    def _said(log, pattern, seconds=60):
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            if found := re.search(pattern, log.read_text()):
                return found[0]
            time.sleep(0.1)
        raise AssertionError(log.read_text())

    def add_worker(self, **environment):
        """A worker, which is there some seconds later."""
        command = ["distributed.cli.dask_worker", self.address, "--nthreads", "1", "--no-dashboard", "--no-nanny"]
        log = self.folder / f"worker{len(self.workers)}.txt"
        self.workers.append(self._start([*command, "--memory-limit", "0"], environment, log))
        return self.workers[-1]

    def close(self):
        """End all of it."""
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.wait()


@contextmanager
def dask_cluster(folder, workers):
    """A cluster of so many workers."""
    cluster = DaskCluster(folder)
    try:
        for _ in range(workers):
            cluster.add_worker()
        yield cluster
    finally:
        cluster.close()
