"""Nets of a folder of weights in PyTorch: `net = load("folder", "svbrdf")`. Needs PyTorch and safetensors, pwc.py and svbrdf.py beside it.

`python load.py [folder]` runs every net on the folder's examples and compares with what the program computed.
"""

import hashlib, json, sys
from pathlib import Path

import torch
from safetensors.torch import load as tensors_of

from pwc import Pwc
from svbrdf import SvbrdfNet


def load(folder, name):
    """The net with the weights of the folder, as single-precision numbers; `state_dict` keys are the files' tensor names."""
    record = json.loads((Path(folder) / "manifest.json").read_text())["nets"][name]
    net = {"pwc": Pwc, "svbrdf": SvbrdfNet}[record["kind"]](**record["architecture"])
    state = {}
    for part in record.get("shards") or [{"file": f"{name}.safetensors", "sha256": record.get("sha256")}]:
        data = (Path(folder) / part["file"]).read_bytes()
        if part["sha256"] not in (None, hashlib.sha256(data).hexdigest()):
            sys.exit(f"{part['file']} is not the file that manifest.json describes: copy both again")
        state |= tensors_of(data)
    net.load_state_dict({key: value.float() for key, value in state.items()})
    return net.eval()


if __name__ == "__main__":
    folder, worst = Path(sys.argv[1] if len(sys.argv) > 1 else __file__).resolve(), 0.0
    folder = folder if folder.is_dir() else folder.parent
    examples = tensors_of((folder / "examples.safetensors").read_bytes())
    for name in json.loads((folder / "manifest.json").read_text())["nets"]:
        inputs = [examples[key] for key in sorted(examples) if key.startswith(f"{name}.input.")]
        with torch.no_grad():
            difference = (load(folder, name)(*inputs) - examples[f"{name}.output"]).abs().max()
        worst = max(worst, share := float(difference / examples[f"{name}.output"].abs().max()))
        print(f"{name}: outputs differ by {share:.1e} of the largest value")
    sys.exit("error: more than 1e-4" if not worst <= 1e-4 else 0)
