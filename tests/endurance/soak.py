"""Eight hours of training in minutes: is memory flat, are files and disk bounded?

    python tests/endurance/soak.py TRAIN_PROGRAM FOLDER [MINUTES] [FIGURE.svg]

What could leak leaks by the step, batch, checkpoint, measurement or picture, not by the second. So the time is compressed: a
tiny config (nets of some thousand weights) does in MINUTES at least as many of each as the main job (`spiral.toml`: 3000
steps in half an hour, a checkpoint every 50, pictures every 100, a measurement every 250) would do in eight hours, with every part
of the real run at work: data workers, augmentation, both kinds of nets, averaging, checkpoints with `keep_last` and
`keep_best`, metrics, TensorBoard, previews. Prints the slope of the resident memory with what it would come to in those eight
hours, and the most file handles, threads and checkpoints at a time; draws them. Needs Linux and Python alone.
"""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

# Eight hours of the main job.
HOURS = 8
STEPS = 16 * 3000
CHECKPOINTS, PICTURES, MEASUREMENTS = STEPS // 50, STEPS // 100, STEPS // 250
# Here.
EVERY = 20
KEEP_LAST, KEEP_BEST = 3, 2
CONFIG = f"""
[run]
seed = 3
[[materials]]
type = "procedural"
size = 64
count = 40
[flow]
init = "none"
architecture = {{ channels = [4, 8], convs_per_level = 1, estimator = [8], radius = 2, context = [] }}
[adjacent]
steps = 3000
batch = 1
pairs = {{ resolution = 48, crop = 32 }}
mixed_videos = 4
validation_pairs = 1
optimisation = {{ validate_every = 100, preview_every = 50, ema = 0.99 }}
[svbrdf]
steps = 10000000
net = {{ width = 4, levels = 3, dropout = 0.5, output = {{ start = "medians", gain = 0.02 }} }}
exemplars = {{ resolution = 32, key_frames = [1, 2], mixed_videos = 4 }}
median_exemplars = 2
validation_exemplars = 1
optimisation = {{ learning_rate = 1e-4, validate_every = 100, preview_every = 50, ema = 0.99 }}
[report]
evaluate = false
[checkpoint]
every_steps = {EVERY}
keep_last = {KEEP_LAST}
keep_best = {KEEP_BEST}
"""


def size(path):
    """Bytes of all files in a folder, and how many there are; files come and go meanwhile."""
    total = count = 0
    for root, _, files in os.walk(path):
        for name in files:
            try:
                total += os.stat(os.path.join(root, name)).st_size
                count += 1
            except FileNotFoundError:
                pass
    return total, count


def sample(process, run, began):
    status = dict(line.split(":", 1) for line in Path(f"/proc/{process}/status").read_text().splitlines())
    names = os.listdir(run / "checkpoints") if (run / "checkpoints").exists() else []
    stages = [len([n for n in names if n.startswith(stage) and n.endswith(".safetensors")]) for stage in ("adjacent", "svbrdf")]
    return {
        "seconds": time.monotonic() - began,
        "rss_mib": int(status["VmRSS"].split()[0]) / 1024,
        "handles": len(os.listdir(f"/proc/{process}/fd")),
        "threads": int(status["Threads"]),
        "last_stage": stages[1] > 0,
        "checkpoints": max(stages),
        "checkpoints_kib": size(run / "checkpoints")[0] / 1024,
    }


def slope(rows, name):
    """Least squares, per second."""
    n = len(rows)
    mean_t, mean = sum(r["seconds"] for r in rows) / n, sum(r[name] for r in rows) / n
    spread = sum((r["seconds"] - mean_t) ** 2 for r in rows)
    return sum((r["seconds"] - mean_t) * (r[name] - mean) for r in rows) / spread


def figure(rows, path, caption):
    """Memory, handles and checkpoints over the steps of time, each from 0."""
    width, height, left = 720, 110, 64
    curves = [("rss_mib", "memory, MiB", "#1b6ca8"), ("handles", "file handles", "#b3541e"), ("checkpoints", "checkpoints of a stage", "#3a7d44")]
    parts = []
    end = rows[-1]["seconds"]
    for index, (name, label, colour) in enumerate(curves):
        top, most = 40 + index * (height + 34), max(r[name] for r in rows) * 1.15
        at = lambda r: f"{left + (width - left - 16) * r['seconds'] / end:.1f},{top + height * (1 - r[name] / most):.1f}"
        parts.append(f'<line x1="{left}" y1="{top + height}" x2="{width - 16}" y2="{top + height}" stroke="#999"/>')
        parts.append(f'<text x="{left}" y="{top - 6}" fill="{colour}">{label}</text>')
        for value in (0, max(r[name] for r in rows)):
            y = top + height * (1 - value / most)
            parts.append(f'<text x="{left - 8}" y="{y + 4:.1f}" text-anchor="end" fill="#555">{value:.0f}</text>')
        parts.append(f'<polyline fill="none" stroke="{colour}" stroke-width="1.5" points="{" ".join(map(at, rows))}"/>')
    bottom = 40 + 3 * (height + 34) - 12
    parts.append(f'<text x="{left}" y="{bottom}" fill="#555">0</text>')
    parts.append(f'<text x="{width - 16}" y="{bottom}" text-anchor="end" fill="#555">{end / 60:.0f} min</text>')
    path.write_text(
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {width} {bottom + 14}" font-family="sans-serif" font-size="12">'
        f'<rect width="100%" height="100%" fill="#fff"/><text x="{left}" y="18" font-size="13">{caption}</text>{"".join(parts)}</svg>\n'
    )


def main(train, folder, minutes=12, drawing=None):
    train, folder = str(Path(train).resolve()), Path(folder).resolve()
    folder.mkdir(parents=True)
    (folder / "soak.toml").write_text(CONFIG)
    run, rows = folder / "run", []
    with open(folder / "log", "w") as log:
        process = subprocess.Popen([train, "--config", "soak.toml", "--out", str(run)], cwd=folder, stderr=log)
        began = time.monotonic()
        while process.poll() is None and time.monotonic() - began < 60 * float(minutes):
            time.sleep(2)
            rows.append(sample(process.pid, run, began))
        process.send_signal(signal.SIGTERM)
        code = process.wait()
    assert code == 130, f"it ended with {code}: {(folder / 'log').read_text()[-2000:]}"
    done = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    steps = [row for row in done if row["kind"] == "train"]
    measurements = len(done) - len(steps)
    checkpoints = len(steps) // EVERY
    previews, pictures = size(run / "previews")
    print(f"{len(steps)} steps, {checkpoints} checkpoints and more, {measurements} measurements, {pictures} pictures in {rows[-1]['seconds'] / 60:.1f} min")
    share = min(len(steps) / STEPS, checkpoints / CHECKPOINTS, measurements / MEASUREMENTS, len(steps) / 50 / PICTURES)
    print(f"that is {share:.2f} times what eight hours of the main job do, by the rarest of them")
    # A stage takes what its nets need when it begins; its first fifth fills caches (materials, allocator).
    later = [row for row in rows if row["last_stage"]]
    later = later[len(later) // 5:]
    rise = slope(later, "rss_mib") * rows[-1]["seconds"] / share
    span = min(r["rss_mib"] for r in later), max(r["rss_mib"] for r in later)
    print(f"memory: {span[0]:.1f} to {span[1]:.1f} MiB; slope {rise / HOURS:+.3f} MiB/h of eight compressed hours ({rise:+.2f} MiB in all)")
    print(f"file handles: {max(r['handles'] for r in later)} at most; threads: {max(r['threads'] for r in later)}")
    most = max(r["checkpoints"] for r in rows)
    print(f"checkpoints of a stage: {most} at most, {max(r['checkpoints_kib'] for r in rows):.0f} KiB of all; policy: {KEEP_LAST} + {KEEP_BEST}")
    tb, metrics = size(run / "tb")[0], (run / "metrics.jsonl").stat().st_size
    per = lambda size: size / len(steps) * 1000 / 1024
    print(f"growing by design, KiB per 1000 steps: metrics {per(metrics):.0f}, TensorBoard {per(tb):.0f}, previews {per(previews):.0f}")
    if drawing:
        figure(rows, Path(drawing), f"{len(steps)} steps of a tiny config: {share:.1f} × eight hours of the main job")
    assert rise / HOURS < 1, "memory climbs"
    # One more while the new one is there and the old one not yet gone.
    assert most <= KEEP_LAST + KEEP_BEST + 1, "checkpoints pile up"
    assert max(r["handles"] for r in later[len(later) // 2:]) <= max(r["handles"] for r in later[: len(later) // 2]), "file handles pile up"
    print("passed")


if __name__ == "__main__":
    main(*sys.argv[1:])
