"""Writes every file under tests/golden: `python tests/golden/generate`."""

import json

import torch

import adam
import comparison
import golden
import losses
import published
import pwc
import svbrdf

torch.set_num_threads(1)
torch.use_deterministic_algorithms(True)
for twin in [svbrdf, pwc, published, losses, adam, comparison]:
    twin.main()
counts = svbrdf.count() | pwc.count() | published.count()
(golden.FOLDER / "counts.json").write_text(json.dumps(counts, indent=1) + "\n")
print(counts)
