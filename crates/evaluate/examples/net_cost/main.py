"""The PyTorch side of net_cost: what main.rs asks for, by the twins of tests/golden/generate.

First line in: the work as JSON. Every further line asks for the milliseconds of one step or for the memory in MiB.
"""

import json
import resource
import sys
import time
from pathlib import Path

import torch

# The twins compute in double precision; what is timed is single.
torch.float64 = torch.float32
sys.path.insert(0, str(Path(__file__).resolve().parents[4] / "tests/golden/generate"))

import flow_cases
import losses
import svbrdf_cases
from pwc import Pwc, cost_volume
from svbrdf import warp

SIDE = 256


def peak():
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


torch.set_num_threads(int(sys.argv[1]))
started = peak()
work = json.loads(sys.stdin.readline())
training = work["training"]
generator = torch.Generator().manual_seed(1)


def picture(count, channels, side):
    return torch.rand((count, channels, side, side), generator=generator)


def svbrdf_step():
    net = svbrdf_cases.drawn(svbrdf_cases.shape(width=work["width"]), 1)
    keys = work["frames"] - 1
    frames, flow = picture(keys + 1, 3, SIDE), svbrdf_cases.flows(keys, SIDE, SIDE, generator)
    valid = torch.ones(keys, 1, SIDE, SIDE)
    target = losses.random_maps(SIDE, SIDE, generator)
    rendering, top = losses.draw_views(generator)

    def step():
        maps = net(frames, flow, valid)
        if training:
            terms = losses.rendering_terms(maps, target, rendering, top, losses.MODELS[0])
            (0.1 * sum(losses.map_terms(maps, target)) + sum(terms)).backward()
            net.zero_grad()

    return step


def pwc_step():
    net = flow_cases.drawn({}, 1)
    first, second = picture(1, 3, SIDE), picture(1, 3, SIDE)
    target, valid = svbrdf_cases.flows(1, SIDE, SIDE, generator).nan_to_num(), torch.ones(1, 1, SIDE, SIDE)

    def step():
        levels = net.levels(first, second)
        if training:
            flows = [(flow, factor) for flow, _, _, factor in levels]
            sum(losses.flow_terms(flows, target, valid, "euclidean")).backward()
            net.zero_grad()
        else:
            net.full(levels, SIDE, SIDE)

    return step


def warp_maximum_step():
    frames, width = work["frames"], work["width"]
    guidance, features = picture(1, width, SIDE).requires_grad_(), picture(frames, width, SIDE).requires_grad_()
    flow = svbrdf_cases.flows(frames, SIDE, SIDE, generator)

    def step():
        values, mask = warp(features, flow)
        maximum = torch.maximum(guidance, torch.where(mask, values, -1e38).amax(0, keepdim=True))
        maximum.sum().backward()
        guidance.grad = features.grad = None

    return step


def cost_volume_step():
    net = Pwc()
    levels = [(level, convs.convs[-1].bias.numel()) for level, convs in enumerate(net.pyramid.levels)][1:]
    pairs = [[picture(1, channels, SIDE >> (level + 1)).requires_grad_() for _ in range(2)] for level, channels in levels]

    def step():
        sum(cost_volume(a, b, net.radius).sum() for a, b in pairs).backward()
        for maps in (maps for pair in pairs for maps in pair):
            maps.grad = None

    return step


kinds = {"svbrdf": svbrdf_step, "pwc": pwc_step, "warp-maximum": warp_maximum_step, "cost-volume": cost_volume_step}
step = kinds[work["kind"]]()
for question in sys.stdin:
    if question.strip() == "memory":
        print(peak() - started, flush=True)
    else:
        with torch.set_grad_enabled(training):
            began = time.perf_counter()
            step()
            print((time.perf_counter() - began) * 1e3, flush=True)
