"""The SVBRDF net in PyTorch, written from the paper (§6, Eq. 5) and Deschaintre et al. 2019.

`SvbrdfNet(**architecture)` takes the architecture of a manifest; its `state_dict` has the names and layouts of the weights' files.
Dropout is left out: nothing here trains.
"""

import torch
import torch.nn.functional as F
from torch import nn

ENCODER = [1, 2, 4, 8, 8, 8, 8, 8]
DECODER = [8, 8, 8, 8, 4, 2, 1, 1]
HEAD = [64, 64, 48, 32, 16]
OUTPUTS = 9


class Shape:
    """A net's configuration; what isn't given is the paper's."""

    def __init__(
        self,
        width=64,
        levels=8,
        normalisation="weight",
        fusion="features",
        pixel_features="none",
        filter_gain=1.0,
        pooling="max",
    ):
        self.width, self.levels, self.pooling = width, levels, pooling
        self.normalisation, self.fusion, self.pixel_features = normalisation, fusion, pixel_features
        self.filter_gain = filter_gain
        self.inputs = 6 if fusion == "frames" else 5
        self.encoder = [width * f for f in ENCODER[:levels]]
        self.decoder = [width * f for f in DECODER[8 - levels :]]
        # The paper has one width only; narrower nets scale the head but keep it at 16 or their own width.
        self.head = [max(h * width // 64, min(16, width)) for h in HEAD]
        self.global_width = 2 * width
        self.colours = 6 if pixel_features == "extremes" else 0
        self.statistics = 3 if pooling == "max-mean-variance" else 1
        # Pixels aligned with less confidence take no part; attention weighs the doubtful ones.
        self.least_confidence = 1e-37 if pooling == "attention" else 0.5


class Affine(nn.Module):
    def __init__(self, channels):
        super().__init__()
        self.scale = nn.Parameter(torch.empty(channels))
        self.offset = nn.Parameter(torch.empty(channels))


class Convolution(nn.Module):
    """3×3, edge padding, no bias, normalised."""

    def __init__(self, inputs, outputs, shape):
        super().__init__()
        self.weight = nn.Parameter(torch.empty(outputs, inputs, 3, 3))
        self.gain = shape.filter_gain
        self.affine = Affine(outputs) if shape.normalisation == "instance" else None

    def forward(self, x, stride=1):
        """Normalised maps, and the means of the convolution's own output."""
        x = F.pad(x, (1, 1, 1, 1), mode="replicate")
        if self.affine is None:
            # Eq. 5: each output channel's filter over its norm.
            weight = self.weight / torch.sqrt((self.weight**2).sum(dim=(1, 2, 3), keepdim=True) + 1e-8)
            maps = F.conv2d(x, weight * self.gain, stride=stride)
            return maps, maps.mean(dim=(2, 3))
        raw = F.conv2d(x, self.weight, stride=stride)
        return F.instance_norm(raw, weight=self.affine.scale, bias=self.affine.offset, eps=1e-5), raw.mean(dim=(2, 3))


class GlobalTrack(nn.Module):
    """Means and the previous vector → the next one; the previous vector → something to add to the layer's maps."""

    def __init__(self, channels, shape, first, statistics=1):
        super().__init__()
        previous = statistics * shape.global_width
        # Matrices [inputs, outputs], a row vector times them.
        self.weight = nn.Parameter(torch.empty(channels if first else channels + previous, shape.global_width))
        self.bias = nn.Parameter(torch.empty(shape.global_width))
        self.injection = None if first else nn.Parameter(torch.empty(previous, channels))

    def forward(self, maps, means, previous):
        if previous is None:
            return maps, F.selu(means @ self.weight + self.bias)
        following = F.selu(torch.cat([means, previous], 1) @ self.weight + self.bias)
        return maps + (previous @ self.injection)[:, :, None, None], following


class Layer(nn.Module):
    """A convolution with its part of the global track."""

    def __init__(self, inputs, outputs, shape, first, statistics=1):
        super().__init__()
        self.convolution = Convolution(inputs, outputs, shape)
        setattr(self, "global", GlobalTrack(outputs, shape, first, statistics))

    def forward(self, x, previous, stride=1):
        return getattr(self, "global")(*self.convolution(x, stride), previous)


class Block(nn.Module):
    """Nearest ×2 and two convolutions, the second with the global track."""

    def __init__(self, inputs, outputs, shape):
        super().__init__()
        self.enlarged = Convolution(inputs, outputs, shape)
        self.refined = Convolution(outputs, outputs, shape)
        setattr(self, "global", GlobalTrack(outputs, shape, False))

    def forward(self, x, previous, size):
        # An odd level is one pixel smaller than twice the next one.
        x = F.interpolate(x, scale_factor=2, mode="nearest")[..., : size[0], : size[1]]
        x = self.refined(leaky(self.enlarged(x)[0]))
        return getattr(self, "global")(*x, previous)


class Encoder(nn.Module):
    def __init__(self, shape):
        super().__init__()
        inputs = [shape.inputs, *shape.encoder]
        self.levels = nn.ModuleList(Layer(i, o, shape, n == 0) for n, (i, o) in enumerate(zip(inputs, shape.encoder)))


class Decoder(nn.Module):
    def __init__(self, shape):
        super().__init__()
        skips = [0, *reversed(shape.encoder[:-1])]
        inputs = [shape.encoder[-1], *shape.decoder]
        self.blocks = nn.ModuleList(Block(i + s, o, shape) for i, s, o in zip(inputs, skips, shape.decoder))


class Head(nn.Module):
    def __init__(self, shape):
        super().__init__()
        inputs = [shape.statistics * (shape.width + shape.colours), *shape.head]
        statistics = [shape.statistics, 1, 1, 1, 1]
        layers = zip(inputs, shape.head, statistics)
        self.layers = nn.ModuleList(Layer(i, o, shape, False, s) for i, o, s in layers)
        last = shape.head[-1] + shape.statistics * shape.colours
        self.weight = nn.Parameter(torch.empty(OUTPUTS, last, 3, 3))
        self.bias = nn.Parameter(torch.empty(OUTPUTS))


class Score(nn.Module):
    """How much a frame counts: a linear function of its features and of its alignment's confidence."""

    def __init__(self, channels):
        super().__init__()
        self.weight = nn.Parameter(torch.empty(channels))
        self.confidence = nn.Parameter(torch.empty(1))

    def forward(self, values, confidence):
        return torch.einsum("nchw,c->nhw", values, self.weight)[:, None] + self.confidence * confidence


class Attention(nn.Module):
    def __init__(self, shape):
        super().__init__()
        self.maps = Score(shape.width + shape.colours)
        setattr(self, "global", Score(shape.global_width))


def pool(kind, values, present, confidence, score):
    """Statistics over all frames of `values [N, C, H, W]`, one after the other; `present [N, 1, H, W]` says which take part."""
    # The paper's own way: invalid features never are the maximum.
    maximum = torch.where(present, values, -1e38).amax(0, keepdim=True)
    if kind == "max":
        return maximum
    if kind == "attention":
        share = torch.softmax(torch.where(present, score(values, confidence), -torch.inf), 0)
        return (share * values).sum(0, keepdim=True)
    share = present / present.sum(0)
    mean = (share * values).sum(0, keepdim=True)
    if kind == "mean":
        return mean
    variance = (share * (values - mean) ** 2).sum(0, keepdim=True)
    return torch.cat([maximum, mean, variance], 1)


def leaky(x):
    return F.leaky_relu(x, 0.2)


class SvbrdfNet(nn.Module):
    """The net. `dropout` and `output` of an architecture matter while training only."""

    def __init__(self, dropout=0.5, output=None, **shape):
        super().__init__()
        self.shape = shape = Shape(**shape)
        self.encoder, self.decoder, self.head = Encoder(shape), Decoder(shape), Head(shape)
        self.attention = Attention(shape) if shape.pooling == "attention" else None

    def features(self, frames):
        """Per-frame maps and global vectors of the U-Net."""
        maps, vector, levels = frames, None, []
        for number, level in enumerate(self.encoder.levels):
            maps, vector = level(maps if number == 0 else leaky(maps), vector, stride=2)
            levels.append(maps)
        sizes = [level.shape[2:] for level in levels[-2::-1]] + [frames.shape[2:]]
        skips = [None, *levels[-2::-1]]
        for block, skip, size in zip(self.decoder.blocks, skips, sizes):
            maps = maps if skip is None else torch.cat([maps, skip], 1)
            maps, vector = block(leaky(maps), vector, size)
        return maps, vector

    def forward(self, frames, flow, valid):
        """Maps `[1, 10, H, W]`: normal 3 in [−1, 1], diffuse 3, roughness 1, specular 3 in [0, 1], albedos in linear light.

        `frames [K + 1, 3, H, W]` gamma-encoded RGB in [0, 1], guidance first; `flow [K, 2, H, W]` (x, y) in pixels from the guidance
        frame into each key frame; `valid [K, 1, H, W]` in [0, 1].
        """
        return self.predict(frames, flow, valid)[1]

    def predict(self, frames, flow, valid):
        """The outputs before tanh, and the maps."""
        count, _, height, width = frames.shape
        flow = torch.where(valid >= self.shape.least_confidence, flow, torch.nan)
        # The guidance frame has the identity warp.
        flow = torch.cat([torch.zeros_like(flow[:1]), flow]) if count > 1 else torch.zeros(1, 2, height, width).to(frames)
        linear = frames**2.2 * 2 - 1
        if self.shape.fusion == "frames":
            values, mask = warp(linear, flow)
            linear = torch.cat([torch.where(mask, values, -1.0), mask.to(values)], 1)
        x = torch.linspace(-1, 1, width, dtype=frames.dtype, device=frames.device).expand(count, 1, height, width)
        y = torch.linspace(1, -1, height, dtype=frames.dtype, device=frames.device)[:, None].expand(count, 1, height, width)
        maps, vectors = self.features(torch.cat([linear, x, y], 1))
        if self.shape.colours:
            maps = torch.cat([maps, linear[:, :3], -linear[:, :3]], 1)
        # Where nothing is warped before the maximum, everything takes part, as surely as the guidance frame.
        present = torch.ones_like(maps[:, :1], dtype=torch.bool)
        confidence = torch.ones_like(maps[:, :1])
        if self.shape.fusion == "features":
            maps, present = warp(maps, flow)
            confidence = torch.where(present, torch.cat([confidence[:1], valid.to(maps)]), 0.0)
        # A frame that is nowhere seen takes no part.
        seen = present.any(dim=(1, 2, 3), keepdim=True)
        trust = confidence.mean(dim=(1, 2, 3), keepdim=True)
        score = {"maps": None, "global": None} if self.attention is None else dict(self.attention.named_children())
        pooled = pool(self.shape.pooling, maps, present, confidence, score["maps"])
        vector = pool(self.shape.pooling, vectors[:, :, None, None], seen, trust, score["global"])
        return self.decode(pooled, vector[:, :, 0, 0])

    def decode(self, pooled, vector):
        """The outputs before tanh and the maps, from pooled features."""
        x = leaky(pooled)
        for layer in self.head.layers:
            x, vector = layer(x, vector)
            x = leaky(x)
        colours = pooled.unflatten(1, (self.shape.statistics, -1))[:, :, self.shape.width :].flatten(1, 2)
        x = torch.cat([x, colours], 1)
        x = F.conv2d(F.pad(x, (1, 1, 1, 1), mode="replicate"), self.head.weight, self.head.bias)
        outputs = torch.tanh(x)
        normal = F.normalize(torch.cat([3 * outputs[:, :2], torch.ones_like(outputs[:, :1])], 1), dim=1)
        return x, torch.cat([normal, (outputs[:, 2:] + 1) / 2], 1)


def warp(x, flow):
    """Bilinear samples at target pixel + flow, and where all four taps lie inside."""
    height, width = x.shape[2:]
    px = flow[:, 0] + torch.arange(width, dtype=x.dtype, device=x.device)
    py = flow[:, 1] + torch.arange(height, dtype=x.dtype, device=x.device)[:, None]
    inside = (px >= 0) & (px <= width - 1) & (py >= 0) & (py <= height - 1)
    grid = torch.stack([px * 2 / (width - 1) - 1, py * 2 / (height - 1) - 1], 3)
    grid = torch.where(inside[..., None], grid, 0.0)
    return F.grid_sample(x, grid, mode="bilinear", align_corners=True), inside[:, None]
