"""A scan over a real photograph, with exact homographies: `scan`'s alignment on surfaces that no program made.

    pip install scikit-image opencv-python-headless
    python tests/engines/photo_scan.py film OUT [--photo gravel] [--image FILE]
    cargo run -p scan -- OUT/frames --weights weights --out OUT/maps --resolution 256
    python tests/engines/photo_scan.py compare OUT OUT/maps

The photographs brick, grass, gravel and coffee come with scikit-image; --image takes any other, by preference flat and evenly
lit. A hand-held camera moves along two turns of a spiral over the picture, with roll, tilt and height changing slowly, and
carries a flash whose light falls off from the middle of the frame. The photograph is flat to the flash: relief isn't lit anew.
"""

import argparse
import json
from pathlib import Path

import cv2
import numpy as np

from opencv_alignment import REFERENCE_WIDTH, errors

SIDE = 256
COUNT = 141


def photograph(arguments):
    """The photograph as 8-bit BGR, three times as wide as a frame."""
    if arguments.image:
        image = cv2.imread(str(arguments.image), cv2.IMREAD_COLOR)
        if image is None:
            raise SystemExit(f"{arguments.image} is not a picture that OpenCV reads")
    else:
        from skimage import data

        image = getattr(data, arguments.photo)()
        image = cv2.cvtColor(image, cv2.COLOR_GRAY2BGR if image.ndim == 2 else cv2.COLOR_RGB2BGR)
    side = min(image.shape[:2])
    return cv2.resize(image[:side, :side], (3 * SIDE, 3 * SIDE), interpolation=cv2.INTER_CUBIC)


def views(width):
    """Frame pixel to photograph pixel, one per frame."""
    random = np.random.default_rng(7)

    def wave(amplitude):
        return amplitude * np.convolve(random.standard_normal(COUNT + 24), np.hanning(25) / 3.0, "valid")

    roll, scale, tilt_x, tilt_y, sway_x, sway_y = (wave(a) for a in (0.05, 0.03, 3e-5, 3e-5, 12.0, 12.0))
    middle = 0.5 * (SIDE - 1)
    found = []
    for i in range(COUNT):
        t = i / (COUNT - 1)
        radius = 0.27 * width * t
        angle = 4.0 * np.pi * np.sqrt(t)
        x = 0.5 * width + radius * np.cos(angle) + sway_x[i]
        y = 0.5 * width + radius * np.sin(angle) + sway_y[i]
        cos, sin = (1.0 + scale[i]) * np.cos(roll[i]), (1.0 + scale[i]) * np.sin(roll[i])
        centre = np.array([[1, 0, -middle], [0, 1, -middle], [0, 0, 1.0]])
        tilt = np.array([[1, 0, 0], [0, 1, 0], [tilt_x[i], tilt_y[i], 1]])
        found.append(np.array([[cos, -sin, x], [sin, cos, y], [0, 0, 1]]) @ tilt @ centre)
    return found


def film(arguments):
    image = photograph(arguments).astype(np.float32) / 255.0
    linear = image**2.2
    frames = arguments.out / "frames"
    if frames.exists():
        raise SystemExit(f"{frames} exists already: choose another folder")
    frames.mkdir(parents=True)
    random = np.random.default_rng(11)
    y, x = np.mgrid[0:SIDE, 0:SIDE] / (SIDE - 1.0) - 0.5
    flash = ((1.0 + 1.4 * (x**2 + y**2)) ** -3)[..., None]
    path = views(image.shape[1])
    for i, view in enumerate(path):
        flags = cv2.INTER_CUBIC | cv2.WARP_INVERSE_MAP
        seen = cv2.warpPerspective(linear, view, (SIDE, SIDE), flags=flags, borderMode=cv2.BORDER_REFLECT)
        shot = np.clip(1.3 * seen * flash, 0.0, 1.0) ** (1 / 2.2) + 0.008 * random.standard_normal(seen.shape)
        cv2.imwrite(str(frames / f"frame-{i:04d}.png"), np.uint8(np.clip(255.0 * shot + 0.5, 0, 255)))
    (arguments.out / "views.json").write_text(json.dumps([v.tolist() for v in path]))
    print(f"{COUNT} frames of {SIDE}² in {frames}")


def compare(arguments):
    path = [np.array(v) for v in json.loads((arguments.out / "views.json").read_text())]
    found = json.loads((arguments.maps / "alignment.json").read_text())["key_frames"]
    aligned = [k for k in found if k["status"] == "aligned"]
    exact = [np.linalg.inv(path[k["index"]]) @ path[0] for k in aligned]
    measured = [errors(np.array(k["homography"]), e, SIDE)[0] for k, e in zip(aligned, exact)]
    means = np.array([m.mean() for m in measured if len(m)])
    print(f"{len(aligned)} of {len(found)} key frames aligned", end="")
    if len(means):
        print(f"; error in pixels at a width of {REFERENCE_WIDTH:.0f}: mean {means.mean():.2f}, "
              f"median {np.median(means):.2f}, worst {means.max():.2f}", end="")
    print()


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    tasks = parser.add_subparsers(dest="task", required=True)
    shoot = tasks.add_parser("film")
    shoot.add_argument("out", type=Path)
    shoot.add_argument("--photo", default="gravel", choices=["brick", "grass", "gravel", "coffee"])
    shoot.add_argument("--image", type=Path)
    judge = tasks.add_parser("compare")
    judge.add_argument("out", type=Path)
    judge.add_argument("maps", type=Path)
    arguments = parser.parse_args()
    film(arguments) if arguments.task == "film" else compare(arguments)


if __name__ == "__main__":
    main()
