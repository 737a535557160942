#!/usr/bin/env bash
# AnaFlow 1.2.0: theis(..., r_bound=R) at times when the rim is far from being felt. There the rim
# cannot matter, and the answer must be that of the infinite aquifer; it is so while R is up to 200
# times the length sqrt(T t / S) that pressure has travelled, and at 300 times and more it is not:
# five orders of magnitude too large, five times too large, or nothing at all, finite numbers all.
# Valid input: a well pumped at 1e-4 m3/s, storage and transmissivity 1e-4, seen at 0.1 m, a rim of
# constant head at 50 m, times from 2.5 ms to 25 s.
# Seen: ratios bounded / infinite of 1.0000 at R / sqrt(T t / S) = 10, 100 and 200, and some 1e5, 5
# and 0 at 300, 500 and 1000. This script fails if that changes.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --disable-pip-version-check anaflow==1.2.0
"$folder/venv/bin/python" - <<'PY'
import warnings

import numpy as np
from anaflow import theis

STORAGE, TRANSMISSIVITY, RIM = 1e-4, 1e-4, 50.0
lengths = np.array([10.0, 100.0, 200.0, 300.0, 500.0, 1000.0])
times = (RIM / lengths) ** 2 * STORAGE / TRANSMISSIVITY


def drawdown(time, **bound):
    """At 0.1 m of the well."""
    return float(np.ravel(theis([time], [0.1], STORAGE, TRANSMISSIVITY, -1e-4, **bound))[0])


with warnings.catch_warnings():
    warnings.simplefilter("ignore")
    ratios = [drawdown(time, r_bound=RIM) / drawdown(time) for time in times]
for length, ratio in zip(lengths, ratios):
    print(f"R / sqrt(T t / S) = {length:6.0f}: bounded / infinite = {ratio:.4f}")
assert all(abs(ratio - 1) < 1e-3 for ratio in ratios[:3]), ratios
assert ratios[3] > 1e3 and ratios[4] > 2 and abs(ratios[5]) < 1e-3, ratios
PY
