"""PWC-Net in PyTorch, written from Sun et al. 2018: as the paper's authors vary it (no dense connections, bilinear upsampling), as
published, and between the two.

`Pwc(**architecture)` takes the architecture of a manifest; its `state_dict` has the names and layouts of the weights' files.
"""

import torch
import torch.nn.functional as F
from torch import nn

UNIT_PX = 20.0
DILATIONS = [1, 2, 4, 8, 16, 1, 1]


class Conv(nn.Module):
    """3×3 with bias and zero padding; leaky ReLU unless it predicts."""

    def __init__(self, inputs, outputs, stride=1, dilation=1):
        super().__init__()
        self.weight = nn.Parameter(torch.empty(outputs, inputs, 3, 3))
        self.bias = nn.Parameter(torch.empty(outputs))
        self.stride, self.dilation = stride, dilation

    def linear(self, x):
        return F.conv2d(x, self.weight, self.bias, self.stride, self.dilation, self.dilation)

    def forward(self, x):
        return F.leaky_relu(self.linear(x), 0.1)


class Level(nn.Module):
    def __init__(self, inputs, outputs, convs):
        super().__init__()
        layers = [Conv(inputs, outputs, stride=2)]
        layers += [Conv(outputs, outputs) for _ in range(convs - 1)]
        self.convs = nn.ModuleList(layers)


class Pyramid(nn.Module):
    def __init__(self, channels, convs_per_level):
        super().__init__()
        self.levels = nn.ModuleList(Level(i, o, convs_per_level) for i, o in zip([3, *channels], channels))

    def forward(self, x):
        found = []
        for level in self.levels:
            for conv in level.convs:
                x = conv(x)
            found.append(x)
        return found


class Estimator(nn.Module):
    def __init__(self, inputs, widths, dense):
        super().__init__()
        seen = [inputs + sum(widths[:n]) for n in range(len(widths) + 1)] if dense else [inputs, *widths]
        self.dense, self.outputs = dense, seen[-1]
        self.convs = nn.ModuleList(Conv(i, o) for i, o in zip(seen, widths))
        self.predict = Conv(self.outputs, 2)

    def forward(self, x):
        for conv in self.convs:
            x = torch.cat([conv(x), x], 1) if self.dense else conv(x)
        return self.predict.linear(x), x


class Deconvolution(nn.Module):
    """To twice the size and two channels."""

    def __init__(self, inputs):
        super().__init__()
        self.weight = nn.Parameter(torch.empty(inputs, 2, 4, 4))
        self.bias = nn.Parameter(torch.empty(2))

    def forward(self, x):
        return F.conv_transpose2d(x, self.weight, self.bias, stride=2, padding=1)


class Upsampler(nn.Module):
    def __init__(self, inputs):
        super().__init__()
        self.flow, self.features = Deconvolution(2), Deconvolution(inputs)


class Context(nn.Module):
    def __init__(self, inputs, widths):
        super().__init__()
        layers = zip([inputs, *widths], widths, DILATIONS)
        self.convs = nn.ModuleList(Conv(i, o, dilation=d) for i, o, d in layers)
        self.predict = Conv(widths[-1], 2)

    def forward(self, x):
        for conv in self.convs:
            x = conv(x)
        return self.predict.linear(x)


class Matching(nn.Module):
    """The sharpness of the soft-argmax, a learning aid; without it the cost volume has no weights."""

    def __init__(self, match_head):
        super().__init__()
        self.sharpness = nn.Parameter(torch.empty(1)) if match_head else None


class Pwc(nn.Module):
    """The net; what isn't given is the paper's."""

    def __init__(
        self,
        channels=(16, 32, 64, 96, 128, 192),
        convs_per_level=3,
        estimator=(128, 128, 96, 64, 32),
        connections="sequential",
        upsampling="bilinear",
        prediction="residual",
        coarsest_features=True,
        radius=4,
        context=(128, 128, 128, 96, 64, 32),
        input="plain",
        feature_normalisation=False,
        match_head=False,
    ):
        super().__init__()
        self.radius, self.multiple, self.match_head = radius, 2 ** len(channels), match_head
        self.dense, self.residual = connections == "dense", prediction == "residual"
        self.coarsest_features, self.feature_normalisation = coarsest_features, feature_normalisation
        self.local_contrast = input == "local-contrast"
        deconvolution = upsampling == "deconvolution"
        self.pyramid = Pyramid(channels, convs_per_level)
        cost, upsampled = (2 * radius + 1) ** 2, 2 + (2 if deconvolution else estimator[-1])
        inputs = [cost + c + upsampled for c in reversed(channels[1:])]
        inputs[0] = cost + (channels[-1] if coarsest_features else 0)
        self.matchings = nn.ModuleList(Matching(match_head) for _ in inputs)
        self.estimators = nn.ModuleList(Estimator(i, estimator, self.dense) for i in inputs)
        learned = self.estimators[:-1] if deconvolution else []
        self.upsamplers = nn.ModuleList(Upsampler(estimator.outputs) for estimator in learned)
        seen = self.estimators[-1].outputs + (0 if self.dense else 2)
        self.context = Context(seen, context) if context else None

    def forward(self, first, second):
        """Flow in pixels `[N, 2, H, W]` (x, y) from `first` to `second` `[N, 3, H, W]`, gamma-encoded RGB in [0, 1]."""
        return self.full(self.levels(first, second), *first.shape[2:])

    def levels(self, first, second):
        """Per level, coarse to fine: flow in units of 20 px, logits over displacements, flow that it started from, factor."""
        height, width = first.shape[2:]
        padding = (0, -width % self.multiple, 0, -height % self.multiple)
        images = F.pad(torch.cat([first, second]), padding, mode="replicate")
        images = local_contrast(images) if self.local_contrast else images
        levels, flow, features = [], None, None
        for index, maps in enumerate(self.pyramid(images)[:0:-1]):
            factor = self.multiple // 2**index
            near, _ = maps.chunk(2)
            matched, other = (normalised(maps) if self.feature_normalisation else maps).chunk(2)
            start = None
            if flow is not None:
                if self.upsamplers:
                    upsampler = self.upsamplers[index - 1]
                    start, features = upsampler.flow(flow), upsampler.features(features)
                else:
                    start, features = enlarge(flow, 2), enlarge(features, 2)
                other = warp(other, start * UNIT_PX / factor)
            cost = cost_volume(matched, other, self.radius)
            inputs = [F.leaky_relu(cost, 0.1)]
            inputs += [near] if start is not None or self.coarsest_features else []
            inputs += [start, features] if start is not None else []
            flow, features = self.estimators[index](torch.cat(inputs, 1))
            sharpness = self.matchings[index].sharpness
            logits = cost * (12.0 if sharpness is None else sharpness)
            if self.match_head:
                flow = flow + soft_argmax(logits, self.radius) * factor / UNIT_PX
            if start is not None and self.residual:
                flow = flow + start
            if self.context is not None and index == len(self.estimators) - 1:
                flow = flow + self.context(features if self.dense else torch.cat([features, flow], 1))
            levels.append((flow, logits, start, factor))
        return levels

    def full(self, levels, height, width):
        """Flow in pixels of the image."""
        flow, _, _, factor = levels[-1]
        return enlarge(flow, factor)[..., :height, :width] * UNIT_PX


def enlarge(x, factor):
    return F.interpolate(x, scale_factor=factor, mode="bilinear", align_corners=False)


def warp(x, flow):
    """Bilinear samples at pixel + flow; 0 where a tap lies outside."""
    height, width = x.shape[2:]
    px = flow[:, 0] + torch.arange(width, dtype=x.dtype, device=x.device)
    py = flow[:, 1] + torch.arange(height, dtype=x.dtype, device=x.device)[:, None]
    inside = (px >= 0) & (px <= width - 1) & (py >= 0) & (py <= height - 1)
    grid = torch.stack([px * 2 / max(width - 1, 1) - 1, py * 2 / max(height - 1, 1) - 1], 3)
    return F.grid_sample(x, grid, mode="bilinear", align_corners=True) * inside[:, None]


def cost_volume(first, second, radius):
    """Mean over channels of first(x)·second(x + d); rows of displacements from top to bottom, each from left to right."""
    height, width = first.shape[2:]
    padded = F.pad(second, (radius,) * 4)
    around = range(2 * radius + 1)
    planes = [(first * padded[:, :, y : y + height, x : x + width]).mean(1) for y in around for x in around]
    return torch.stack(planes, 1)


def soft_argmax(logits, radius):
    """The mean displacement under the softmax of the logits, in pixels of the level."""
    side = torch.arange(-radius, radius + 1, dtype=logits.dtype, device=logits.device)
    y, x = torch.meshgrid(side, side, indexing="ij")
    probability = logits.softmax(1)
    return torch.stack([(probability * d.reshape(1, -1, 1, 1)).sum(1) for d in (x, y)], 1)


def local_contrast(images):
    """Deviation from the local mean over the local deviation, windows of 17 px with repeated borders, limited to ±3."""
    # Rows, then columns: sums of all 289 numbers at a time would lose three digits in single precision.
    across = lambda x: F.avg_pool2d(F.pad(x, (8, 8, 0, 0), mode="replicate"), (1, 17), stride=1)
    down = lambda x: F.avg_pool2d(F.pad(x, (0, 0, 8, 8), mode="replicate"), (17, 1), stride=1)
    mean = lambda x: down(across(x))
    deviation = images - mean(images)
    energy = mean((deviation**2).mean(1, keepdim=True))
    return (deviation / (energy.sqrt() + 0.02)).clamp(-3, 3)


def normalised(maps):
    """Per image without mean, per pair and channel of unit deviation, per pixel of unit length."""
    centred = maps - maps.mean((2, 3), keepdim=True)
    variance = (centred**2).mean((2, 3), keepdim=True)
    variance = torch.stack(variance.chunk(2)).mean(0).repeat(2, 1, 1, 1)
    scaled = centred / ((variance + 1e-12).sqrt() + 1e-3)
    return scaled / ((scaled**2).mean(1, keepdim=True) + 1e-3).sqrt()
