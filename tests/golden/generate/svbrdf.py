"""The SVBRDF net in PyTorch, written from the paper (§6, Eq. 5) and Deschaintre et al. 2019 instead of translated from Rust.

Parameters carry the names and layouts of the weights' files, so that the twin's `state_dict` is such a file.
"""

import torch
import torch.nn.functional as F
from torch import nn

import golden

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

    def architecture(self):
        names = ["width", "levels", "normalisation", "fusion", "pixel_features", "filter_gain"]
        # The maximum is the default, as in configs that were written before there was a choice.
        names += ["pooling"] if self.pooling != "max" else []
        return {name: getattr(self, name) for name in names}


class Affine(nn.Module):
    def __init__(self, channels, generator):
        super().__init__()
        self.scale = golden.normal([channels], 0.2, generator)
        self.offset = golden.normal([channels], 0.2, generator)
        with torch.no_grad():
            self.scale += 1


class Convolution(nn.Module):
    """3×3, edge padding, no bias, normalised."""

    def __init__(self, inputs, outputs, shape, generator):
        super().__init__()
        self.weight = golden.normal([outputs, inputs, 3, 3], 0.02, generator)
        self.gain = shape.filter_gain
        self.affine = Affine(outputs, generator) if shape.normalisation == "instance" else None

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

    def __init__(self, channels, shape, first, generator, statistics=1):
        super().__init__()
        previous = statistics * shape.global_width
        inputs = channels if first else channels + previous
        self.weight = golden.normal([inputs, shape.global_width], inputs**-0.5, generator)
        self.bias = golden.normal([shape.global_width], 0.1, generator)
        # Stronger than the paper's 0.01, so that an error here can't hide.
        injection = golden.normal([previous, channels], 0.3 * previous**-0.5, generator)
        self.injection = None if first else injection

    def forward(self, maps, means, previous):
        if previous is None:
            return maps, F.selu(means @ self.weight + self.bias)
        following = F.selu(torch.cat([means, previous], 1) @ self.weight + self.bias)
        return maps + (previous @ self.injection)[:, :, None, None], following


class Layer(nn.Module):
    """A convolution with its part of the global track."""

    def __init__(self, inputs, outputs, shape, first, generator, statistics=1):
        super().__init__()
        self.convolution = Convolution(inputs, outputs, shape, generator)
        setattr(self, "global", GlobalTrack(outputs, shape, first, generator, statistics))

    def forward(self, x, previous, stride=1):
        return getattr(self, "global")(*self.convolution(x, stride), previous)


class Block(nn.Module):
    """Nearest ×2 and two convolutions, the second with the global track."""

    def __init__(self, inputs, outputs, shape, generator):
        super().__init__()
        self.enlarged = Convolution(inputs, outputs, shape, generator)
        self.refined = Convolution(outputs, outputs, shape, generator)
        setattr(self, "global", GlobalTrack(outputs, shape, False, generator))

    def forward(self, x, previous, size):
        # An odd level is one pixel smaller than twice the next one.
        x = F.interpolate(x, scale_factor=2, mode="nearest")[..., : size[0], : size[1]]
        x = self.refined(leaky(self.enlarged(x)[0]))
        return getattr(self, "global")(*x, previous)


class Encoder(nn.Module):
    def __init__(self, shape, generator):
        super().__init__()
        inputs = [shape.inputs, *shape.encoder]
        self.levels = nn.ModuleList(Layer(i, o, shape, n == 0, generator) for n, (i, o) in enumerate(zip(inputs, shape.encoder)))


class Decoder(nn.Module):
    def __init__(self, shape, generator):
        super().__init__()
        skips = [0, *reversed(shape.encoder[:-1])]
        inputs = [shape.encoder[-1], *shape.decoder]
        self.blocks = nn.ModuleList(Block(i + s, o, shape, generator) for i, s, o in zip(inputs, skips, shape.decoder))


class Head(nn.Module):
    def __init__(self, shape, generator):
        super().__init__()
        inputs = [shape.statistics * (shape.width + shape.colours), *shape.head]
        statistics = [shape.statistics, 1, 1, 1, 1]
        layers = zip(inputs, shape.head, statistics)
        self.layers = nn.ModuleList(Layer(i, o, shape, False, generator, s) for i, o, s in layers)
        last = shape.head[-1] + shape.statistics * shape.colours
        # Not the initial 0.02·Xavier: the outputs shall reach tanh's curved part.
        self.weight = golden.normal([OUTPUTS, last, 3, 3], 1.5 * (9 * last) ** -0.5, generator)
        self.bias = golden.normal([OUTPUTS], 0.3, generator)


class Score(nn.Module):
    """How much a frame counts: a linear function of its features and of its alignment's confidence."""

    def __init__(self, channels, generator):
        super().__init__()
        self.weight = golden.normal([channels], channels**-0.5, generator)
        self.confidence = golden.normal([1], 2.0, generator)

    def forward(self, values, confidence):
        return torch.einsum("nchw,c->nhw", values, self.weight)[:, None] + self.confidence * confidence


class Attention(nn.Module):
    def __init__(self, shape, generator):
        super().__init__()
        self.maps = Score(shape.width + shape.colours, generator)
        setattr(self, "global", Score(shape.global_width, generator))


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
    def __init__(self, shape, seed):
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        self.shape = shape
        self.encoder, self.decoder, self.head = Encoder(shape, generator), Decoder(shape, generator), Head(shape, generator)
        self.attention = Attention(shape, generator) if shape.pooling == "attention" else None

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
        """`frames [K + 1, 3, H, W]` gamma-encoded, guidance first; `flow [K, 2, H, W]` backward, NaN where invalid; `valid [K, 1, H, W]`."""
        count, _, height, width = frames.shape
        flow = torch.where(valid > 0, flow, torch.nan)
        # The guidance frame has the identity warp.
        flow = torch.cat([torch.zeros_like(flow[:1]), flow]) if count > 1 else torch.zeros(1, 2, height, width).to(frames)
        linear = frames**2.2 * 2 - 1
        if self.shape.fusion == "frames":
            values, mask = warp(linear, flow)
            linear = torch.cat([torch.where(mask, values, -1.0), mask.to(values)], 1)
        x = torch.linspace(-1, 1, width, dtype=torch.float64).expand(count, 1, height, width)
        y = torch.linspace(1, -1, height, dtype=torch.float64)[:, None].expand(count, 1, height, width)
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
        """The bounded outputs and the maps: normal 3, diffuse 3, roughness 1, specular 3."""
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
    px = flow[:, 0] + torch.arange(width, dtype=torch.float64)
    py = flow[:, 1] + torch.arange(height, dtype=torch.float64)[:, None]
    inside = (px >= 0) & (px <= width - 1) & (py >= 0) & (py <= height - 1)
    grid = torch.stack([px * 2 / (width - 1) - 1, py * 2 / (height - 1) - 1], 3)
    grid = torch.where(inside[..., None], grid, 0.0)
    return F.grid_sample(x, grid, mode="bilinear", align_corners=True), inside[:, None]


def flows(count, height, width, generator):
    """A different smooth warp per key frame, rounded to what the file holds; a corner has no flow at all."""
    x = torch.arange(width, dtype=torch.float64).expand(height, width)
    y = torch.arange(height, dtype=torch.float64)[:, None].expand(height, width)
    made = [torch.empty(0, 2, height, width, dtype=torch.float64)]
    for _ in range(count):
        a, b, c, d = ((torch.rand(4, generator=generator, dtype=torch.float64) - 0.5) * 0.2).tolist()
        shift = (torch.rand(2, generator=generator, dtype=torch.float64) - 0.5) * torch.tensor([width, height]) * 0.5
        made.append(torch.stack([a * x + b * y + shift[0], c * x + d * y + shift[1]])[None])
    made = torch.cat(made)
    made[:1, :, :3, :5] = torch.nan
    return made.to(torch.float32).to(torch.float64)


def draw(shape, size, keys, seed, precision, unseen):
    """A net of random weights and what it reads: pictures, flow, valid pixels."""
    net = SvbrdfNet(shape, seed)
    golden.round_weights(net, precision)
    generator = torch.Generator().manual_seed(seed + 1000)
    height, width = size
    pictures = golden.textures(keys + 1, height, width, generator)
    flow = flows(keys, height, width, generator)
    confidence = torch.rand((keys, 1, height, width), generator=generator)
    # Only attention tells confidences apart; the others' masks hold 0 and 1.
    sure = (confidence * 255).round() if shape.pooling == "attention" else 1
    valid = ((confidence > 0.15) * sure).to(torch.uint8)
    if unseen:
        valid[-1] = 0
    return net, pictures, flow, valid


def make_case(name, shape, size, keys=3, seed=1, precision="f16", unseen=False):
    """Writes one folder: weights, inputs, outputs and the gradients of Σ ±maps."""
    net, pictures, flow, valid = draw(shape, size, keys, seed, precision, unseen)
    logits, maps = net(golden.decoded(pictures), flow, golden.decoded(valid) if shape.pooling == "attention" else valid)
    golden.signed_sum(maps).backward()
    folder = golden.FOLDER / "svbrdf" / name
    golden.write_net(folder, "svbrdf", "svbrdf", shape.architecture(), net, precision)
    case = {"frames": pictures.numpy(), "flow": golden.single(flow), "valid": valid.numpy()}
    case |= {"maps": golden.single(maps)} | golden.gradients(net)
    golden.write(folder / "case.safetensors", case)
    print(f"svbrdf/{name}: {sum(p.numel() for p in net.parameters())} parameters, logits {logits.min():.2f} to {logits.max():.2f}")


def count():
    """Parameters at the paper's width: convolutions, and the global track."""
    # Parameters without memory: 41 M random numbers aren't needed to count them.
    normal, golden.normal = golden.normal, lambda shape, *_: nn.Parameter(torch.empty(shape, device="meta"))
    try:
        net = SvbrdfNet(Shape(), 0)
    finally:
        golden.normal = normal
    weights = [p for p in net.parameters() if p.dim() == 4]
    rest = [p for p in net.parameters() if p.dim() != 4 and p is not net.head.bias]
    return {"svbrdf_convolutions": sum(p.numel() for p in weights), "svbrdf_global_track": sum(p.numel() for p in rest)}


# The paper's net, small. Adam's twin trains it.
PAPER = {"shape": Shape(width=8, levels=3), "size": (24, 32), "keys": 3, "seed": 1, "precision": "f32", "unseen": True}


def main():
    make_case("paper", **PAPER)
    make_case("eight-levels", Shape(width=4), (32, 32), keys=1, seed=2)
    make_case("odd-size", Shape(width=4, levels=4), (21, 30), seed=3)
    make_case("instance-norm", Shape(width=4, levels=3, normalisation="instance"), (16, 24), seed=4)
    make_case("frame-warping", Shape(width=4, levels=3, fusion="frames"), (16, 24), seed=5)
    make_case("no-warp", Shape(width=4, levels=3, fusion="none"), (16, 24), seed=6)
    make_case("single-frame", Shape(width=4, levels=3), (16, 24), keys=0, seed=7)
    make_case("extremes", Shape(width=4, levels=3, pixel_features="extremes", filter_gain=2**0.5), (16, 24), seed=8)
    make_case("mean", Shape(width=4, levels=3, pooling="mean"), (16, 24), seed=9, unseen=True)
    everything = Shape(width=4, levels=3, pixel_features="extremes", pooling="max-mean-variance")
    make_case("max-mean-variance", everything, (16, 24), seed=10, unseen=True)
    make_case("attention", Shape(width=4, levels=3, pooling="attention"), (16, 24), seed=11, unseen=True)
