"""Cases of the SVBRDF net: random weights, frames and warps, maps and gradients (the net is python/svbrdf.py)."""

import torch

import golden
from svbrdf import SvbrdfNet

WIDTH, LEVELS = 64, 8


def shape(width=WIDTH, levels=LEVELS, normalisation="weight", fusion="features", pixel_features="none", filter_gain=1.0, **pooling):
    """An architecture as manifests hold it. The pooling stands there only where it is given, as in configs that were written before
    there was a choice."""
    widths = {"width": width, "levels": levels, "normalisation": normalisation, "fusion": fusion}
    return widths | {"pixel_features": pixel_features, "filter_gain": filter_gain} | pooling


def drawn(architecture, seed):
    """A net of random weights, strong enough that no part of it can be wrong unseen."""
    net, generator = SvbrdfNet(**architecture), torch.Generator().manual_seed(seed)

    def draw(parameter, deviation, mean=0.0):
        parameter.data = golden.normal(parameter.shape, deviation, generator).data + mean

    def convolution(part):
        draw(part.weight, 0.02)
        if part.affine is not None:
            draw(part.affine.scale, 0.2, 1.0)
            draw(part.affine.offset, 0.2)

    def global_track(part, channels):
        draw(part.weight, part.weight.shape[0] ** -0.5)
        draw(part.bias, 0.1)
        if part.injection is None:
            # The first layer has none; drawn all the same, so that the numbers of the others stay what they were.
            golden.normal([net.shape.global_width, channels], 1.0, generator)
        else:
            # Stronger than the paper's 0.01, so that an error here can't hide.
            draw(part.injection, 0.3 * part.injection.shape[0] ** -0.5)

    def layer(part):
        convolution(part.convolution)
        global_track(getattr(part, "global"), part.convolution.weight.shape[0])

    for level in net.encoder.levels:
        layer(level)
    for block in net.decoder.blocks:
        convolution(block.enlarged)
        convolution(block.refined)
        global_track(getattr(block, "global"), block.refined.weight.shape[0])
    for level in net.head.layers:
        layer(level)
    # Not the initial 0.02·Xavier: the outputs shall reach tanh's curved part.
    draw(net.head.weight, 1.5 * net.head.weight[0].numel() ** -0.5)
    draw(net.head.bias, 0.3)
    if net.attention is not None:
        for _, score in net.attention.named_children():
            draw(score.weight, score.weight.numel() ** -0.5)
            draw(score.confidence, 2.0)
    return net


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


def draw(architecture, size, keys, seed, precision, unseen):
    """A net of random weights and what it reads: pictures, flow, valid pixels."""
    net = drawn(architecture, seed)
    golden.round_weights(net, precision)
    generator = torch.Generator().manual_seed(seed + 1000)
    height, width = size
    pictures = golden.textures(keys + 1, height, width, generator)
    flow = flows(keys, height, width, generator)
    confidence = torch.rand((keys, 1, height, width), generator=generator)
    # Only attention tells confidences apart; the others' masks hold 0 and 1.
    sure = (confidence * 255).round() if architecture.get("pooling") == "attention" else 1
    valid = ((confidence > 0.15) * sure).to(torch.uint8)
    if unseen:
        valid[-1] = 0
    return net, pictures, flow, valid


def make_case(name, architecture, size, keys=3, seed=1, precision="f16", unseen=False):
    """Writes one folder: weights, inputs, outputs and the gradients of Σ ±maps."""
    net, pictures, flow, valid = draw(architecture, size, keys, seed, precision, unseen)
    logits, maps = net.predict(golden.decoded(pictures), flow, golden.decoded(valid) if architecture.get("pooling") == "attention" else valid)
    golden.signed_sum(maps).backward()
    folder = golden.FOLDER / "svbrdf" / name
    golden.write_net(folder, "svbrdf", "svbrdf", architecture, net, precision)
    case = {"frames": pictures.numpy(), "flow": golden.single(flow), "valid": valid.numpy()}
    case |= {"maps": golden.single(maps)} | golden.gradients(net)
    golden.write(folder / "case.safetensors", case)
    print(f"svbrdf/{name}: {sum(p.numel() for p in net.parameters())} parameters, logits {logits.min():.2f} to {logits.max():.2f}")


def count():
    """Parameters at the paper's width: convolutions, and the global track."""
    # Parameters without memory: 41 M numbers aren't needed to count them.
    with torch.device("meta"):
        net = SvbrdfNet()
    weights = [p for p in net.parameters() if p.dim() == 4]
    rest = [p for p in net.parameters() if p.dim() != 4 and p is not net.head.bias]
    return {"svbrdf_convolutions": sum(p.numel() for p in weights), "svbrdf_global_track": sum(p.numel() for p in rest)}


# The paper's net, small. Adam's twin trains it.
PAPER = {"architecture": shape(width=8, levels=3), "size": (24, 32), "keys": 3, "seed": 1, "precision": "f32", "unseen": True}


def main():
    make_case("paper", **PAPER)
    make_case("eight-levels", shape(width=4), (32, 32), keys=1, seed=2)
    make_case("odd-size", shape(width=4, levels=4), (21, 30), seed=3)
    make_case("instance-norm", shape(width=4, levels=3, normalisation="instance"), (16, 24), seed=4)
    make_case("frame-warping", shape(width=4, levels=3, fusion="frames"), (16, 24), seed=5)
    make_case("no-warp", shape(width=4, levels=3, fusion="none"), (16, 24), seed=6)
    make_case("single-frame", shape(width=4, levels=3), (16, 24), keys=0, seed=7)
    make_case("extremes", shape(width=4, levels=3, pixel_features="extremes", filter_gain=2**0.5), (16, 24), seed=8)
    make_case("mean", shape(width=4, levels=3, pooling="mean"), (16, 24), seed=9, unseen=True)
    everything = shape(width=4, levels=3, pixel_features="extremes", pooling="max-mean-variance")
    make_case("max-mean-variance", everything, (16, 24), seed=10, unseen=True)
    make_case("attention", shape(width=4, levels=3, pooling="attention"), (16, 24), seed=11, unseen=True)
