"""The alignment beside OpenCV's methods, on identical frames with exact homographies.

    pip install opencv-python-headless
    cargo run -p evaluate -- alignment --out OUT --keep-frames
    python tests/engines/opencv_alignment.py OUT [--condition base] [--json FILE]

Each method finds the homography between neighbouring frames and chains them to the key frames: SIFT matches with MAGSAC; dense
inverse search (DIS) flow with MAGSAC; the enhanced correlation coefficient (ECC), started from the motion before. A step that
a method doesn't find repeats the motion before it. Ours is read from OUT/cases. The metric is that of flow::align::metrics: mean
distances on a grid of 64 × 64 guidance pixels that the key frame shows, in pixels at a width of 1024; a position that the
prediction leaves out of the frame counts 20 in the penalised error, as larger distances do.
"""

import argparse
import json
import sys
from pathlib import Path

import cv2
import numpy as np

SIDE = 64
REFERENCE_WIDTH = 1024.0
PENALTY = 20.0


def sift(first, second, _):
    """Homography of ratio-tested SIFT matches by MAGSAC."""
    finder = cv2.SIFT_create()
    (points, features), (others, other_features) = (finder.detectAndCompute(f, None) for f in (first, second))
    if features is None or other_features is None or len(points) < 4 or len(others) < 2:
        return None
    pairs = [m[0] for m in cv2.BFMatcher().knnMatch(features, other_features, k=2) if m[0].distance < 0.8 * m[1].distance]
    if len(pairs) < 4:
        return None
    return magsac(np.float32([points[m.queryIdx].pt for m in pairs]), np.float32([others[m.trainIdx].pt for m in pairs]))


def dis(first, second, _):
    """Homography of every fourth vector of the dense inverse search flow by MAGSAC."""
    flow = cv2.DISOpticalFlow_create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM).calc(first, second, None)
    y, x = np.mgrid[2 : first.shape[0] : 4, 2 : first.shape[1] : 4]
    start = np.stack([x, y], -1).reshape(-1, 2).astype(np.float32)
    end = start + flow[y, x].reshape(-1, 2)
    inside = ((end >= 0) & (end < np.array(first.shape[::-1]))).all(1)
    return magsac(start[inside], end[inside]) if inside.sum() >= 4 else None


def ecc(first, second, before):
    """Homography of the largest enhanced correlation coefficient near the motion before."""
    criteria = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 50, 1e-4)
    try:
        start = np.ascontiguousarray(before, np.float32)
        return cv2.findTransformECC(first, second, start, cv2.MOTION_HOMOGRAPHY, criteria, None, 5)[1].astype(float)
    except cv2.error:
        return None


def magsac(start, end):
    found, _ = cv2.findHomography(start, end, cv2.USAC_MAGSAC, 1.5, maxIters=5000, confidence=0.9999)
    return found


METHODS = {"SIFT + MAGSAC": sift, "DIS + MAGSAC": dis, "ECC": ecc}


def chain(frames, method):
    """Homographies from frame 0 to every frame."""
    whole, step, found = [np.eye(3)], np.eye(3), 0
    for first, second in zip(frames, frames[1:]):
        new = method(first, second, step)
        if new is not None and np.isfinite(new).all():
            step, found = new, found + 1
        whole.append(step @ whole[-1])
    return whole, found


def mapped(matrix, points):
    """Images of points; NaN at or behind the horizon."""
    moved = np.concatenate([points, np.ones_like(points[:, :1])], 1) @ matrix.T
    depth = np.where(moved[:, 2:] > 1e-9, moved[:, 2:], np.nan)
    return moved[:, :2] / depth


def errors(predicted, exact, resolution):
    """Distances over positions that are valid in both, and the number of positions that are valid in the truth."""
    at = (np.arange(SIDE) + 0.5) * resolution / SIDE - 0.5
    grid = np.stack(np.meshgrid(at, at), -1).reshape(-1, 2)
    inside = lambda p: ((p >= 0) & (p <= resolution - 1)).all(1)
    truth = mapped(exact, grid)
    seen = inside(truth)
    guess = mapped(predicted, grid[seen])
    distances = np.linalg.norm(guess - truth[seen], axis=1) * REFERENCE_WIDTH / resolution
    return distances[inside(guess)], int(seen.sum())


def figures(measured):
    """Pixel error and penalised error over all key frames."""
    distances = np.concatenate([d for d, _ in measured])
    reference = sum(n for _, n in measured)
    penalised = (np.minimum(distances, PENALTY).sum() + PENALTY * (reference - len(distances))) / reference
    return {"pixel_error": float(distances.mean()) if len(distances) else None, "penalised_error": float(penalised)}


def compared(scan, case):
    """All methods' figures on one scan."""
    truth = json.loads((scan / "truth.json").read_text())
    frames = [cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(scan.glob("frame-*.png"))]
    ours = {name: case["figures"].get(name) for name in ("pixel_error", "penalised_error")}
    row = {"scan": scan.name, "material": truth["material"], "texture": truth["texture"], "ours": ours}
    for name, method in METHODS.items():
        whole, found = chain(frames, method)
        keys = [(whole[k["frame"]], np.array(k["homography"]).reshape(3, 3)) for k in truth["key_frames"]]
        measured = [errors(predicted, exact, truth["resolution"]) for predicted, exact in keys]
        row[name] = figures([m for m in measured if m[1] > 0]) | {"steps_found": found}
    return row


def markdown(rows):
    names = ["ours", *METHODS]
    number = lambda v: "–" if v is None else f"{v:.2f}"
    lines = ["| material | texture | " + " | ".join(names) + " |", "|---|---|" + "---|" * len(names)]
    for row in rows:
        cells = [f"{number(row[n]['pixel_error'])} / {number(row[n]['penalised_error'])}" for n in names]
        lines.append(f"| {row['material']} | {row['texture']} | " + " | ".join(cells) + " |")
    means = [np.mean([row[n]["penalised_error"] for row in rows]) for n in names]
    lines.append("| **mean** | | " + " | ".join(f"– / {m:.2f}" for m in means) + " |")
    best = [min(row[n]["penalised_error"] for n in METHODS) for row in rows]
    worse = sum(row["ours"]["penalised_error"] > b + 1e-9 for row, b in zip(rows, best))
    return "\n".join([*lines, "", f"Pixel error / penalised error. Ours is worse than the best of the others on {worse} of {len(rows)} scans."])


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--condition", default="base")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    scans = sorted(p.parent for p in (arguments.folder / "frames" / arguments.condition).glob("*/truth.json"))
    if not scans:
        sys.exit(f"error: {arguments.folder}/frames/{arguments.condition} holds no scan: run `evaluate alignment --keep-frames` first")
    rows = []
    for scan in scans:
        case = json.loads((arguments.folder / "cases" / arguments.condition / f"{scan.name}.json").read_text())
        rows.append(compared(scan, case))
        print(scan.name, rows[-1]["material"], file=sys.stderr)
    if arguments.json:
        arguments.json.write_text(json.dumps(rows, indent=1) + "\n")
    print(markdown(rows))


if __name__ == "__main__":
    main()
