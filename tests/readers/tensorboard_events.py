"""TensorBoard's own reader of a run's event files against what the run wrote elsewhere.

    pip install tensorboard pillow
    python tests/readers/tensorboard_events.py RUN [--histograms]

Every number of metrics.jsonl must be a scalar, every file of previews/ an image of the same pixels, and with --histograms there
must be histograms of the weights of every layer, and of the gradients where there are any, whose bars hold all the values looked at.
"""

import io
import json
import math
import struct
import sys
from pathlib import Path

from PIL import Image
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator


def tag(row, name):
    """The scalar's tag: measurements on held-out materials stand apart."""
    return f"{row['stage']}/{name}" if row["kind"] == "train" else f"{row['stage']}-held-out/{name}"


def check_scalars(run, events):
    rows = [json.loads(line) for line in (run / "metrics.jsonl").read_text().splitlines()]
    read = {name: {event.step: event.value for event in events.Scalars(name)} for name in events.Tags()["scalars"]}
    count = 0
    for row in rows:
        for name, value in row.items():
            if name not in ("stage", "step", "kind") and value is not None:
                single = struct.unpack("f", struct.pack("f", value))[0]
                assert read[tag(row, name)][row["step"]] == single, (row, name)
                count += 1
    print(f"{count} scalars under {len(read)} tags")
    assert count > 0


def check_images(run, events):
    files = sorted((run / "previews").glob("*.png"))
    for file in files:
        stage, step, name = file.stem.split("-", 2)
        found = {event.step: event for event in events.Images(f"{stage}/{name}")}[int(step)]
        image = Image.open(io.BytesIO(found.encoded_image_string))
        assert image.convert("RGB").tobytes() == Image.open(file).convert("RGB").tobytes(), file
    print(f"{len(files)} images")
    assert files


def check_histograms(events):
    tags = events.Tags()["histograms"]
    weights = {name for name in tags if "-weights/" in name}
    gradients = set(tags) - weights
    # A parameter may be of no use to the loss, as a bias before a normalisation is.
    assert gradients and gradients <= {name.replace("-weights/", "-gradients/") for name in weights}, tags
    for name in tags:
        for event in events.Histograms(name):
            spread = event.histogram_value
            assert len(spread.bucket) == len(spread.bucket_limit) and sum(spread.bucket) == spread.num > 0, name
            assert spread.min <= spread.bucket_limit[0] and spread.bucket_limit[-1] == spread.max, name
            assert all(map(math.isfinite, (spread.sum, spread.sum_squares))), name
    print(f"{len(tags)} histograms")


def main(run, *options):
    run = Path(run)
    # Without limits, which would leave most steps out.
    events = EventAccumulator(str(run / "tb"), size_guidance={"scalars": 0, "images": 0, "histograms": 0})
    events.Reload()
    check_scalars(run, events)
    check_images(run, events)
    if "--histograms" in options:
        check_histograms(events)


main(*sys.argv[1:])
