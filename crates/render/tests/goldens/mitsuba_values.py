"""Values of the GGX lobe and the diffuse term by Mitsuba 3: `pip install mitsuba==3.9.1 && python mitsuba_values.py > mitsuba.csv`.

roughconductor with material "none" reflects everything (F = 1), so its value is D*G/(4 n.wi n.wo) times the outgoing
cosine, with separable Smith masking. Columns: alpha, wi, wo (light), lobe times cosine of wo, diffuse (albedo 0.5) times it.
"""
import math
import random

import mitsuba as mi

mi.set_variant("scalar_rgb")
random.seed(1)


def direction(tilt, azimuth):
    return [math.sin(tilt) * math.cos(azimuth), math.sin(tilt) * math.sin(azimuth), math.cos(tilt)]


def value(bsdf, wi, wo):
    si = mi.SurfaceInteraction3f()
    si.wi = mi.Vector3f(wi)
    si.p, si.n, si.t = mi.Point3f(0, 0, 0), mi.Normal3f(0, 0, 1), 1.0
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    return bsdf.eval(mi.BSDFContext(), si, mi.Vector3f(wo))[0]


print("alpha,wi_x,wi_y,wi_z,wo_x,wo_y,wo_z,lobe_cosine,diffuse_cosine")
for alpha in (0.01, 0.04, 0.09, 0.25, 0.5, 1.0):
    mirror = mi.load_dict({"type": "roughconductor", "material": "none", "distribution": "ggx", "alpha": alpha})
    matte = mi.load_dict({"type": "diffuse", "reflectance": {"type": "rgb", "value": [0.5, 0.5, 0.5]}})
    for k in range(12):
        tilt, azimuth = random.uniform(0, 1.45), random.uniform(0, 2 * math.pi)
        wi = direction(tilt, azimuth)
        # Every other pair lies near the mirror direction, where the lobe is.
        spread = 3 * alpha if k % 2 else 3
        wo = direction(min(1.45, abs(tilt + random.uniform(-spread, spread) / 2)), azimuth + math.pi + random.uniform(-spread, spread) / 2)
        row = [alpha, *wi, *wo, value(mirror, wi, wo), value(matte, wi, wo)]
        print(",".join(f"{v:.9g}" for v in row))
