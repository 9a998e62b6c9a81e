"""Loads every golden net as a person would, with python/load.py in single precision, and compares outputs with the recorded ones.

`python tests/golden/generate/check.py` needs PyTorch and safetensors.
"""

import json
import sys
from pathlib import Path

import torch
from safetensors.torch import load_file

GOLDEN = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(GOLDEN.parent.parent / "python"))
from load import load

TOLERANCE = 1e-4


def pictures(tensor):
    """8-bit values stand for [0, 1]; masks of 0 and 1 stay."""
    return tensor.float() / (255 if tensor.numel() and tensor.max() > 1 else 1)


worst = 0.0
for manifest in sorted(GOLDEN.glob("*/*/manifest.json")):
    folder, case = manifest.parent, load_file(manifest.parent / "case.safetensors")
    (name,) = json.loads(manifest.read_text())["nets"]
    if name == "svbrdf":
        inputs, expected = (pictures(case["frames"]), case["flow"], pictures(case["valid"])), case["maps"]
    else:
        inputs, expected = pictures(case["images"]).chunk(2), case["flow"]
    with torch.no_grad():
        error = float((load(folder, name)(*inputs) - expected).abs().max() / expected.abs().max())
    # NaN is no maximum.
    worst = error if not error <= worst else worst
    print(f"{folder.parent.name}/{folder.name}: {error:.1e}")
sys.exit(None if worst <= TOLERANCE else f"error: outputs differ by more than {TOLERANCE}")
