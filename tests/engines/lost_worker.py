"""A sweep under the real HyperQueue, one of whose two workers is lost in the middle.

    pip install hyperqueue
    python tests/engines/lost_worker.py TRAIN_PROGRAM FOLDER

Submits the tasks of `train sweep --engine hyperqueue` (HyperQueue's Python package has server and workers, but not the program
`hq`; the job definition is read here and given to the same server by its other door), cuts the connection between the server
and the worker that runs the first task, and checks that the task goes on elsewhere from its checkpoint and that every run ends.
"""

import json
import os
import socket
import subprocess
import sys
import time
import tomllib
from pathlib import Path

from hyperqueue import Job, LocalCluster
from hyperqueue.cluster import WorkerConfig
from hyperqueue.ffi import get_version
from hyperqueue.ffi.protocol import ResourceRequest

SWEEP = """
base = "spiral.toml"
seeds = [1, 2]
[settings]
adjacent.steps = 0
distant.steps = 0
checkpoint.every_steps = 50
materials = [{ type = "procedural", size = 128, count = 34 }]
svbrdf = { steps = 400, exemplars = { resolution = 32, key_frames = [2, 2] }, net = { width = 16, levels = 3 }, median_exemplars = 4, validation_exemplars = 1 }
report.synthetic = { textured = 1, low_texture = 1, resolution = 64, map_resolution = 32, constant_videos = 4 }
[variants.full]
[variants.bare]
svbrdf.loss.weights.top = 0.0
[variants.fewer-pairs]
report.synthetic.pairs = 2
"""


def connections():
    """Sockets of this process that are connected to the server's port, as (local port, remote port, descriptor)."""
    found = []
    for entry in os.listdir("/proc/self/fd"):
        try:
            if not os.readlink(f"/proc/self/fd/{entry}").startswith("socket:"):
                continue
            with socket.socket(fileno=os.dup(int(entry))) as copy:
                found.append((copy.getsockname()[1], copy.getpeername()[1], int(entry)))
        except (OSError, IndexError, TypeError):
            pass
    return found


def cut(descriptor):
    """Ends a connection for both sides, as the end of a worker's machine does."""
    copy = socket.socket(fileno=os.dup(descriptor))
    copy.shutdown(socket.SHUT_RDWR)
    copy.close()


def steps(run):
    """Training steps in a run's metrics."""
    path = run / "metrics.jsonl"
    rows = [json.loads(line) for line in path.read_text().splitlines() if line.endswith("}")] if path.exists() else []
    return [row["step"] for row in rows if row["kind"] == "train"]


def main(train, folder):
    print("HyperQueue", get_version())
    folder.mkdir(parents=True)
    (folder / "sweep.toml").write_text(SWEEP)
    out = folder / "out"
    sweep = [train, "sweep", str(folder / "sweep.toml"), "--out", str(out)]
    # Without `hq` on the path the job definition is written and not submitted.
    subprocess.run(sweep + ["--engine", "hyperqueue", "--cores", "1"], capture_output=True, env={"PATH": ""})
    definition = tomllib.loads((out / "hyperqueue.toml").read_text())

    print(len(definition["task"]), "tasks")
    cluster = LocalCluster(str(folder / "server"))
    before = {descriptor for *_, descriptor in connections()}
    cluster.start_worker(WorkerConfig(cores=1))
    time.sleep(1)
    first_worker = [c for c in connections() if c[2] not in before]
    job, tasks = Job(name=definition["name"], max_fails=None), {}
    for task in definition["task"]:
        request = ResourceRequest(cpus=task["request"][0]["resources"]["cpus"])
        tasks[task["id"]] = job.program(
            task["command"], env=task["env"], deps=[tasks[i] for i in task["deps"]], resources=request,
            stdout=task["stdout"], stderr=task["stderr"], crash_limit=task["crash_limit"],
        )
    client = cluster.client()
    submitted = client.submit(job)
    victim = out / "full-seed1"
    while len(steps(victim)) < 60:
        time.sleep(0.2)
    cluster.start_worker(WorkerConfig(cores=1))
    time.sleep(1)
    print(f"full-seed1 has done {len(steps(victim))} steps; its worker is lost now")
    cut(first_worker[0][2])
    print("all tasks finished:", client.wait_for_jobs([submitted], raise_on_error=False))
    done = steps(victim)
    print(f"full-seed1: {len(done)} steps, each once: {done == sorted(set(done))}")
    for log in sorted((out / "logs").glob("full-seed1.*.log")):
        shown = [line.split(" loss")[0] for line in log.read_text().splitlines() if line.startswith("svbrdf ")]
        print(f"{log.name}: {shown[0]} to {shown[-1]}")
    table = subprocess.run(sweep + ["--table"], capture_output=True, text=True)
    print(table.stderr.strip())
    listed = subprocess.run(sweep + ["--dry-run"], capture_output=True, text=True).stdout
    print(listed.strip())
    assert table.returncode == 0 and listed.count("finished") == len(definition["task"]) and len(done) == 400
    print("passed")
    # The lost worker's thread may still wait for its server.
    os._exit(0)


main(sys.argv[1], Path(sys.argv[2]).resolve())
