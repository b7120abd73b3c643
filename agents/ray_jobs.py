"""Runs of `train.py all` on the machines of a Ray cluster, one a processor. Needs the extra [cluster].

The machines need the same Python with the same packages, but no common file system and no checkout: Ray copies this one
to them. The files of a run that was begun go to the machine that resumes it, and come back when it ends.
"""

import os
import re
import socket
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from tqdm import tqdm

from agents.jobs import Job
from fish_env.control.files import replacing
from fish_env.training.checkout import ROOT
from fish_env.training.config import PARENT

NEEDED = ("fish_env", "agents", "train.py", "pyproject.toml")
"""Files of the checkout that the machines receive."""
NO_CLUSTER = (
    "there is no Ray cluster at {!r} ({}); give the address that `ray start --head` printed, auto on one of its "
    "machines, or local for a cluster on this machine alone"
)
NOT_SENT = ("report.html", "events.*")


def read_files(folder: Path) -> dict[str, bytes]:
    """The files of a run by their paths in its folder, without those that nothing is resumed from."""
    paths = [path for path in folder.rglob("*") if path.is_file() and not any(map(path.match, NOT_SENT))]
    return {path.relative_to(folder).as_posix(): path.read_bytes() for path in paths}


def write_files(folder: Path, files: dict[str, bytes]) -> None:
    """Write what `read_files` read, each file whole or not at all, the results last: a run is finished by them."""
    for name in sorted(files, key=lambda name: name == "results.json"):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as partial:
            partial.write_bytes(files[name])


def run_remotely(words: list[str], files: dict[str, bytes]) -> tuple[int, dict[str, bytes]]:
    """On another machine: the exit status of `train.py`, and the files of the run. `words` end before its folder."""
    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "run"
        folder.mkdir()
        write_files(folder, files)
        with (folder / "log.txt").open("a") as log:
            done = subprocess.run(
                [sys.executable, "train.py", *words, str(folder)], stdout=log, stderr=subprocess.STDOUT, check=False,
                env=os.environ | {PARENT: str(os.getpid())},
            )  # fmt: skip
        return done.returncode, read_files(folder)


def join_cluster(address: str) -> Any:
    """Ray, joined to the cluster at an address; "local" begins one on this machine.

    Raises:
        ValueError: without Ray, or if there is no cluster at the address.
    """
    try:
        import ray
    except ImportError as error:
        raise ValueError('--ray needs Ray: pip install -c constraints.txt -e ".[cluster]"') from error
    found = re.fullmatch(r"(?:ray://)?([^:/]+):(\d+)", address)
    if found:  # Ray would wait for minutes
        try:
            socket.create_connection((found[1], int(found[2])), timeout=10.0).close()
        except (OSError, OverflowError) as error:
            raise ValueError(NO_CLUSTER.format(address, error)) from error
    others = [f"/{path.name}" for path in ROOT.iterdir() if path.name not in NEEDED]
    options: dict[str, Any] = {"address": address}
    if address == "local":
        options["include_dashboard"] = False
    try:
        ray.init(**options, runtime_env={"working_dir": str(ROOT), "excludes": others}, logging_level="ERROR")
    except (ConnectionError, ValueError, RuntimeError, TimeoutError) as error:
        raise ValueError(NO_CLUSTER.format(address, str(error).splitlines()[0])) from error
    return ray


def run_on_ray(waiting: list[Job], work: list[Job], address: str) -> list[Job]:
    """Run those that wait, as many at a time as the cluster has processors; returns those that failed."""
    ray = join_cluster(address)
    try:
        task = ray.remote(num_cpus=1, max_retries=2)(run_remotely)
        under_way = {task.remote(job.command()[2:-1], read_files(job.folder)): job for job in waiting}
        failed, processors = [], int(ray.cluster_resources().get("CPU", 0))
        with tqdm(total=len(work), initial=len(work) - len(waiting), unit=" runs", desc=f"on {processors} CPUs") as bar:
            while under_way:
                ready, _ = ray.wait(list(under_way), num_returns=1)
                bar.update()
                job = under_way.pop(ready[0])
                try:
                    status, files = ray.get(ready[0])
                except ray.exceptions.RayError as error:
                    status, files = 1, {"log.txt": f"{error}\n".encode()}
                write_files(job.folder, files)
                failed += [job] if status or not job.finished else []
        return failed
    finally:
        ray.shutdown()
