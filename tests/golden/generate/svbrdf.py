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

    def __init__(self, width=64, levels=8, normalisation="weight", fusion="features", pixel_features="none", filter_gain=1.0):
        self.width, self.levels = width, levels
        self.normalisation, self.fusion, self.pixel_features = normalisation, fusion, pixel_features
        self.filter_gain = filter_gain
        self.inputs = 6 if fusion == "frames" else 5
        self.encoder = [width * f for f in ENCODER[:levels]]
        self.decoder = [width * f for f in DECODER[8 - levels :]]
        # The paper has one width only; narrower nets scale the head but keep it at 16 or their own width.
        self.head = [max(h * width // 64, min(16, width)) for h in HEAD]
        self.global_width = 2 * width
        self.colours = 6 if pixel_features == "extremes" else 0

    def architecture(self):
        names = ["width", "levels", "normalisation", "fusion", "pixel_features", "filter_gain"]
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

    def __init__(self, channels, shape, first, generator):
        super().__init__()
        inputs = channels if first else channels + shape.global_width
        self.weight = golden.normal([inputs, shape.global_width], inputs**-0.5, generator)
        self.bias = golden.normal([shape.global_width], 0.1, generator)
        # Stronger than the paper's 0.01, so that an error here can't hide.
        injection = golden.normal([shape.global_width, channels], 0.3 * shape.global_width**-0.5, generator)
        self.injection = None if first else injection

    def forward(self, maps, means, previous):
        if previous is None:
            return maps, F.selu(means @ self.weight + self.bias)
        following = F.selu(torch.cat([means, previous], 1) @ self.weight + self.bias)
        return maps + (previous @ self.injection)[:, :, None, None], following


class Layer(nn.Module):
    """A convolution with its part of the global track."""

    def __init__(self, inputs, outputs, shape, first, generator):
        super().__init__()
        self.convolution = Convolution(inputs, outputs, shape, generator)
        setattr(self, "global", GlobalTrack(outputs, shape, first, generator))

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
        inputs = [shape.width + shape.colours, *shape.head]
        self.layers = nn.ModuleList(Layer(i, o, shape, False, generator) for i, o in zip(inputs, shape.head))
        last = shape.head[-1] + shape.colours
        # Not the initial 0.02·Xavier: the outputs shall reach tanh's curved part.
        self.weight = golden.normal([OUTPUTS, last, 3, 3], 1.5 * (9 * last) ** -0.5, generator)
        self.bias = golden.normal([OUTPUTS], 0.3, generator)


def leaky(x):
    return F.leaky_relu(x, 0.2)


class SvbrdfNet(nn.Module):
    def __init__(self, shape, seed):
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        self.shape = shape
        self.encoder, self.decoder, self.head = Encoder(shape, generator), Decoder(shape, generator), Head(shape, generator)

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
        flow = torch.where(valid > 0.5, flow, torch.nan)
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
        if self.shape.fusion == "features":
            values, mask = warp(maps, flow)
            # The paper's own way: invalid features never are the maximum, and a frame that is nowhere seen takes no part.
            maps = torch.where(mask, values, -1e38)
            vectors = vectors[mask.flatten(1).any(1)]
        return self.decode(maps.amax(0, keepdim=True), vectors.amax(0, keepdim=True))

    def decode(self, pooled, vector):
        """The bounded outputs and the maps: normal 3, diffuse 3, roughness 1, specular 3."""
        x = leaky(pooled)
        for layer in self.head.layers:
            x, vector = layer(x, vector)
            x = leaky(x)
        x = torch.cat([x, pooled[:, self.shape.width :]], 1)
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
    valid = (torch.rand((keys, 1, height, width), generator=generator) > 0.15).to(torch.uint8)
    if unseen:
        valid[-1] = 0
    return net, pictures, flow, valid


def make_case(name, shape, size, keys=3, seed=1, precision="f16", unseen=False):
    """Writes one folder: weights, inputs, outputs and the gradients of Σ ±maps."""
    net, pictures, flow, valid = draw(shape, size, keys, seed, precision, unseen)
    logits, maps = net(golden.decoded(pictures), flow, valid)
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
