"""Values of BRDF times cosine by Mitsuba 3: `pip install mitsuba==3.9.1 && python mitsuba_values.py > mitsuba.csv`.

The surface is the sum of a diffuse lobe and a GGX roughconductor whose material "none" reflects everything (F = 1, that is
a specular albedo of 1), with separable Smith masking and alpha = r^2: 20 parameter sets, 200 pairs of directions each, half
of them near the mirror direction, where the lobe is. Directions are given by integer angles in milliradians (tilt of wo,
azimuth of wo, tilt of wi, azimuth of wi; wo to the viewer, wi to the light), so that both programs start from the same
numbers. Columns: set, the four angles, red, green, blue. A line "#set,r,red,green,blue" before each set gives its
roughness and diffuse albedo.
"""
import math
import random

import mitsuba as mi

mi.set_variant("scalar_rgb")
random.seed(1)
STEEPEST = 1500  # milliradians, 86 degrees


def direction(tilt, azimuth):
    tilt, azimuth = tilt / 1000, azimuth / 1000
    return [math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)]


def value(bsdf, wo, wi):
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(wo)  # Mitsuba's wi is the viewer
    si.p, si.n, si.t = mi.Point3f(0, 0, 0), mi.Normal3f(0, 0, 1), 1.0
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    return bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wi))


for index in range(20):
    roughness = [0.1, 0.15, 0.2, 0.25, 0.3, 0.4, 0.5, 0.65, 0.8, 1.0][index % 10]
    colour = [round(random.uniform(0, 1), 3) for _ in range(3)]
    mirror = mi.load_dict({"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": roughness**2})
    matte = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": colour}})
    print(f"#{index},{roughness},{colour[0]},{colour[1]},{colour[2]}")
    for k in range(200):
        tilt, azimuth = random.randint(0, STEEPEST), random.randint(0, 6283)
        spread = int(3000 * roughness**2) if k % 2 else 3000
        tilt_i = min(STEEPEST, abs(tilt + random.randint(-spread, spread) // 2))
        azimuth_i = azimuth + 3142 + random.randint(-spread, spread) // 2
        wo, wi = direction(tilt, azimuth), direction(tilt_i, azimuth_i)
        rgb = [a + b for a, b in zip(value(mirror, wo, wi), value(matte, wo, wi))]
        print(",".join(map(str, [index, tilt, azimuth, tilt_i, azimuth_i, *(f"{v:.7g}" for v in rgb)])))
