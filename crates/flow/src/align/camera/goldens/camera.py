"""A camera found from noisy homographies by SciPy and checked with OpenCV: `python camera.py > camera.json`.

Needs numpy, scipy, opencv-python-headless. The unknowns are the program's (focal length, plane, poses), the code isn't: rotations as
quaternions by SciPy, its trust-region least squares with numeric derivatives, standard errors from its Jacobian.
"""

import json

import cv2
import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

WIDTH, HEIGHT, SIDE, NOISE_PX = 320, 240, 5, 0.2
rng = np.random.default_rng(5)


def intrinsics(focal):
    return np.array([[focal, 0, (WIDTH - 1) / 2], [0, focal, (HEIGHT - 1) / 2], [0, 0, 1.0]])


def grid(side):
    x = (np.arange(side) + 0.5) * WIDTH / side - 0.5
    y = (np.arange(side) + 0.5) * HEIGHT / side - 0.5
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def apply(h, p):
    q = np.c_[p, np.ones(len(p))] @ h.T
    return q[:, :2] / q[:, 2:]


def homographies(focal, slopes, poses):
    k, plane = intrinsics(focal), np.array([*slopes, 1.0])
    whole = [np.eye(3)] + [Rotation.from_rotvec(p[:3]).as_matrix() + np.outer(p[3:], plane) for p in poses]
    return [k @ m @ np.linalg.inv(k) for m in whole]


# The truth: 40° across, a tilted first camera, ten more.
focal, slopes = 0.5 * WIDTH / np.tan(np.radians(20)), np.array([0.09, -0.06])
poses = [np.r_[rng.normal(0, 0.1, 2), rng.normal(0, 0.2), rng.normal(0, 0.06, 3)] for _ in range(10)]
exact = homographies(focal, slopes, poses)
links = []
for source in range(1, 11):
    for target in {0, source - 1}:
        relative = exact[source] @ np.linalg.inv(exact[target])
        points = grid(4)
        moved = apply(relative, points) + rng.normal(0, NOISE_PX, (16, 2))
        measured, _ = cv2.findHomography(points, moved)
        links.append((target, source, measured))


def residuals(x):
    found = homographies(np.exp(x[0]), x[1:3], x[3:].reshape(-1, 6))
    out = []
    for target, source, measured in links:
        points = grid(SIDE)
        seen = apply(measured, points)
        inside = (seen >= 0).all(1) & (seen[:, 0] <= WIDTH - 1) & (seen[:, 1] <= HEIGHT - 1)
        if inside.sum() >= 8:
            off = apply(found[source] @ np.linalg.inv(found[target]), points[inside]) - seen[inside]
            out.append(off.ravel() * np.sqrt(8 / off.size))
    return np.concatenate(out)


start = np.r_[np.log(focal * 1.1), 0, 0, np.concatenate(poses)]
fit = least_squares(residuals, start, xtol=1e-14, ftol=1e-14, gtol=1e-14)
used = sum(1 for t, s, m in links)
variance = 2 * fit.cost / (8 * used - len(fit.x))
covariance = np.linalg.inv(fit.jac.T @ fit.jac) * variance
found_focal, found_slopes = np.exp(fit.x[0]), fit.x[1:3]

# OpenCV takes the found homography of frame 3 apart again: one of its solutions must be the found pose.
k = intrinsics(found_focal)
pose = fit.x[3:].reshape(-1, 6)[2]
_, rotations, shifts, normals = cv2.decomposeHomographyMat(homographies(found_focal, found_slopes, [pose])[1], k)
plane = np.array([*found_slopes, 1.0])
errors = [
    np.abs(r - Rotation.from_rotvec(pose[:3]).as_matrix()).max() + np.abs(t.ravel() - pose[3:] * np.linalg.norm(plane)).max()
    for r, t in zip(rotations, shifts)
]
assert min(errors) < 1e-6, errors

print(json.dumps({
    "width": WIDTH, "height": HEIGHT,
    "links": [{"target": t, "source": s, "homography": (m / m[2, 2]).ravel().tolist()} for t, s, m in links],
    "focal_px": found_focal, "focal_uncertainty": float(np.sqrt(covariance[0, 0])),
    "slopes": found_slopes.tolist(),
    "centre_of_3": (-Rotation.from_rotvec(pose[:3]).as_matrix().T @ pose[3:]).tolist(),
}, indent=1))
