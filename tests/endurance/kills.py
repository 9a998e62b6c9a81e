"""One run that is killed (kill -9) at fifty moments, and runs whose disk fills up or is read-only: nothing is lost.

    python tests/endurance/kills.py TRAIN_PROGRAM FOLDER [KILLS] [SEED]

Trains a tiny config undisturbed, then once more while it is killed at random moments, every third time while a file is being
written. Each time `--resume` must go on, must have lost no more steps than there are between two checkpoints, and the end must
be the same to the last bit: every number of metrics.jsonl, the weights' SHA-256, and each value of the TensorBoard events
once. Needs Linux and Python; the part about disks needs root (it mounts a small tmpfs) and is skipped without.
"""

import hashlib
import json
import os
import random
import signal
import struct
import subprocess
import sys
import time
from pathlib import Path

EVERY = 5
CONFIG = f"""
[run]
seed = 3
[[materials]]
type = "procedural"
size = 64
count = 16
[flow]
init = "none"
architecture = {{ channels = [4, 8], convs_per_level = 1, estimator = [8], radius = 2, context = [] }}
[adjacent]
steps = 400
batch = 1
pairs = {{ resolution = 48, crop = 32 }}
mixed_videos = 2
validation_pairs = 1
optimisation = {{ validate_every = 50, preview_every = 100 }}
[svbrdf]
steps = 400
net = {{ width = 4, levels = 3, dropout = 0.5, output = {{ start = "medians", gain = 0.02 }} }}
exemplars = {{ resolution = 32, key_frames = [1, 2], mixed_videos = 2 }}
median_exemplars = 2
validation_exemplars = 1
optimisation = {{ learning_rate = 1e-3, warm_up = 4, validate_every = 50, preview_every = 100 }}
[report]
evaluate = false
[checkpoint]
every_steps = {EVERY}
keep_best = 2
"""
STAGES = ["adjacent", "svbrdf"]


def rows(run):
    """The whole lines of metrics.jsonl; a kill may leave half of one."""
    found = []
    path = run / "metrics.jsonl"
    for line in path.read_text().splitlines() if path.exists() else []:
        try:
            found.append(json.loads(line))
        except ValueError:
            pass
    return found


def events(run):
    """(tag, step) of every scalar in the event files, with its value, and how often it is there."""
    def varint(data, at):
        value = shift = 0
        while True:
            value |= (data[at] & 127) << shift
            at, shift = at + 1, shift + 7
            if data[at - 1] < 128:
                return value, at

    def fields(data):
        at = 0
        while at < len(data):
            key, at = varint(data, at)
            if key & 7 == 0:
                value, at = varint(data, at)
            else:
                size, at = {1: (8, at), 5: (4, at)}.get(key & 7) or varint(data, at)
                value, at = data[at:at + size], at + size
            yield key >> 3, value

    found = {}
    for path in sorted((run / "tb").glob("*tfevents*")):
        data, at = path.read_bytes(), 0
        while at < len(data):
            size = struct.unpack_from("<Q", data, at)[0]
            assert at + size + 16 <= len(data), f"{path.name} ends in half a record"
            event = dict(fields(data[at + 12:at + 12 + size]))
            at += size + 16
            for number, value in fields(event.get(5, b"")):
                parts = dict(fields(value)) if number == 1 else {}
                if 2 in parts:
                    found.setdefault((parts[1].decode(), event.get(2, 0)), []).append(struct.unpack("<f", parts[2])[0])
    return found


def result(run):
    """What must be equal to the last bit: numbers as text, weights as hashes, events by tag and step."""
    weights = {p.name: hashlib.sha256(p.read_bytes()).hexdigest() for p in (run / "weights").glob("*.safetensors")}
    return (run / "metrics.jsonl").read_text(), weights, events(run)


def compare(run, expected, what):
    metrics, weights, curves = result(run)
    assert metrics == expected[0], f"{what}: metrics.jsonl differs"
    assert weights == expected[1], f"{what}: the weights differ"
    assert all(len(values) == 1 for values in curves.values()), f"{what}: a step is in the TensorBoard events twice"
    assert curves == expected[2], f"{what}: the TensorBoard events differ"
    steps = [(row["stage"], row["step"]) for row in rows(run) if row["kind"] == "train"]
    assert steps == [(stage, step) for stage in STAGES for step in range(1, 401)], f"{what}: steps doubled or missing"


def checkpoint(run, stage):
    """Step of the newest checkpoint."""
    return max([int(p.stem.rsplit("-", 1)[1]) for p in (run / "checkpoints").glob(f"{stage}-*.safetensors")], default=0)


def writing(run):
    """Whether a file is being written beside its name."""
    for folder in [run / "checkpoints", run / "weights", run]:
        try:
            if any(name.startswith(".writing-") or name.endswith(".partial") for name in os.listdir(folder)):
                return True
        except FileNotFoundError:
            pass
    return False


def start(train, folder, run):
    """Begins the run, or goes on with it if there is one."""
    known = (run / "config.toml").exists()
    arguments = ["--resume", str(run)] if known else ["--config", "tiny.toml", "--out", str(run)]
    return subprocess.Popen([train, *arguments], cwd=folder, stderr=subprocess.PIPE, text=True)


def kills(train, folder, expected, seconds, count, dice):
    run, while_writing, lost = folder / "killed", 0, []
    for number in range(count):
        litter = set(run.glob("*/.writing-*"))
        process, began = start(train, folder, run), time.monotonic()
        # A little progress on average, so that the run is killed all along its way and not only near its end.
        wait = dice.uniform(0, 1.4 * seconds / count + 0.1)
        hunting = number % 3 == 0
        while process.poll() is None and time.monotonic() - began < wait + hunting * 2:
            if hunting and time.monotonic() - began > wait and set(run.glob("*/.writing-*")) - litter:
                break
            if not hunting:
                time.sleep(0.001)
        while_writing += writing(run)
        process.send_signal(signal.SIGKILL)
        code, said = process.wait(), process.stderr.read()
        assert code in (0, -signal.SIGKILL), f"kill {number}: it ended with {code}: {said}"
        if code == 0:
            print(f"the run was done before kill {number}")
            return run, number, while_writing, lost
        done = [row for row in rows(run) if row["kind"] == "train"]
        if done:
            stage, step = done[-1]["stage"], done[-1]["step"]
            lost.append(max(0, step - checkpoint(run, stage)))
            assert lost[-1] <= EVERY, f"kill {number}: {stage} had done {step} steps, its checkpoint {checkpoint(run, stage)}"
    process = start(train, folder, run)
    said = process.communicate()[1]
    assert process.returncode == 0, said
    return run, count, while_writing, lost


def disks(train, folder, expected):
    """The disk fills up in the middle, or the folder can't be written: an error that says so, and the run goes on afterwards."""
    disk = folder / "disk"
    disk.mkdir()
    if os.geteuid() != 0 or subprocess.run(["mount", "-t", "tmpfs", "-o", "size=1500k", "none", disk]).returncode != 0:
        print("disk full, read-only: skipped (they need root and mount)")
        return
    try:
        run = disk / "run"
        for free in [300, 120, 40, 4]:
            process = start(train, folder, run)
            while process.poll() is None and len(rows(run)) < 20 + free:
                time.sleep(0.002)
            # All but so many KiB is taken by something else, as on a shared disk.
            left = os.statvfs(disk)
            with open(disk / "others", "wb") as others:
                others.write(bytes(max(0, left.f_bavail * left.f_frsize - free * 1024)))
            said = process.communicate()[1]
            assert process.returncode == 1 and "No space left on device" in said and "--resume" in said, said
            assert "panicked" not in said, said
            (disk / "others").unlink()
        subprocess.run(["mount", "-o", "remount,ro", disk], check=True)
        refused = start(train, folder, run)
        said = refused.communicate()[1]
        assert refused.returncode == 1 and "Read-only file system" in said, said
        subprocess.run(["mount", "-o", "remount,rw,size=16m", disk], check=True)
        said = start(train, folder, run).communicate()[1]
        assert "done" in said, said
        compare(run, expected, "disk full")
        print("disk full four times, then read-only: the end is the same")
    finally:
        subprocess.run(["umount", disk])


def limits(train, folder, expected):
    """No file may grow beyond a size, as under a quota: the system ends the process in the middle of a write."""
    run = folder / "limited"
    for size in [20_000, 60_000, 130_000]:
        limited = ["prlimit", f"--fsize={size}", train, "--config", "tiny.toml", "--out", str(run)]
        if (run / "config.toml").exists():
            limited = ["prlimit", f"--fsize={size}", train, "--resume", str(run)]
        ended = subprocess.run(limited, cwd=folder, capture_output=True, text=True)
        assert ended.returncode != 0 and "panicked" not in ended.stderr, ended.stderr
    process = start(train, folder, run)
    said = process.communicate()[1]
    assert process.returncode == 0, said
    compare(run, expected, "file size limit")
    print("files limited in size three times: the end is the same")


def main(train, folder, count=50, seed=1):
    train, folder = str(Path(train).resolve()), Path(folder).resolve()
    folder.mkdir(parents=True)
    (folder / "tiny.toml").write_text(CONFIG)
    began = time.monotonic()
    process = start(train, folder, folder / "undisturbed")
    said = process.communicate()[1]
    assert process.returncode == 0, said
    seconds, expected = time.monotonic() - began, result(folder / "undisturbed")
    compare(folder / "undisturbed", expected, "undisturbed")
    print(f"undisturbed: 800 steps, {EVERY} between two checkpoints, {seconds:.1f} s")
    run, killed, while_writing, lost = kills(train, folder, expected, seconds, int(count), random.Random(int(seed)))
    compare(run, expected, "killed")
    left = [str(p) for p in run.rglob("*") if p.name.startswith(".writing-") or p.name.endswith(".partial")]
    assert not left, left
    print(f"{killed} kills, {while_writing} of them while a file was written: the end is the same")
    print(f"steps lost by a kill: {max(lost)} at most, {sum(lost) / len(lost):.1f} on average")
    limits(train, folder, expected)
    disks(train, folder, expected)
    print("passed")


main(*sys.argv[1:])
