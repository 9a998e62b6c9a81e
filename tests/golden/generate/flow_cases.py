"""Cases of PWC-Net: random weights, pairs of pictures, flows, losses and gradients (the net is python/pwc.py)."""

import torch

import golden
import losses
from pwc import UNIT_PX, Pwc

# What the learning aids of the small net are called in an architecture.
AIDS = {"input": "local-contrast", "feature_normalisation": True, "match_head": True}
NO_AIDS = {"input": "plain", "feature_normalisation": False, "match_head": False}


def shape(channels, convs_per_level=3, estimator=(128, 128, 96, 64, 32), context=(), radius=4, aids=NO_AIDS, **unusual):
    """An architecture as manifests hold it. `unusual` keys stand there only where they are given, so that the other nets' are those
    of the time before these keys."""
    widths = {"channels": channels, "convs_per_level": convs_per_level, "estimator": list(estimator), "context": list(context)}
    return widths | {"radius": radius} | aids | unusual


def drawn(architecture, seed):
    """A net of random weights whose flow moves features by more than a pixel, which an untrained net's wouldn't."""
    net, generator = Pwc(**architecture), torch.Generator().manual_seed(seed)
    for name, parameter in net.named_parameters():
        if name.endswith("sharpness"):
            # Lower than the 12 it starts at in training, where single precision is too coarse for the tolerance.
            parameter.data = torch.tensor([3.0], dtype=torch.float64)
            continue
        if name.endswith("bias"):
            deviation = 0.05
        elif name.startswith("upsamplers"):
            # [inputs, 2, 4, 4], of which 2×2 taps reach an output.
            deviation = (4 * parameter.shape[0]) ** -0.5
        elif "predict" in name:
            deviation = 0.8 * parameter[0].numel() ** -0.5
        else:
            deviation = (2 / (1.01 * parameter[0].numel())) ** 0.5
        parameter.data = golden.normal(parameter.shape, deviation, generator).data
    return net


def make_case(name, net, architecture, size, batch, seed, largest_px, errors=("euclidean", "robust"), rename=str):
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
        levels = net.levels(first, second)
        terms = losses.flow_terms([(flow, factor) for flow, _, _, factor in levels], target, valid.to(target), error)
        if architecture["match_head"]:
            terms.append(sum(losses.matching_term(*level, target, valid.to(target)) for level in levels))
        sum(terms).backward()
        case[f"terms.{error}"] = golden.single(torch.stack(terms))
        case |= golden.gradients(net, error, rename)
    for index, (flow, _, _, factor) in enumerate(levels):
        case[f"level.{index}"] = golden.single(flow)
    case["flow"] = golden.single(net.full(levels, height, width))
    folder = golden.FOLDER / "flow" / name
    golden.write_net(folder, "adjacent", "pwc", architecture, net, "f16", rename)
    golden.write(folder / "case.safetensors", case)
    starts = [f"{(start * UNIT_PX / factor).abs().max():.1f}" for _, _, start, factor in levels if start is not None]
    print(f"flow/{name}: {sum(p.numel() for p in net.parameters())} parameters, largest warps {', '.join(starts)} px of the level")


def count():
    return {"pwc": sum(p.numel() for p in Pwc().parameters())}


def main():
    # The paper's net at an eighth of its width: all six levels, all dilations.
    eighth = shape([2, 4, 8, 12, 16, 24], estimator=[16, 16, 12, 8, 4], context=[16, 16, 16, 12, 8, 4])
    make_case("paper-eighth", drawn(eighth, 1), eighth, (66, 70), 1, 1, 6.0, ["euclidean"])
    four = shape([4, 6, 8, 8], estimator=[10, 8], context=[8, 8, 6, 6, 4, 4], radius=3)
    make_case("four-levels", drawn(four, 2), four, (32, 48), 2, 2, 4.0)
    small = shape([4, 6, 8], 2, estimator=[8, 6], radius=3, aids=AIDS)
    make_case("learning-aids", drawn(small, 3), small, (24, 40), 2, 3, 4.0)
    both = {"connections": "dense", "upsampling": "deconvolution"}
    dense = shape([4, 6, 8, 8], estimator=[8, 6, 4], context=[8, 6, 4], radius=2, **both)
    make_case("dense-residual", drawn(dense, 4), dense, (35, 46), 2, 4, 4.0)
