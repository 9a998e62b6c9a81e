"""What the generators share: files, draws, and the numbers that stand for a large gradient."""

import json
import struct
import sys
from pathlib import Path

import numpy as np
import torch

FOLDER = Path(__file__).resolve().parent.parent
# The nets.
sys.path.insert(0, str(FOLDER.parent.parent / "python"))
# A gradient of more values than this is stored as its sketch.
LARGEST_WHOLE = 256
BUCKETS = 64
NUMBER_TYPES = {"float32": "F32", "float16": "F16", "uint8": "U8"}


def write(path, tensors):
    """Writes arrays as one safetensors file: length of the header, header, data."""
    header, data, offset = {}, [], 0
    for name, array in sorted(tensors.items()):
        raw = np.ascontiguousarray(array).tobytes()
        kind = NUMBER_TYPES[str(array.dtype)]
        header[name] = {"dtype": kind, "shape": list(array.shape), "data_offsets": [offset, offset + len(raw)]}
        data.append(raw)
        offset += len(raw)
    text = json.dumps(header).encode()
    text += b" " * (-len(text) % 8)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(struct.pack("<Q", len(text)) + text + b"".join(data))


def write_net(folder, name, kind, architecture, net, precision, rename=str):
    """Writes a net as a folder of weights, the way trained ones are released. `rename` maps its names to the files'."""
    number_type = {"f16": np.float16, "f32": np.float32}[precision]
    weights = {rename(key): value.detach().numpy().astype(number_type) for key, value in net.state_dict().items()}
    write(folder / f"{name}.safetensors", weights)
    record = {
        "kind": kind,
        "architecture": architecture,
        "precision": precision,
        "parameters": sum(w.size for w in weights.values()),
        "training": "none: random weights of tests/golden/generate",
    }
    (folder / "manifest.json").write_text(json.dumps({"format": 1, "nets": {name: record}}, indent=1) + "\n")


def round_weights(net, precision):
    """Rounds the weights to what the file can hold, so that both sides compute with the same numbers."""
    number_type = {"f16": torch.float16, "f32": torch.float32}[precision]
    with torch.no_grad():
        for parameter in net.parameters():
            parameter.copy_(parameter.to(number_type).to(parameter.dtype))


def single(tensor):
    """A result, computed in double precision, as it is stored."""
    return tensor.detach().to(torch.float32).numpy()


def signs(count):
    """+1 and −1 by a multiplicative hash of the index: a random vector that needs no storage."""
    hashed = (np.arange(count, dtype=np.uint64) * np.uint64(2654435761)) & np.uint64(0xFFFFFFFF)
    return np.where(hashed >> np.uint64(31), -1.0, 1.0)


def signed_sum(tensor):
    """A scalar in which every value of a tensor takes part: Σ sign(i)·x_i."""
    return (tensor.reshape(-1) * torch.from_numpy(signs(tensor.numel()))).sum()


def sketch(tensor):
    """A tensor as it is stored; of a large one BUCKETS signed sums over every BUCKETS-th value.

    The signs are independent, so the norm of a sketch's error is, on average, the norm of the tensor's error.
    """
    if tensor.numel() > LARGEST_WHOLE:
        flat = tensor.detach().reshape(-1).numpy() * signs(tensor.numel())
        tensor = torch.from_numpy(np.bincount(np.arange(flat.size) % BUCKETS, weights=flat))
    return single(tensor)


def gradients(net, prefix="gradient", rename=str):
    """The gradient of every parameter, which are then cleared."""
    found = {}
    for name, parameter in net.named_parameters():
        gradient = parameter.grad if parameter.grad is not None else torch.zeros_like(parameter)
        found[f"{prefix}.{rename(name)}"] = sketch(gradient)
        parameter.grad = None
    return found


def normal(shape, deviation, generator):
    """A parameter of Gaussian values."""
    return torch.nn.Parameter(torch.randn(shape, generator=generator, dtype=torch.float64) * deviation)


def textures(count, height, width, generator):
    """8-bit pictures with structure at several scales, `[count, 3, H, W]`."""
    picture = torch.full((count, 3, height, width), 0.5, dtype=torch.float64)
    for scale, share in [(8, 0.25), (3, 0.15), (1, 0.1)]:
        size = (height // scale + 2, width // scale + 2)
        noise = torch.rand((count, 3, *size), generator=generator, dtype=torch.float64) * 2 - 1
        noise = torch.nn.functional.interpolate(noise, scale_factor=scale, mode="nearest")
        picture += share * noise[..., :height, :width]
    return (picture.clamp(0, 1) * 255).round().to(torch.uint8)


def decoded(picture):
    """8-bit values as numbers in [0, 1]; rounded to single precision, which is where the other side starts."""
    return (picture.to(torch.float32) / 255).to(torch.float64)
