#!/usr/bin/env python3
"""By which length flows of particles of different diameters are alike: the founding paper's second figure.

    favre run examples/cfd-dem-L_IV.toml --out IV_75     # and with other diameters in the file
    benches/scaling.py 0 I_60 I_75 I_90 : -2/3 II_40 II_60 II_75 : -1 IV_40 IV_75 IV_150

Each list is of runs whose boxes and cells are the same in units of L(n) = u_t^2/g Fr_p^n, and begins with n.
Prints slip/u_t against Fr_p with 95 % intervals; of each list the slope of ln slip against ln Fr_p at the Fr_p that
lists have in common, which is zero if L(n) is the length; and the n at which it vanishes, of a line through the
lists' slopes, its interval from draws of the slips. Needs numpy.
"""

import json
import sys
from fractions import Fraction

import numpy as np

DRAWS, HALF = 4000, 1.96


def read(folder):
    with open(f"{folder}/run.json", encoding="utf-8") as file:
        run = json.load(file)
    box = run["boxes"][0]
    slip = box["slip"]
    return run["scales"]["froude"], slip["mean"], slip["standard_error"], box["steady"]


def slope(froude, slip, error, at):
    """Slope of ln slip against ln Fr_p at one Fr_p, of a weighted parabola, through two runs of a line."""
    x = np.log(froude / at)
    return np.polyfit(x, np.log(slip), min(2, len(x) - 1), w=slip / error)[-2]


def vanishes(n, slopes, errors):
    """Where the weighted line through the slopes is zero."""
    tilt, start = np.polyfit(n, slopes, 1, w=1 / errors)
    return -start / tilt


lists, words = [], sys.argv[1:]
while words:
    end = words.index(":") if ":" in words else len(words)
    lists.append((float(Fraction(words[0])), words[1:end]))
    words = words[end + 1 :]
if not lists or any(len(folders) < 2 for _, folders in lists):
    sys.exit(__doc__)
random = np.random.default_rng(1)
runs = [(n, [np.array(column) for column in zip(*map(read, folders))], folders) for n, folders in lists]
# In the middle of what all lists span.
lowest, highest = max(r[0].min() for _, r, _ in runs), min(r[0].max() for _, r, _ in runs)
common = np.sqrt(lowest * highest)
slopes, drawn = [], []
for n, (froude, slip, error, steady), folders in runs:
    print(f"n = {n:.3f}")
    for row in zip(folders, froude, slip, error, steady):
        late = "" if row[4] else " (not steady)"
        print(f"  {row[0]:24} Fr_p = {row[1]:6.1f}  slip/u_t = {row[2]:.3f} ± {HALF * row[3]:.3f}{late}")
    slopes.append(slope(froude, slip, error, common))
    # Errors of slips are of finite runs: drawn as they are known.
    draws = slip + error * random.standard_normal((DRAWS, len(slip)))
    drawn.append([slope(froude, draw, error, common) for draw in draws])
    print(f"  slope at Fr_p = {common:.1f}: {slopes[-1]:.3f} ± {HALF * np.std(drawn[-1]):.3f}")
if len(lists) > 1:
    n, errors = [n for n, _ in lists], np.std(drawn, axis=1)
    found = [vanishes(n, row, errors) for row in np.array(drawn).T]
    low, high = np.percentile(found, [2.5, 97.5])
    best = vanishes(n, slopes, errors)
    beyond = "" if min(n) <= best <= max(n) else ", beyond the lists"
    print(f"the slope vanishes at n = {best:.3f}, 95 % interval {low:.3f} to {high:.3f}{beyond}")
