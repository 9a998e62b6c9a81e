"""The losses in PyTorch: of the flow (Sun et al. 2018), of the maps and of their renderings (paper §6, Eq. 6)."""

import math

import torch
import torch.nn.functional as F

import golden

LEVEL_WEIGHTS = [0.32, 0.08, 0.02, 0.01, 0.005]
UNIT_PX = 20.0
MODELS = [("ggx", "lambert"), ("ggx", "inria"), ("ggx-clamped", "lambert"), ("ggx-clamped", "inria")]


def at_level(target, valid, factor, height, width):
    """Mean over the known pixels of each block; a block is known when more than half of it is. In units of 20 px."""
    grow = (0, width * factor - target.shape[3], 0, height * factor - target.shape[2])
    share = F.avg_pool2d(F.pad(valid, grow), factor)
    mean = F.avg_pool2d(F.pad(target * valid, grow), factor) / share.clamp_min(1e-9)
    known = (share > 0.5).to(target)
    return mean * known / UNIT_PX, known


def flow_terms(levels, target, valid, error):
    """Per level, coarse to fine: weight · mean over the batch of the sum over valid pixels."""
    terms = []
    for (flow, factor), weight in zip(levels, LEVEL_WEIGHTS[-len(levels) :]):
        wanted, known = at_level(target, valid, factor, *flow.shape[2:])
        difference = flow - wanted
        if error == "robust":
            distance = (difference.abs().sum(1, keepdim=True) + 0.01) ** 0.4
        else:
            # ‖·‖₂ with a floor under the root, so that no error has no slope instead of NaN.
            distance = ((difference**2).sum(1, keepdim=True) + 1e-8).sqrt()
        terms.append(weight * (distance * known).sum((1, 2, 3)).mean())
    return terms


def matching_term(flow, logits, start, factor, target, valid):
    """Cross-entropy between a cost volume and the true displacement: a learning aid, no part of the paper.

    Over the pixels whose displacement the volume holds and whose source lies in the image, divided by one more than their count.
    """
    height, width = flow.shape[2:]
    radius = math.isqrt(logits.shape[1]) // 2
    wanted, known = at_level(target, valid, factor, height, width)
    source = wanted * UNIT_PX / factor
    displacement = source if start is None else source - start.detach() * UNIT_PX / factor
    at = source + torch.stack(torch.meshgrid(torch.arange(width), torch.arange(height), indexing="xy"))
    counted = known[:, 0] > 0.5
    for axis, length in [(0, width), (1, height)]:
        counted &= displacement[:, axis].abs() < radius + 0.5
        counted &= (at[:, axis] > -0.5) & (at[:, axis] < length - 0.5)
    step = (displacement + radius).round().clamp(0, 2 * radius).long()
    entropy = F.cross_entropy(logits, step[:, 1] * (2 * radius + 1) + step[:, 0], reduction="none")
    return (entropy * counted).sum() / (counted.sum() + 1)


def map_terms(predicted, target):
    """Normal, diffuse, roughness, specular; maps `[N, 10, H, W]` in the order normal 3, diffuse 3, roughness 1, specular 3."""
    log = lambda albedo: torch.log(0.01 + albedo)
    part = lambda maps: (maps[:, :3], log(maps[:, 3:6]), maps[:, 6:7] * 2 - 1, log(maps[:, 7:10]))
    return [F.l1_loss(p, t) for p, t in zip(part(predicted), part(target))]


def unit(v):
    return v / v.norm(dim=1, keepdim=True)


def dot(a, b):
    return (a * b).sum(1, keepdim=True)


def brdf(maps, wi, wo, specular_model, diffuse_model):
    """ρd/π + D·F·G / (4 n·wi n·wo); the specular part is 0 below the horizon."""
    normal, diffuse, roughness, specular = maps[:, :3], maps[:, 3:6], maps[:, 6:7], maps[:, 7:10]
    alpha, h = roughness**2, unit(wi + wo)
    nl, nv, nh, vh = dot(normal, wi), dot(normal, wo), dot(normal, h), dot(wo, h)
    if specular_model == "ggx":
        # Walter et al. 2007, Eqs. 33 and 34, and Schlick 1994.
        above = (nl > 0) & (nv > 0)
        d = alpha**2 / (math.pi * (nh**2 * (alpha**2 - 1) + 1) ** 2)
        g1 = lambda c: 2 / (1 + torch.sqrt(1 + alpha**2 * (1 - c**2) / c**2))
        f = specular + (1 - specular) * (1 - vh) ** 5
        # A safe cosine where the result is thrown away, lest its slope be NaN.
        safe_l, safe_v = torch.where(above, nl, 1.0), torch.where(above, nv, 1.0)
        lobe = torch.where(above, d * f * g1(safe_l) * g1(safe_v) / (4 * safe_l * safe_v), 0.0)
    else:
        # What the authors' code computes.
        d = (alpha / torch.clamp(nh.clamp_min(0) ** 2 * (alpha**2 - 1) + 1, min=1e-3)) ** 2 / math.pi
        k = alpha / 2
        g = lambda c: 1 / torch.clamp(c.clamp_min(0) * (1 - k) + k, min=1e-3)
        f = specular + (1 - specular) * 2 ** ((-5.55473 * vh - 6.98316) * vh)
        lobe = d * f * g(nl) * g(nv) / 4
    share = 1 - specular if diffuse_model == "inria" else 1
    return diffuse * share / math.pi + lobe


def render(maps, view, model):
    """Linear radiance over the plane [−1, 1]²; a view is camera xyz and 1 (or 0 for a direction), then the light's."""
    height, width = maps.shape[2:]
    x = (2 * torch.arange(width, dtype=torch.float64) + 1) / width - 1
    y = 1 - (2 * torch.arange(height, dtype=torch.float64) + 1) / height
    plane = torch.stack([x.expand(height, width), y[:, None].expand(height, width), torch.zeros(height, width)])[None]
    towards = lambda origin: unit(origin[:3].reshape(1, 3, 1, 1) - origin[3] * plane)
    wo, wi = towards(view[:4]), towards(view[4:])
    cosine = dot(maps[:, :3], wi).clamp_min(0)
    # The light has no fall-off, and after the cosine the plane's own cosine is divided out.
    return brdf(maps, wi, wo, *model) * cosine * 1.5 * math.pi / wi[:, 2:].clamp_min(1e-3)


def rendering_terms(predicted, target, rendering, top, model):
    """L_r over the diffuse and specular views, L_t over those from the top."""
    log = lambda maps, view: torch.log(render(maps, view, model) + 0.1)
    mean = lambda views: torch.stack([F.l1_loss(log(predicted, v), log(target, v)) for v in views]).mean()
    return [mean(rendering), mean(top)]


def draw_views(generator):
    """Three diffuse, six specular and six top views, drawn as the paper says."""
    uniform = lambda low, high: low + (high - low) * torch.rand((), generator=generator, dtype=torch.float64)

    def oblique():
        r1, azimuth = uniform(0.001, 0.9), uniform(0, 2 * math.pi)
        return torch.stack([r1.sqrt() * azimuth.cos(), r1.sqrt() * azimuth.sin(), (1 - r1).sqrt()])

    zero, one = torch.zeros(1, dtype=torch.float64), torch.ones(1, dtype=torch.float64)
    rendering = [torch.cat([oblique(), zero, oblique(), zero]) for _ in range(3)]
    for _ in range(6):
        direction = oblique()
        shift = torch.cat([uniform(-1, 1)[None], uniform(-1, 1)[None], zero])
        far = lambda: torch.exp(0.5 + 0.75 * torch.randn((), generator=generator, dtype=torch.float64))
        mirrored = direction * torch.tensor([-1, -1, 1])
        rendering.append(torch.cat([direction * far() + shift, one, mirrored * far() + shift, one]))
    top = []
    for _ in range(6):
        camera = torch.stack([uniform(-1, 1), uniform(-1, 1), 1 / torch.tan(torch.deg2rad(uniform(25, 35)) / 2)])
        top.append(torch.cat([camera, one, camera, one]))
    return [torch.stack(views).to(torch.float32).to(torch.float64) for views in (rendering, top)]


def random_maps(height, width, generator):
    """Maps over the whole range that the net can express."""
    draw = lambda channels, low, high: low + (high - low) * torch.rand((1, channels, height, width), generator=generator, dtype=torch.float64)
    slopes = draw(2, -1.2, 1.2)
    normal = F.normalize(torch.cat([slopes, torch.ones_like(slopes[:, :1])], 1), dim=1)
    maps = torch.cat([normal, draw(3, 0.0, 0.9), draw(1, 0.15, 1.0), draw(3, 0.0, 0.6)], 1)
    return maps.to(torch.float32).to(torch.float64)


def main():
    generator = torch.Generator().manual_seed(11)
    rendering, top = draw_views(generator)
    predicted, target = random_maps(12, 20, generator), random_maps(12, 20, generator)
    # Only slopes along the unit sphere mean something: off it, formulas that are the same for unit normals differ.
    free = predicted.clone().requires_grad_()
    predicted = torch.cat([F.normalize(free[:, :3], dim=1), free[:, 3:]], 1)
    case = {"predicted": golden.single(predicted), "target": golden.single(target)}
    case |= {"views.rendering": golden.single(rendering), "views.top": golden.single(top)}
    for model in MODELS:
        maps, (l_r, l_t) = map_terms(predicted, target), rendering_terms(predicted, target, rendering, top, model)
        l_s = sum(maps)
        total = 0.1 * l_s + 1.0 * l_r + 1.0 * l_t
        # The authors' code takes one mean over all fifteen renderings.
        single_mean = 0.1 * l_s + (9 * l_r + 6 * l_t) / 15
        name = ".".join(model)
        case[f"{name}.terms"] = golden.single(torch.stack([*maps, l_s, l_r, l_t, total, single_mean]))
        slopes = {"rendering": l_r, "top": l_t}
        if model == MODELS[0]:
            slopes |= {"maps": l_s, "total": total}
        for term, value in slopes.items():
            (slope,) = torch.autograd.grad(value, free, retain_graph=True)
            case[f"{name}.gradient.{term}"] = golden.single(slope)
        print(f"losses {name}: L_s {l_s:.4f}, L_r {l_r:.4f}, L_t {l_t:.4f}")
    golden.write(golden.FOLDER / "svbrdf" / "losses.safetensors", case)
