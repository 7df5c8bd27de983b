#!/usr/bin/env python3
"""How much of the local drift flux a coarse solver can know, by what it is told.

    favre simulate resolved.toml --out one      # [output] fields = "npz"; another seed to --out two
    benches/drift.py one two 6 12 24 30         # train on one, score on two; widths in cells

The vertical drift flux J = filt(phi u_g) - phi u_g~ at single filter positions, not bin means, as a
function of the filtered solids fraction, + the vertical slip s, + the vertical filtered pressure gradient G
with its mean, less the gas's weight, over rho_s g. Each marker's share is that of the best function linear
in the markers, its coefficients free over phi; then the two-parameter formula
J = -phi s - A (1 - phi)^m G u_t, which is the force balance of a gas without inertia: zero without a filter
by itself. Prints R2 = 1 - sum (J - predicted)^2 / sum (J - mean)^2 on the run that it has not seen. Needs
numpy; runs with the default drive, whose mean gradient balances the weight.
"""

import glob
import json
import os
import sys

import numpy as np

GRAVITY, STEADY = 9.81, 0.4  # [m/s2]; share of a run that is left out at its start


def filtered(field, cells):
    """Box filter, periodic."""
    for axis in (-1, -2):
        count = field.shape[axis]
        head = np.take(field, range(cells), axis=axis)
        total = np.cumsum(np.concatenate([field, head], axis=axis), axis=axis)
        total = np.concatenate([np.zeros_like(np.take(total, [0], axis=axis)), total], axis=axis)
        upper = np.take(total, range(cells, cells + count), axis=axis)
        field = (upper - np.take(total, range(count), axis=axis)) / cells
    return field


def positions(folder, cells):
    """J/u_t, phi, s/u_t and G at every fourth position of every box and snapshot."""
    with open(os.path.join(folder, "run.json"), encoding="utf-8") as file:
        run = json.load(file)
    velocity = run["scales"]["terminal_velocity"]
    solids, gas = run["case"]["powder"]["density"], run["case"]["gas"]["density"]
    columns = []
    for box in sorted(glob.glob(os.path.join(folder, "fields_*"))):
        mean = float(box.rsplit("_", 1)[1])
        files = sorted(glob.glob(os.path.join(box, "*.npz")))
        for name in files[int(STEADY * len(files)):]:
            fields = np.load(name)
            axis = int(fields["vertical"][0])
            phi = fields["solids_fraction"]
            of_solids, of_gas = fields["solids_velocity"][axis], fields["gas_velocity"][axis]
            fraction = filtered(phi, cells)
            gas_velocity = filtered((1 - phi) * of_gas, cells) / (1 - fraction)
            flux = filtered(phi * of_gas, cells) - fraction * gas_velocity
            slip = gas_velocity - filtered(phi * of_solids, cells) / fraction
            gradient = filtered(fields["pressure_gradient"][axis], cells) / (solids * GRAVITY)
            gradient = gradient - mean * (1 - gas / solids)
            found = (flux / velocity, fraction, slip / velocity, gradient)
            columns.append([field[::4, ::4].ravel() for field in found])
    return np.array([np.concatenate(column) for column in zip(*columns)])


def score(value, predicted):
    return 1 - ((value - predicted) ** 2).sum() / ((value - value.mean()) ** 2).sum()


def linear(train, test, markers):
    """Score of the best sum over markers of a piecewise linear function of phi times the marker."""
    knots = np.unique(np.quantile(train[1], np.linspace(0, 1, 12)))
    hats = np.eye(len(knots))

    def basis(data):
        of_phi = np.array([np.interp(data[1], knots, hat) for hat in hats]).T
        return np.concatenate([of_phi * marker(data)[:, None] for marker in markers], axis=1)

    return score(test[0], basis(test) @ np.linalg.lstsq(basis(train), train[0], rcond=None)[0])


def balance(data, exponent):
    _, phi, slip, gradient = data
    return -phi * slip, -((1 - phi) ** exponent) * gradient


def best(trains):
    """A and m of least squares over all widths, each weighed by its variance."""

    def at(exponent):
        parts = [(balance(data, exponent), data[0], data[0].var() * data.shape[1]) for data in trains]
        above = sum((b * (j - a)).sum() / w for (a, b), j, w in parts)
        amplitude = above / sum((b * b).sum() / w for (_, b), _, w in parts)
        misfit = sum(((j - a - amplitude * b) ** 2).sum() / w for (a, b), j, w in parts)
        return misfit, amplitude, exponent

    return min(at(exponent) for exponent in np.arange(0, 6.001, 0.01))[1:]


def main():
    one, two, widths = sys.argv[1], sys.argv[2], [int(cells) for cells in sys.argv[3:]]
    trains, tests = ([positions(run, cells) for cells in widths] for run in (one, two))
    amplitude, exponent = best(trains)

    def constant(data):
        return np.ones(data.shape[1])

    def slip(data):
        return data[2]

    def gradient(data):
        return data[3]

    print(f"J = -phi s - {amplitude:.3f} (1 - phi)^{exponent:.2f} G u_t")
    print("cells  positions    phi  + slip  + gradient  formula")
    for cells, train, test in zip(widths, trains, tests):
        shares = [[constant], [constant, slip], [constant, slip, gradient]]
        found = [linear(train, test, markers) for markers in shares]
        rest, of_gradient = balance(test, exponent)
        formula = score(test[0], rest + amplitude * of_gradient)
        print(f"{cells:5} {test.shape[1]:10} {found[0]:6.3f} {found[1]:7.3f} {found[2]:11.3f} {formula:8.3f}")


if __name__ == "__main__":
    main()
