"""Writes every file under tests/golden: `python tests/golden/generate`."""

import json

import torch

import adam
import comparison
import flow_cases
import golden
import losses
import published
import svbrdf_cases

torch.set_num_threads(1)
torch.use_deterministic_algorithms(True)
for twin in [svbrdf_cases, flow_cases, published, losses, adam, comparison]:
    twin.main()
counts = svbrdf_cases.count() | flow_cases.count() | published.count()
(golden.FOLDER / "counts.json").write_text(json.dumps(counts, indent=1) + "\n")
print(counts)
