"""The fifteen loss renderings in PyTorch, for rendering_cost.rs, which starts this program and talks to it.

First line in: the size of the maps and the views as JSON. Every further line asks for one step; the answer is its
milliseconds and the loss.
"""
import json
import math
import sys
import time

import torch

torch.set_num_threads(int(sys.argv[1]))
setup = json.loads(sys.stdin.readline())
size = setup["size"]


def maps(phase, grad):
    y, x = torch.meshgrid(torch.arange(size, dtype=torch.float32), torch.arange(size, dtype=torch.float32), indexing="ij")
    normal = torch.stack([torch.sin(0.1 * x + phase) * 0.3, torch.cos(0.13 * y) * 0.3, torch.ones_like(x)])
    normal = normal / normal.norm(dim=0, keepdim=True)
    full = lambda v: torch.full_like(x, v)
    diffuse = torch.stack([0.5 + 0.4 * torch.sin(0.05 * x), full(0.3), full(0.2)])
    roughness = (0.5 + 0.4 * torch.sin(0.07 * y + phase))[None]
    specular = torch.stack([full(0.04), full(0.05), full(0.3)])
    return [m.clone().requires_grad_(grad) for m in (normal, diffuse, roughness, specular)]


axis = (2 * torch.arange(size, dtype=torch.float32) + 1) / size - 1
plane = torch.stack([axis[None, :].expand(size, size), -axis[:, None].expand(size, size), torch.zeros(size, size)])


def unit(v):
    return v / v.norm(dim=0, keepdim=True).clamp_min(1e-15)


def dot(a, b):
    return (a * b).sum(0, keepdim=True)


def towards(origin):
    (kind, position), = origin.items()
    position = torch.tensor(position).reshape(3, 1, 1)
    return unit(position - plane) if kind == "Point" else position


def render(m, view):
    normal, diffuse, roughness, specular = m
    wi, wo = towards(view["light"]), towards(view["camera"])
    h = unit(wi + wo)
    nl, nv, nh = dot(normal, wi).clamp_min(0), dot(normal, wo), dot(normal, h)
    alpha2 = roughness.clamp_min(0.01) ** 4
    d = alpha2 / (math.pi * (alpha2 * nh**2 + torch.cross(normal, h.expand_as(normal), dim=0).square().sum(0, keepdim=True)) ** 2)
    smith = lambda c: 1 / (c + (alpha2 + (1 - alpha2) * c**2).sqrt())
    lobe = d * smith(nl) * smith(nv.clamp_min(0)) * (nv > 0)
    weight = (1 - dot(wo, h)).clamp(0, 1) ** 5
    light = view["emission"]["Even"]["intensity"] / wi[2:3].clamp_min(1e-3)
    return nl * (diffuse / math.pi + lobe * (specular + (1 - specular) * weight)) * light


def loss(pred, target):
    total = 0
    for views in (setup["rendering"], setup["top"]):
        terms = [((render(pred, v) + 0.1).log() - (render(target, v) + 0.1).log()).abs().mean() for v in views]
        total = total + sum(terms) / len(views)
    return total


target = maps(0.0, False)
for _ in sys.stdin:
    pred = maps(0.3, True)
    began = time.perf_counter()
    value = loss(pred, target)
    value.backward()
    print((time.perf_counter() - began) * 1e3, value.item(), flush=True)
