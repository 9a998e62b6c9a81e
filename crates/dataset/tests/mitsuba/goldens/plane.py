"""A textured plane under a light at the camera by Mitsuba 3: `pip install mitsuba==3.9.1 && python plane.py`.

Writes near.f32, frame.f32 and far.f32 beside this file: 48 x 48 linear radiances, RGB interleaved, little-endian float32. The
maps are waves on SIZE x SIZE texels over [-1, 1]^2; a pixel of `near` covers 0.7 texels, one of `frame` 1.3 as in the videos,
one of `far` 4. Light and viewer are in one place, so Schlick's weight is 0 and the Fresnel term is the specular albedo,
which roughconductor has too.
"""
import math
from pathlib import Path

import mitsuba as mi
import numpy as np

mi.set_variant("scalar_rgb")
SIZE = 512
row, column = np.mgrid[0:SIZE, 0:SIZE]


def wave(a, b):
    """A wave with a periods along x and b along y, downwards, as the test in main.rs has it."""
    return np.sin(2 * math.pi * (a * column + b * row) / SIZE)


normal = np.stack([0.25 * wave(21, 5), 0.2 * wave(7, -17), np.ones((SIZE, SIZE))], -1)
normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
diffuse = np.stack([0.4 + 0.3 * wave(16 + c, 9) for c in range(3)], -1)
roughness = 0.5 + 0.2 * wave(11, 13)
specular = np.stack([0.3 + 0.2 * wave(5 + 2 * c, 19) for c in range(3)], -1)


def texture(values):
    values = np.atleast_3d(values)[::-1].astype(np.float32)  # Mitsuba has row 0 at v = 0, the lower edge
    return {"type": "bitmap", "bitmap": mi.Bitmap(values), "raw": True, "filter_type": "bilinear", "wrap_mode": "repeat"}


lobes = {
    "type": "blendbsdf",  # half of each lobe under twice the light: their sum
    "weight": 0.5,
    "a": {"type": "diffuse", "reflectance": texture(diffuse)},
    "b": {
        "type": "roughconductor",
        "material": "none",
        "distribution": "ggx",
        "alpha": texture(roughness**2),
        "specular_reflectance": texture(specular),
    },
}


def render(name, position, target, intensity):
    camera = mi.ScalarTransform4f().look_at(origin=position, target=target, up=[0.05, 1, 0])
    scene = mi.load_dict({
        "type": "scene",
        "integrator": {"type": "direct"},
        "plane": {"type": "rectangle", "bsdf": {"type": "normalmap", "normalmap": texture(normal * 0.5 + 0.5), "bsdf": lobes}},
        "light": {"type": "point", "position": position, "intensity": {"type": "rgb", "value": [2 * intensity] * 3}},
        "sensor": {
            "type": "perspective",
            "fov": 30,
            "to_world": camera,
            "sampler": {"type": "stratified", "sample_count": 1024},
            "film": {"type": "hdrfilm", "width": 48, "height": 48, "rfilter": {"type": "box"}, "pixel_format": "rgb"},
        },
    })
    pixels = np.array(mi.render(scene), dtype="<f4")
    pixels.tofile(Path(__file__).with_name(name))
    print(name, pixels.shape, pixels.mean(axis=(0, 1)))


render("near.f32", [0.12, -0.08, 0.25], [0.1, -0.05, 0], 0.08)
render("far.f32", [-0.2, 0.15, 1.4], [-0.1, 0.05, 0], 2.5)
render("frame.f32", [0.05, 0.1, 0.45], [0.1, 0.02, 0], 0.26)
