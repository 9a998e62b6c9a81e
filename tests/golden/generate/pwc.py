"""PWC-Net in PyTorch, written from Sun et al. 2018 as the paper's authors vary it (no dense connections, bilinear upsampling),
and with both.

Parameters carry the names and layouts of the weights' files. The learning aids of the small net are no part of the paper; they
follow the documentation of `flow::pwc::PwcConfig`.
"""

import torch
import torch.nn.functional as F
from torch import nn

import golden
import losses

UNIT_PX = 20.0
DILATIONS = [1, 2, 4, 8, 16, 1, 1]


class Shape:
    """A net's configuration; what isn't given is the paper's. `unusual` keys stand in the manifest only where they are given, so
    that the other nets' are those of the time before these keys."""

    def __init__(self, channels=None, convs_per_level=3, estimator=None, context=None, radius=4, aids=False, **unusual):
        self.channels = channels or [16, 32, 64, 96, 128, 192]
        self.convs_per_level, self.radius, self.aids = convs_per_level, radius, aids
        self.estimator = estimator or [128, 128, 96, 64, 32]
        self.context = [128, 128, 128, 96, 64, 32] if context is None else context
        self.unusual = unusual
        self.dense = unusual.get("connections") == "dense"
        self.deconvolution = unusual.get("upsampling") == "deconvolution"

    def architecture(self):
        names = ["channels", "convs_per_level", "estimator", "context", "radius"]
        shape = {name: getattr(self, name) for name in names}
        contrast = {"input": "local-contrast" if self.aids else "plain"}
        return shape | contrast | {"feature_normalisation": self.aids, "match_head": self.aids} | self.unusual


class Conv(nn.Module):
    """3×3 with bias and zero padding; leaky ReLU unless it predicts."""

    def __init__(self, inputs, outputs, generator, stride=1, dilation=1, deviation=None):
        super().__init__()
        self.weight = golden.normal([outputs, inputs, 3, 3], deviation or (2 / (1.01 * 9 * inputs)) ** 0.5, generator)
        self.bias = golden.normal([outputs], 0.05, generator)
        self.stride, self.dilation = stride, dilation

    def linear(self, x):
        return F.conv2d(x, self.weight, self.bias, self.stride, self.dilation, self.dilation)

    def forward(self, x):
        return F.leaky_relu(self.linear(x), 0.1)


def prediction(inputs, generator):
    """Strong enough that the flow moves features by more than a pixel, which an untrained net's wouldn't."""
    return Conv(inputs, 2, generator, deviation=0.8 * (9 * inputs) ** -0.5)


class Level(nn.Module):
    def __init__(self, inputs, outputs, convs, generator):
        super().__init__()
        layers = [Conv(inputs, outputs, generator, stride=2)]
        layers += [Conv(outputs, outputs, generator) for _ in range(convs - 1)]
        self.convs = nn.ModuleList(layers)


class Pyramid(nn.Module):
    def __init__(self, shape, generator):
        super().__init__()
        pairs = zip([3, *shape.channels], shape.channels)
        self.levels = nn.ModuleList(Level(i, o, shape.convs_per_level, generator) for i, o in pairs)

    def forward(self, x):
        found = []
        for level in self.levels:
            for conv in level.convs:
                x = conv(x)
            found.append(x)
        return found


class Estimator(nn.Module):
    def __init__(self, inputs, widths, dense, generator):
        super().__init__()
        seen = [inputs + sum(widths[:n]) for n in range(len(widths) + 1)] if dense else [inputs, *widths]
        self.dense, self.outputs = dense, seen[-1]
        self.convs = nn.ModuleList(Conv(i, o, generator) for i, o in zip(seen, widths))
        self.predict = prediction(self.outputs, generator)

    def forward(self, x):
        for conv in self.convs:
            x = torch.cat([conv(x), x], 1) if self.dense else conv(x)
        return self.predict.linear(x), x


class Deconvolution(nn.Module):
    """To twice the size and two channels."""

    def __init__(self, inputs, generator):
        super().__init__()
        self.weight = golden.normal([inputs, 2, 4, 4], (4 * inputs) ** -0.5, generator)
        self.bias = golden.normal([2], 0.05, generator)

    def forward(self, x):
        return F.conv_transpose2d(x, self.weight, self.bias, stride=2, padding=1)


class Upsampler(nn.Module):
    def __init__(self, inputs, generator):
        super().__init__()
        self.flow, self.features = Deconvolution(2, generator), Deconvolution(inputs, generator)


class Context(nn.Module):
    def __init__(self, inputs, widths, generator):
        super().__init__()
        layers = zip([inputs, *widths], widths, DILATIONS)
        self.convs = nn.ModuleList(Conv(i, o, generator, dilation=d) for i, o, d in layers)
        self.predict = prediction(widths[-1], generator)

    def forward(self, x):
        for conv in self.convs:
            x = conv(x)
        return self.predict.linear(x)


class Matching(nn.Module):
    """The sharpness of the soft-argmax, a learning aid; without it the cost volume has no weights.

    Lower than the 12 it starts at in training, where single precision is too coarse for the tolerance.
    """

    def __init__(self, aids):
        super().__init__()
        self.sharpness = nn.Parameter(torch.tensor([3.0], dtype=torch.float64)) if aids else None


class Pwc(nn.Module):
    def __init__(self, shape, seed):
        super().__init__()
        generator = torch.Generator().manual_seed(seed)
        self.shape = shape
        self.pyramid = Pyramid(shape, generator)
        cost, upsampled = (2 * shape.radius + 1) ** 2, 2 + (2 if shape.deconvolution else shape.estimator[-1])
        inputs = [cost + c + (upsampled if n > 0 else 0) for n, c in enumerate(reversed(shape.channels[1:]))]
        self.matchings = nn.ModuleList(Matching(shape.aids) for _ in inputs)
        self.estimators = nn.ModuleList(Estimator(i, shape.estimator, shape.dense, generator) for i in inputs)
        learned = self.estimators[:-1] if shape.deconvolution else []
        self.upsamplers = nn.ModuleList(Upsampler(estimator.outputs, generator) for estimator in learned)
        seen = self.estimators[-1].outputs + (0 if shape.dense else 2)
        self.context = Context(seen, shape.context, generator) if shape.context else None

    def forward(self, first, second):
        """Per level, coarse to fine: flow in units of 20 px, logits over displacements, flow that it started from, factor."""
        height, width = first.shape[2:]
        multiple = 2 ** len(self.shape.channels)
        padding = (0, -width % multiple, 0, -height % multiple)
        images = F.pad(torch.cat([first, second]), padding, mode="replicate")
        images = local_contrast(images) if self.shape.aids else images
        levels, flow, features = [], None, None
        for index, maps in enumerate(self.pyramid(images)[:0:-1]):
            factor = 2 ** (len(self.shape.channels) - index)
            near, _ = maps.chunk(2)
            matched, other = (normalised(maps) if self.shape.aids else maps).chunk(2)
            start = None
            if flow is not None:
                if self.shape.deconvolution:
                    upsampler = self.upsamplers[index - 1]
                    start, features = upsampler.flow(flow), upsampler.features(features)
                else:
                    start, features = enlarge(flow, 2), enlarge(features, 2)
                other = warp(other, start * UNIT_PX / factor)
            cost = cost_volume(matched, other, self.shape.radius)
            inputs = [F.leaky_relu(cost, 0.1), near] + ([start, features] if start is not None else [])
            flow, features = self.estimators[index](torch.cat(inputs, 1))
            sharpness = self.matchings[index].sharpness
            logits = cost * (12.0 if sharpness is None else sharpness)
            if self.shape.aids:
                flow = flow + soft_argmax(logits, self.shape.radius) * factor / UNIT_PX
            if start is not None:
                flow = flow + start
            if self.context is not None and index == len(self.estimators) - 1:
                flow = flow + self.context(features if self.shape.dense else torch.cat([features, flow], 1))
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
    px = flow[:, 0] + torch.arange(width, dtype=torch.float64)
    py = flow[:, 1] + torch.arange(height, dtype=torch.float64)[:, None]
    inside = (px >= 0) & (px <= width - 1) & (py >= 0) & (py <= height - 1)
    grid = torch.stack([px * 2 / (width - 1) - 1, py * 2 / (height - 1) - 1], 3)
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
    side = torch.arange(-radius, radius + 1, dtype=torch.float64)
    y, x = torch.meshgrid(side, side, indexing="ij")
    probability = logits.softmax(1)
    return torch.stack([(probability * d.reshape(1, -1, 1, 1)).sum(1) for d in (x, y)], 1)


def local_contrast(images):
    """Deviation from the local mean over the local deviation, windows of 17 px with repeated borders, limited to ±3."""
    mean = lambda x: F.avg_pool2d(F.pad(x, (8, 8, 8, 8), mode="replicate"), 17, stride=1)
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


def make_case(name, net, size, batch, seed, largest_px, errors=("euclidean", "robust"), rename=str):
    """Writes one folder: weights, inputs, flows and, for each loss, its terms and all gradients."""
    golden.round_weights(net, "f16")
    generator = torch.Generator().manual_seed(seed + 1000)
    height, width = size
    pictures = golden.textures(2 * batch, height, width, generator)
    direction = torch.rand((batch, 2, 1, 1), generator=generator, dtype=torch.float64) * 2 - 1
    wave = torch.sin(torch.arange(width, dtype=torch.float64) * 0.1) + torch.cos(torch.arange(height, dtype=torch.float64) * 0.07)[:, None]
    target = (direction * largest_px * (1 + 0.3 * wave)).to(torch.float32).to(torch.float64)
    valid = (torch.rand((batch, 1, height, width), generator=generator) > 0.3).to(torch.uint8)
    valid[:, :, : height // 3, : width // 4] = 0
    case = {"images": pictures.numpy(), "target": golden.single(target), "valid": valid.numpy()}
    first, second = golden.decoded(pictures).chunk(2)
    for error in errors:
        levels = net(first, second)
        terms = losses.flow_terms([(flow, factor) for flow, _, _, factor in levels], target, valid.to(target), error)
        if net.shape.aids:
            terms.append(sum(losses.matching_term(*level, target, valid.to(target)) for level in levels))
        sum(terms).backward()
        case[f"terms.{error}"] = golden.single(torch.stack(terms))
        case |= golden.gradients(net, error, rename)
    for index, (flow, _, _, factor) in enumerate(levels):
        case[f"level.{index}"] = golden.single(flow)
    case["flow"] = golden.single(net.full(levels, height, width))
    folder = golden.FOLDER / "flow" / name
    golden.write_net(folder, "adjacent", "pwc", net.shape.architecture(), net, "f16", rename)
    golden.write(folder / "case.safetensors", case)
    starts = [f"{(start * UNIT_PX / factor).abs().max():.1f}" for _, _, start, factor in levels if start is not None]
    print(f"flow/{name}: {sum(p.numel() for p in net.parameters())} parameters, largest warps {', '.join(starts)} px of the level")


def count():
    return {"pwc": sum(p.numel() for p in Pwc(Shape(), 0).parameters())}


def main():
    # The paper's net at an eighth of its width: all six levels, all dilations.
    eighth = Shape([2, 4, 8, 12, 16, 24], estimator=[16, 16, 12, 8, 4], context=[16, 16, 16, 12, 8, 4])
    make_case("paper-eighth", Pwc(eighth, 1), (66, 70), 1, 1, 6.0, ["euclidean"])
    four = Shape([4, 6, 8, 8], estimator=[10, 8], context=[8, 8, 6, 6, 4, 4], radius=3)
    make_case("four-levels", Pwc(four, 2), (32, 48), 2, 2, 4.0)
    small = Shape([4, 6, 8], 2, estimator=[8, 6], context=[], radius=3, aids=True)
    make_case("learning-aids", Pwc(small, 3), (24, 40), 2, 3, 4.0)
    both = {"connections": "dense", "upsampling": "deconvolution"}
    dense = Shape([4, 6, 8, 8], estimator=[8, 6, 4], context=[8, 6, 4], radius=2, **both)
    make_case("dense-residual", Pwc(dense, 4), (35, 46), 2, 4, 4.0)
