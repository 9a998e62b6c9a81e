"""What SciPy says of means, intervals and signed ranks: `evaluate::statistics` is compared with it."""

import json

import numpy as np
from scipy import stats

import golden


def interval(values):
    """Mean and half the 95 % interval by Student's t."""
    mean = float(np.mean(values))
    _, high = stats.t.interval(0.95, len(values) - 1, loc=mean, scale=stats.sem(values))
    return {"values": list(values), "mean": mean, "half_width": float(high - mean)}


def signed_rank(name, differences, method):
    """Two-sided probability; zeros take no part, no correction for continuity."""
    p = stats.wilcoxon(differences, zero_method="wilcox", correction=False, method=method).pvalue
    return {"name": name, "differences": list(differences), "p": float(p)}


def main():
    rng = np.random.default_rng(5)
    draw = lambda count, shift: [round(float(v), 6) for v in rng.normal(shift, 1.0, count)]
    ties = [0.5, 0.5, -0.5, 1.0, 1.0, 2.0, -2.0, 3.0, 3.0, 3.5]
    many = [float(v) for v in rng.integers(-6, 10, 80)]
    result = {
        "means": [interval(draw(count, 3.0)) for count in [2, 3, 5, 30]] + [interval([0.0274, 0.0281, 0.0302])],
        "signed_ranks": [
            signed_rank("six", draw(6, 0.8), "exact"),
            signed_rank("twenty-four", draw(24, 0.5), "exact"),
            signed_rank("fifty", draw(50, 0.2), "exact"),
            # All assignments of signs, which is exact with ties too.
            signed_rank("ties", ties, stats.PermutationMethod(n_resamples=np.inf)),
            signed_rank("eighty", draw(80, 0.3), "asymptotic"),
            signed_rank("eighty with ties and zeros", many, "asymptotic"),
        ],
    }
    (golden.FOLDER / "statistics.json").write_text(json.dumps(result, indent=1) + "\n")

