"""PWC-DC-Net in PyTorch as Sun et al. 2018 published it, module by module under the names of their PyTorch release.

The files hold it under the names of `flow::pwc`: a published checkpoint fits when its tensors are renamed as here.
"""

import re

import torch
import torch.nn.functional as F
from torch import nn

import golden
from flow_cases import make_case, shape
from pwc import UNIT_PX, cost_volume, enlarge

# From the flow in units of 20 px to pixels of a level: 20 / 32, 20 / 16, …
WARP_SCALES = {5: 0.625, 4: 1.25, 3: 2.5, 2: 5.0}
UNUSUAL = {"connections": "dense", "upsampling": "deconvolution", "prediction": "direct", "coarsest_features": False}
LEAKY = nn.LeakyReLU(0.1)


def conv(inputs, outputs, stride=1, dilation=1):
    return nn.Sequential(nn.Conv2d(inputs, outputs, 3, stride, dilation, dilation), LEAKY)


def predict_flow(inputs):
    return nn.Conv2d(inputs, 2, 3, padding=1)


def deconv(inputs):
    return nn.ConvTranspose2d(inputs, 2, 4, stride=2, padding=1)


def pyramid_names(level, convs=3):
    """A level's convolutions in the order in which they are applied: at level 6 the release swaps the first two names. Its first
    version has two."""
    parts = ["a", "b"] if convs == 2 else ["aa", "a", "b"] if level == 6 else ["a", "aa", "b"]
    return [f"conv{level}{part}" for part in parts]


class Published(nn.Module):
    def __init__(self, architecture, seed):
        super().__init__()
        self.radius, self.convs = architecture["radius"], architecture["convs_per_level"]
        self.estimators = range(len(architecture["estimator"]))
        channels = [3, *architecture["channels"]]
        for level in range(1, 7):
            first, *others = pyramid_names(level, self.convs)
            setattr(self, first, conv(channels[level - 1], channels[level], stride=2))
            for name in others:
                setattr(self, name, conv(channels[level], channels[level]))
        for level in range(6, 1, -1):
            seen = (2 * self.radius + 1) ** 2 + (0 if level == 6 else channels[level] + 4)
            for index, width in enumerate(architecture["estimator"]):
                setattr(self, f"conv{level}_{index}", conv(seen, width))
                seen += width
            setattr(self, f"predict_flow{level}", predict_flow(seen))
            # The release has a deconv2 too, whose output nothing reads.
            if level > 2:
                setattr(self, f"deconv{level}", deconv(2))
                setattr(self, f"upfeat{level}", deconv(seen))
        for index, (width, dilation) in enumerate(zip(architecture["context"], [1, 2, 4, 8, 16, 1]), 1):
            setattr(self, f"dc_conv{index}", conv(seen, width, dilation=dilation))
            seen = width
        self.dc_conv7 = predict_flow(seen)
        self.draw(torch.Generator().manual_seed(seed))

    def draw(self, generator):
        """Random weights, the predictions strong enough that the flow moves features by more than a pixel."""
        for name, parameter in self.named_parameters():
            if name.endswith("bias"):
                deviation = 0.05
            elif name.startswith(("deconv", "upfeat")):
                # [inputs, outputs, 4, 4], of which 2×2 taps reach an output.
                deviation = (4 * parameter.shape[0]) ** -0.5
            else:
                gain = 3.0 if name.startswith(("predict_flow", "dc_conv7")) else 2**0.5
                deviation = gain * parameter[0].numel() ** -0.5
            parameter.data = golden.normal(parameter.shape, deviation, generator).data

    def pyramid(self, image):
        found = {}
        for level in range(1, 7):
            for name in pyramid_names(level, self.convs):
                image = self.get_submodule(name)(image)
            found[level] = image
        return found

    def context(self, x):
        for index in range(1, 8):
            x = self.get_submodule(f"dc_conv{index}")(x)
        return x

    def levels(self, first, second):
        """Per level, coarse to fine: flow in units of 20 px, correlation, flow that it started from, factor."""
        height, width = first.shape[2:]
        grow = lambda image: F.pad(image, (0, -width % 64, 0, -height % 64), mode="replicate")
        near, far = self.pyramid(grow(first)), self.pyramid(grow(second))
        levels, up_flow = [], None
        for level in range(6, 1, -1):
            other = far[level] if up_flow is None else warp(far[level], up_flow * WARP_SCALES[level])
            corr = cost_volume(near[level], other, self.radius)
            x = LEAKY(corr)
            if up_flow is not None:
                x = torch.cat((x, near[level], up_flow, up_feat), 1)
            for index in self.estimators:
                x = torch.cat((self.get_submodule(f"conv{level}_{index}")(x), x), 1)
            flow = self.get_submodule(f"predict_flow{level}")(x)
            if level == 2:
                flow = flow + self.context(x)
            levels.append((flow, corr, up_flow, 2**level))
            if level > 2:
                up_flow, up_feat = self.get_submodule(f"deconv{level}")(flow), self.get_submodule(f"upfeat{level}")(x)
        return levels

    def full(self, levels, height, width):
        """Flow in pixels of the image."""
        return enlarge(levels[-1][0], 4)[..., :height, :width] * UNIT_PX


def warp(x, flow):
    """Bilinear samples at pixel + flow, and 0 wherever a sample of ones falls below 0.9999."""
    height, width = x.shape[2:]
    px = torch.arange(width, dtype=x.dtype) + flow[:, 0]
    py = torch.arange(height, dtype=x.dtype)[:, None] + flow[:, 1]
    grid = torch.stack([2 * px / max(width - 1, 1) - 1, 2 * py / max(height - 1, 1) - 1], 3)
    sample = lambda values: F.grid_sample(values, grid, align_corners=True)
    return sample(x) * (sample(torch.ones_like(x)) >= 0.9999)


def renamed(name):
    """Where `flow::pwc` keeps a published tensor."""
    module, kind = name.split(".")[0], name.split(".")[-1]
    if found := re.fullmatch(r"conv(\d)(a|aa|b)", module):
        level = int(found[1])
        path = f"pyramid.levels.{level - 1}.convs.{pyramid_names(level).index(module)}"
    elif found := re.fullmatch(r"conv(\d)_(\d)", module):
        path = f"estimators.{6 - int(found[1])}.convs.{found[2]}"
    elif found := re.fullmatch(r"dc_conv(\d)", module):
        path = "context.predict" if found[1] == "7" else f"context.convs.{int(found[1]) - 1}"
    else:
        part, level = re.fullmatch(r"(predict_flow|deconv|upfeat)(\d)", module).groups()
        places = {"predict_flow": "estimators.{}.predict", "deconv": "upsamplers.{}.flow", "upfeat": "upsamplers.{}.features"}
        path = places[part].format(6 - int(level))
    return f"{path}.{kind}"


def make_release(name, architecture, seed, save):
    """Writes one folder: a checkpoint as the release's, with float weights, BGR filters and the layer that nothing reads; a pair of
    RGB pictures, and the flow that the release finds on their BGR versions."""
    net = Published(architecture, seed)
    golden.round_weights(net, "f32")
    generator = torch.Generator().manual_seed(seed + 1000)
    pictures = golden.textures(2, 64, 64, generator)
    # From RGB to BGR.
    first, second = golden.decoded(pictures).flip(1).chunk(2)
    case = {"images": pictures.numpy(), "flow": golden.single(net.full(net.levels(first, second), 64, 64))}
    unread = {"deconv2.weight": torch.zeros(2, 2, 4, 4), "deconv2.bias": torch.zeros(2)}
    folder = golden.FOLDER / "flow" / name
    golden.write(folder / "case.safetensors", case)
    save({key: value.float() for key, value in net.state_dict().items()} | unread, folder / "pwc_net.pth.tar")
    print(f"flow/{name}: {sum(p.numel() for p in net.parameters())} parameters, flow up to {case['flow'].max():.1f} px")


def save_current(state, path):
    torch.save(state, path)


def save_as_then(state, path):
    """As training scripts of the time saved: from several GPUs, with other things beside, before archives."""
    checkpoint = {"epoch": 7, "best_EPE": 2.5, "arch": "pwc_dc_net", "state_dict": {f"module.{k}": v for k, v in state.items()}}
    torch.save(checkpoint, path, _use_new_zipfile_serialization=False)


def count():
    full = shape([16, 32, 64, 96, 128, 196], context=[128, 128, 128, 96, 64, 32])
    return {"pwc_published": sum(p.numel() for p in Published(full, 0).parameters())}


def main():
    # About a sixteenth of the widths; the whole cost volume.
    sixteenth = shape([2, 2, 4, 6, 8, 12], estimator=[6, 6, 4, 4, 2], context=[8, 8, 8, 6, 4, 2], **UNUSUAL)
    make_case("published-sixteenth", Published(sixteenth, 6), sixteenth, (66, 70), 1, 6, 6.0, ["euclidean"], renamed)
    tiny = {"channels": [2, 2, 2, 3, 3, 4], "estimator": [2, 2, 1, 1, 1], "context": [2, 2, 2, 1, 1, 1], "radius": 2}
    make_release("release", shape(**tiny), 7, save_current)
    make_release("release-first-version", shape(**tiny, convs_per_level=2), 8, save_as_then)
