#!/usr/bin/env python3
"""Test vectors of models/*.toml, computed without the crate.

    python3 data/published/vectors.py

writes them into the files. The equations are those of the papers and public codes, in Python's decimal
arithmetic with 40 digits; nothing is read from the formulae in the files.
"""
import itertools
import re
from decimal import Decimal as N, getcontext

getcontext().prec = 40
PI_MAX = N("0.65")


def e(x):
    return x.exp()


def power(x, y):
    """x^y; 0^y is 0."""
    return N(0) if x == 0 else x ** N(y)


def n(text):
    return N(text)


def igci_shape(f):
    if f < n("0.0012"):
        return n("2.7") * power(f, "0.234")
    if f < n("0.014"):
        return n("0.963") - n("0.019") * power(f, "-0.455")
    if f < n("0.25"):
        return n("0.868") * e(n("-0.38") * f) - n("0.176") * e(n("-119.2") * f)
    if f < n("0.455"):
        return n("0.852") * e(n("-0.268") * f) - n("4.59e-5") * e(n("19.75") * f)
    if f <= n("0.59"):
        return (f - n("0.59")) * (162 + f * (-1054 + f * (2203 + f * -1501)))
    return N(0)


def igci_2d(f, d):
    return igci_shape(f) / (1 + n("1.5") / power(d, "1.3"))


def igci_3d(f, d):
    g = power(f, "0.24") * (n("1.48") + e(-18 * f)) if f < n("0.18") else N(1)
    return igci_shape(f) * g / (1 + n("0.4") / power(d, "1.6"))


def igci_pressure(f, d):
    if f <= n("0.0131"):
        kinetic = f * (n("0.31") - n("10.4") * f)
    elif f <= n("0.290"):
        kinetic = n("0.00232") + f * (n("-0.000183") + f * (n("0.066") - n("0.185") * f))
    elif f <= n("0.595"):
        kinetic = n("0.00615") - n("0.00978") * f
    else:
        kinetic = n("13.8") + f * (n("-50.3") + f * (n("49.5") - n("6.62") * f))
    shape = f * (n("-1.69") + f * (n("-4.61") + 11 * f)) * (f - n("0.59"))
    return kinetic + max(N(0), n("0.48") * power(d, "0.86") * (1 - e(-d / n("1.4"))) * shape)


def igci_viscosity(f, d):
    if f <= n("0.02"):
        kinetic = n("0.00254") + f * (n("-0.207") + f * (n("9.81") + f * (-215 + 1720 * f)))
    elif f <= n("0.2"):
        kinetic = n("0.00136") + f * (
            n("-0.0296") + f * (n("0.329") + f * (n("-1.55") + n("2.72") * f)))
    elif f <= n("0.6095"):
        kinetic = n("0.000335") + f * (n("-0.0005") + f * (n("0.0107") - n("0.0128") * f))
    else:
        kinetic = n("8.30") + f * (n("23.6") * f - 28)
    shape = f * (n("-1.22") + f * (n("-0.7") - 2 * f)) * (f - n("0.59"))
    width = n("0.37") * power(d, "1.22") / (1 + n("0.28") * power(d, "0.43"))
    return kinetic + max(N(0), width * shape)


def wall(height, decay):
    return lambda x: 1 / (1 + n(height) * e(-n(decay) * x))


# h1 = (a0 + a1 V)/(b0 + b1 V) phi + c0 - c1/(d1 V + 0.01), but for the two smallest sizes.
ROWS = {
    "4": ("0.1 0.018 0.01 0.14", "0.9454 0.09 0.2"),
    "8": ("0.3 0.05 0.06 0.4", "0.9466 0.05 0.11"),
    "12": ("2.2 1.3 0.07 5.2", "0.9363 0.11 0.3"),
    "16": ("4 2.6 0.08 10", "0.926 0.17 0.5"),
    "20": ("4 2.5 0.08 10", "0.9261 0.17 0.5"),
    "inf": ("4 1.6 0.08 7.9", "0.9394 0.22 0.6"),
}


def milioli_row(row, f, v):
    small = n("0.01")
    if row == "1":
        slope = n("1.076") + n("0.12") * v - n("0.02") / (v + small)
        return slope * f + n("0.084") + n("0.09") * v - small / (n("0.1") * v + small)
    if row == "2":
        slope = n("1.268") - n("0.2") * v + n("0.14") / (v + small)
        return slope * f + n("0.385") + n("0.09") * v - n("0.05") / (n("0.2") * v + small)
    a0, a1, b0, b1 = map(N, ROWS[row][0].split())
    c0, c1, d1 = map(N, ROWS[row][1].split())
    return (a0 + a1 * v) / (b0 + b1 * v) * f + c0 - c1 / (d1 * v + small)


# Envelope: a (1 + phi) phi^b/(10 phi^c + d) up to an end, then g (m - phi)^k/(1 - phi^l) up to m.
ENVELOPES = {
    "2": "8.6 0.2 1 6.3 0.53 0.423 0.65 0.3 0.4",
    "4": "7.9 0.2 0.9 5 0.50 0.705 0.63 0.3 0.7",
    "8": "7.9 0.2 0.6 3.6 0.45 0.78 0.57 0.2 0.9",
    "12": "7.6 0.2 0.6 3.3 0.35 0.81 0.55 0.3 0.7",
    "16": "8.4 0.2 0.5 3.3 0.25 1.01 0.52 0.3 0.9",
    "20": "8.4 0.2 0.5 3.3 0.25 1.065 0.52 0.3 1",
    "inf": "9 0.15 0.45 4.2 0.25 0.91 0.52 0.4 0.6",
}


def milioli_envelope(row, f):
    a, b, c, d, end, g, m, k, l = map(N, ENVELOPES[row].split())
    if f <= end:
        return a * (1 + f) * power(f, b) / (10 * power(f, c) + d)
    return g * power(m - f, k) / (1 - power(f, l)) if f <= m else N(0)


def milioli(f, d, v):
    edges = [("1.028", None), ("2.056", "2"), ("4.112", "4"), ("8.224", "8"), ("12.336", "12"),
             ("16.448", "16"), ("20.56", "20")]
    row = next((row for edge, row in edges if d <= n(edge)), "inf")
    if row is None:
        return N(0)
    return min(milioli_envelope(row, f), max(milioli_row(row, f, v), N(0)))


def milioli_extended(f, d, v):
    edges = [("1.542", "1"), ("3.084", "2"), ("6.168", "4"), ("10.28", "8"), ("14.392", "12"),
             ("18.504", "16")]
    row = next((row for edge, row in edges if d < n(edge)), "20")
    w = power(v, "1.8")
    far = n("0.882") * (n("2.145") - n("7.8") * w / (n("0.5586") + n("7.746") * w))
    factor = far * (n("0.882") + n("3.494") / (1 + 8 * power(d, "0.4")))
    if f < n("0.1"):
        envelope = n("0.5643") * (1 + f) * power(f, "0.15") / (
            n("0.1997") + n("0.5766") * power(f, "0.3"))
    elif f < n("0.54"):
        envelope = n("0.8428") + f * (n("0.6393") - n("0.6743") * f)
    elif f < n("0.65"):
        envelope = n("0.4099") * power(n("0.65") - f, "0.25") / (power(f, "-0.25") - n("0.9281"))
    else:
        envelope = N(0)
    return min(envelope, max(milioli_row(row, f, v), N(0)) * factor)


def milioli_viscosity(f, d, s):
    gap = n("0.59") - f
    return n("0.7") * f * gap / (n("0.8") + 17 * gap ** 3) * d * d * s if gap >= 0 else N(0)


def milioli_pressure(f, d, s):
    gap = n("0.59") - f
    constant = n("0.4") * f * gap / (n("0.5") + 13 * gap ** 3) if gap >= 0 else N(0)
    return constant * power(d, N(16) / 7) * s * s


def clamped(low, high, x):
    return min(max(x, n(low)), n(high))


def sarkar(f, d, v):
    f, d, v = clamped("0", "0.65", f), clamped("1.36", "6.74", d), clamped("0.02", "5", v)
    start = (n("0.3460") - n("2.4062") * f) / (n("0.01") + power(f, "0.1695")) * (
        1 + n("0.2012") / d - n("0.08929") / d ** 2)
    if v <= start:
        return N(0)
    poly = n("0.7605") + f * (
        n("4.0560") + f * (n("-13.6591") + f * (n("16.1086") - n("3.1394") * f)))
    a = poly * (1 - e(-300 * f)) / (1 + e(100 * (f - n("0.55")))) * (
        1 - n("0.5470") / d + n("0.2377") / d ** 2) * (1 - n("0.01811") / v ** 2)
    p = (n("0.5380") + f * (n("-0.2488") + n("7.3176") * f)) * (
        1 + n("0.4475") / d - n("0.4203") / d ** 2)
    plateau = min(n("0.95"), n("0.92") + n("0.06497") / d ** 2)
    return max(N(0), plateau * (1 - e(-a * power(v - start, p))))


def sarkar_simplified(f, d, v):
    f, d, v = clamped("0", "0.55", f), clamped("1.36", "6.74", d), clamped("0.1", "5", v)
    exponent = n("0.049") * (1 / d - 1) + n("0.3358") / v
    return min(n("0.97"), (n("0.9506") + n("0.1708") / v) * power(f, exponent))


def sarkar_stress(constant, width, rate, fraction):
    def value(f, d, s):
        return n(constant) * power(d, N(width) / 7) * s ** rate * power(f, fraction) / (PI_MAX - f)
    return value


def sarkar_gas(f, d, s):
    return d * d * s * (n("0.0330") + f * (n("0.218") - n("0.485") * f))


def cubic(pieces, f):
    """The piece below whose end f lies: end, origin, coefficients."""
    for end, origin, *c in pieces:
        if end is None or f < n(end):
            x = f - n(origin)
            return sum(n(c) * x ** k if k else n(c) for k, c in enumerate(c))


def radl(f, d):
    a = cubic([("0.016", "0", "21.51"), ("0.10", "0", "1.96", "29.40", "164.91", "-1923"),
               ("0.18", "0.10", "4.63", "4.68", "-412.04", "2254"),
               ("0.25", "0.18", "3.52", "-17.99", "128.80", "-603"),
               ("0.40", "0.25", "2.68", "-8.20", "2.18", "112.33"), (None, "0", "1.79")], f)
    h = cubic([("0.03", "0", "0", "7.97"), ("0.08", "0.03", "0.239", "4.640", "-4.410", "253.630"),
               ("0.12", "0.08", "0.492", "6.100", "33.630", "-789.600"),
               ("0.18", "0.12", "0.739", "5.010", "-61.100", "310.800"),
               ("0.34", "0.18", "0.887", "1.030", "-5.170", "5.990"),
               ("0.48", "0.34", "0.943", "-0.170", "-2.290", "-9.120"),
               ("0.55", "0.48", "0.850", "-1.350", "-6.130", "-132.600"),
               (None, "0.55", "0.680", "-2.340", "-225.200")], f)
    return max(N(0), h * d / (a + d))


def schneiderbauer(f, d, v):
    f, d, v = clamped("0", "0.65", f), clamped("0", "20", d), clamped("0.2", "5", v)
    p = f / PI_MAX
    h = p * (n("6.728") - n("6.743") * p) / (
        n("0.384") + p * (n("6.289") + p * (n("-7.247") + p)))
    width = power(d, "2.664") / (power(d, "2.664") + n("25.89"))
    exponent = -9 * f * (PI_MAX - f) * d ** 5 / (d ** 5 + 1024)
    return 1 - (1 - h * width) * e(exponent * v.ln())


def cloete(f, d, s):
    f, d, s = clamped("0", "0.62", f), clamped("0.2", "10", d), clamped("0", "20", s)
    w = d - n("0.1286")
    return power(f, "4.016") * power(w, "-0.005543") * (
        n("0.1905") * power(s, "1.939") * power(w, "1.658")
        + n("0.03935") * power(f, "12.78") / power(PI_MAX - f, "5.084"))


PHI, D, V, S = "solids_fraction", "filter_width", "slip", "shear_rate"
FRACTIONS = "0 0.0006 0.006 0.05 0.15 0.3 0.47 0.58 0.62 0.8".split()
FEW = "0 0.005 0.02 0.07 0.11 0.15 0.21 0.3 0.42 0.52 0.545 0.56 0.64 0.7".split()
WIDTHS = "0.5 1.5 4 9 16 40".split()
ONCE = "0.7 1.8 3.5 7 11 15 19 30".split()
SLIPS = "0.05 0.5 1.3 4".split()
RATES = "0 0.5 3".split()
WALLS = "0 1 5 20".split()
X = [("wall_distance", WALLS)]

MODELS = {
    "igci-sundaresan-2011-2d": {"drag_correction": (igci_2d, [(PHI, FRACTIONS), (D, WIDTHS)])},
    "igci-sundaresan-2011-3d": {
        "drag_correction": (igci_3d, [(PHI, FRACTIONS), (D, WIDTHS)]),
        "solids_pressure": (igci_pressure, [(PHI, FRACTIONS), (D, WIDTHS)]),
        "solids_viscosity": (igci_viscosity, [(PHI, FRACTIONS), (D, WIDTHS)]),
        "drag_wall_factor": (wall("6.0", "0.295"), X),
        "solids_pressure_wall_factor": (wall("9.14", "0.345"), X),
        "solids_viscosity_wall_factor": (wall("5.69", "0.228"), X),
    },
    "milioli-2013": {
        "drag_correction": (milioli, [(PHI, FEW), (D, ONCE), (V, SLIPS)]),
        "solids_viscosity": (milioli_viscosity, [(PHI, FRACTIONS), (D, "1.5 9".split()), (S, RATES)]),
        "solids_pressure": (milioli_pressure, [(PHI, FRACTIONS), (D, "1.5 9".split()), (S, RATES)]),
    },
    "milioli-2013-extended": {
        "drag_correction": (milioli_extended, [(PHI, FEW), (D, ONCE), (V, SLIPS)]),
    },
    "sarkar-2016": {
        "drag_correction": (sarkar, [(PHI, FEW), (D, "0.5 1.5 3 6 20".split()), (V, SLIPS)]),
    },
    "sarkar-2016-simplified": {
        "drag_correction": (sarkar_simplified, [(PHI, FRACTIONS), (D, "1 2 6".split()), (V, SLIPS)]),
    },
    "sarkar-2016-stress": {
        "solids_viscosity_residual": (sarkar_stress("0.02518", 12, 1, "1.123"), None),
        "solids_pressure_residual": (sarkar_stress("0.0236", 17, 2, "1.115"), None),
        "solids_viscosity_kinetic": (sarkar_stress("0.00307", 8, 1, "1.544"), None),
        "solids_pressure_kinetic": (sarkar_stress("0.01797", 14, 2, "1.544"), None),
        "gas_kinematic_viscosity": (
            sarkar_gas, [(PHI, FRACTIONS[:7]), (D, "1.5 6".split()), ("gas_shear_rate", RATES)]),
    },
    "radl-sundaresan-2014": {"drag_correction": (radl, [(PHI, FEW), (D, "0.2 2 7 30".split())])},
    "schneiderbauer-pirker-2014": {
        "drag_correction": (schneiderbauer, [(PHI, FRACTIONS), (D, WIDTHS), (V, SLIPS)]),
    },
    "cloete-2018": {"solids_pressure": (cloete, [(PHI, FRACTIONS), (D, "0.1 1 8".split()), (S, RATES)])},
}
STRESS = [(PHI, FRACTIONS[:8]), (D, "1.5 6".split()), (S, RATES)]


def main():
    for name, quantities in MODELS.items():
        path = f"models/{name}.toml"
        text = open(path).read()
        for quantity, (formula, markers) in quantities.items():
            markers = markers or STRESS
            lines = []
            for point in itertools.product(*(values for _, values in markers)):
                expected = float(formula(*map(N, point)))
                at = ", ".join(f"{m} = {float(x)!r}" for (m, _), x in zip(markers, point))
                lines.append(f"  {{ at = {{ {at} }}, expected = {expected!r} }},\n")
            block = re.compile(
                r'(predicts = "%s"\n.*?test_vectors = \[\n).*?(\]\n)' % quantity, re.DOTALL)
            text, found = block.subn(lambda m: m[1] + "".join(lines) + m[2], text, count=1)
            assert found == 1, (name, quantity)
        open(path, "w").write(text)


if __name__ == "__main__":
    main()
