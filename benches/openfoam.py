#!/usr/bin/env python3
"""OpenFOAM's twoPhaseEulerFoam and favre on the same box, one after the other on one core.

    benches/openfoam.py                 0.3 s of clustered flow; about two minutes
    benches/openfoam.py --help          other lengths, settings and sizes

Needs Python 3.9, OpenFOAM v1912 as Debian 12 ships it (`apt-get install openfoam`; --install does
that), and favre (`cargo build --release`). Nothing is compiled against OpenFOAM.

The box: 16 cm x 16 cm, 128 x 128 cells, periodic, the founding paper's powder in air at mean solids
fraction 0.15. Both are timed once clusters fill it; core seconds per simulated second are printed,
and the variance of the solids fraction and the slip that the particles see, which say whether the
two states are alike.

What OpenFOAM needs for such a box:

- Gravity. The solver's own, g and p_rgh, is not periodic: g is zero here, and each phase has the
  force that is left of its weight when the mean pressure gradient carries the mixture's,
  alpha rho a with a = (1 - rho_mixture/rho) g. No source of the packages gives a phase a constant
  acceleration, and coded sources want a compiler and headers that the packages lack;
  acousticDampingSource is alpha rho c (U_ref - U), which with c = 1e-6 1/s and U_ref = a/c is
  that acceleration to one part in 1e9 of the gas's and 1e-6 of the solids'.
- A thickness: one cell, closed by `empty` patches.
- An energy equation per phase, which cannot be switched off: temperatures are uniform and solved
  to a loose tolerance, in one sweep.
- A clustered start: from the uniform state, OpenFOAM takes several simulated seconds to form
  clusters. The start is a random two-valued field with the clustered state's variance, and
  `--develop` seconds of it are simulated before the clock counts.
"""

import argparse
import json
import math
import os
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from pathlib import Path

# The founding paper's powder and box.
SIZE, CELLS, MEAN = 0.16, 128, 0.15
DIAMETER, SOLIDS, RESTITUTION, PACKING = 75e-6, 1500.0, 0.9, 0.65
GAS, VISCOSITY, GRAVITY = 1.3, 1.8e-5, 9.81
# Slip of the uniform state by Wen and Yu's law, and terminal velocity [m/s].
UNIFORM_SLIP, TERMINAL = 0.5847 * 0.21846, 0.21846
# Rate of the source that stands for an acceleration [1/s].
RATE = 1e-6

SETTINGS = {
    # As few iterations as keep the step stable.
    "lean": dict(outer=1, pressure=1, p=1e-6, p_rel=0.01, u=1e-5, courant=0.8),
    # As in the solver's fluidisedBed tutorial.
    "tutorial": dict(outer=3, pressure=1, p=1e-8, p_rel=0, u=1e-5, courant=0.4),
}


def header(kind, name):
    return f"FoamFile\n{{ version 2.0; format ascii; class {kind}; object {name}; }}\n"


def field(kind, name, dimensions, inside):
    """A field, periodic on all sides."""
    sides = "".join(f"{s} {{ type cyclic; }}\n" for s in ("left", "right", "bottom", "top"))
    return (
        header(f"vol{kind}Field", name)
        + f"dimensions {dimensions};\ninternalField {inside};\n"
        + f"boundaryField\n{{\n{sides}frontAndBack {{ type empty; }}\n}}\n"
    )


def clusters(cells, seed):
    """Solids fractions of two kinds of region, dense and dilute, of the sizes of clusters."""
    chance = random.Random(seed)
    waves = []
    for _ in range(40):
        k = [chance.randint(-14, 14), chance.randint(-8, 8)]
        if 4 <= math.hypot(*k) <= 14:
            waves.append((k, chance.uniform(0, 2 * math.pi)))
    heights = []
    for j in range(cells):
        for i in range(cells):
            turn = 2 * math.pi / cells
            heights.append(sum(math.cos(turn * (k[0] * i + k[1] * j) + at) for k, at in waves))
    dense, dilute = 0.40, 0.02
    count = round((MEAN - dilute) / (dense - dilute) * len(heights))
    level = sorted(heights, reverse=True)[count - 1]
    fractions = [dense if height >= level else dilute for height in heights]
    shift = MEAN - sum(fractions) / len(fractions)
    return [fraction + shift for fraction in fractions]


def write_case(case, cells, settings, end, develop, seed):
    for folder in ("0", "constant", "system"):
        (case / folder).mkdir(parents=True)

    def put(path, text):
        (case / path).write_text(text)

    def dictionary(path, text):
        put(path, header("dictionary", Path(path).name) + text)

    mixture = MEAN * SOLIDS + (1 - MEAN) * GAS
    phi = clusters(cells, seed)
    listed = "\n".join(f"{value:.8g}" for value in phi)
    other = "\n".join(f"{1 - value:.8g}" for value in phi)
    scalars = "nonuniform List<scalar>\n{n}\n(\n{text}\n)"
    put("0/alpha.particles",
        field("Scalar", "alpha.particles", "[0 0 0 0 0 0 0]",
              scalars.format(n=len(phi), text=listed)))
    put("0/alpha.air",
        field("Scalar", "alpha.air", "[0 0 0 0 0 0 0]", scalars.format(n=len(phi), text=other)))
    # The mixture at rest.
    gas_up = MEAN * SOLIDS * UNIFORM_SLIP / mixture
    velocity = "[0 1 -1 0 0 0 0]"
    put("0/U.air", field("Vector", "U.air", velocity, f"uniform (0 {gas_up} 0)"))
    put("0/U.particles",
        field("Vector", "U.particles", velocity, f"uniform (0 {gas_up - UNIFORM_SLIP} 0)"))
    for phase, density in (("air", GAS), ("particles", SOLIDS)):
        pull = -(1 - mixture / density) * GRAVITY
        put(f"0/URef.{phase}",
            field("Vector", f"URef.{phase}", velocity, f"uniform (0 {pull / RATE:.10g} 0)"))
        put(f"0/T.{phase}", field("Scalar", f"T.{phase}", "[0 0 0 1 0 0 0]", "uniform 300"))
        put(f"0/alphat.{phase}",
            field("Scalar", f"alphat.{phase}", "[1 -1 -1 0 0 0 0]", "uniform 0"))
        put(f"0/nut.{phase}", field("Scalar", f"nut.{phase}", "[0 2 -1 0 0 0 0]", "uniform 0"))
    for name in ("p", "p_rgh"):
        put(f"0/{name}", field("Scalar", name, "[1 -1 -2 0 0 0 0]", "uniform 1e5"))
    put("0/Theta.particles",
        field("Scalar", "Theta.particles", "[0 2 -2 0 0 0 0]", "uniform 1e-4"))

    put("constant/g", header("uniformDimensionedVectorField", "g")
        + "dimensions [0 1 -2 0 0 0 0];\nvalue (0 0 0);\n")
    dictionary("constant/phaseProperties", f"""
phases (particles air);
particles {{ diameterModel constant; constantCoeffs {{ d {DIAMETER}; }}
             alphaMax {PACKING}; residualAlpha 1e-6; }}
air {{ diameterModel constant; constantCoeffs {{ d 1; }} residualAlpha 0; }}
blending {{ default {{ type none; continuousPhase air; }} }}
sigma ( (particles and air) 0 );
aspectRatio ();
drag ( (particles in air) {{ type WenYu; residualRe 1e-3; swarmCorrection {{ type none; }} }} );
virtualMass ();
heatTransfer ();
lift ();
phaseTransfer ();
wallLubrication ();
turbulentDispersion ();
pMin 1;
""")
    for phase, density, viscosity in (("air", GAS, VISCOSITY), ("particles", SOLIDS, 0)):
        dictionary(f"constant/thermophysicalProperties.{phase}", f"""
thermoType {{ type heRhoThermo; mixture pureMixture; transport const; thermo hConst;
              equationOfState rhoConst; specie specie; energy sensibleInternalEnergy; }}
mixture {{ specie {{ molWeight 28.9; }} equationOfState {{ rho {density}; }}
           thermodynamics {{ Cp 1e6; Hf 0; }} transport {{ mu {viscosity}; Pr 1; }} }}
""")
    dictionary("constant/turbulenceProperties.air", "simulationType laminar;\n")
    dictionary("constant/turbulenceProperties.particles", f"""
simulationType RAS;
RAS {{
    RASModel kineticTheory; turbulence on; printCoeffs off;
    kineticTheoryCoeffs {{
        equilibrium off; e {RESTITUTION}; alphaMax {PACKING}; alphaMinFriction 0.63;
        residualAlpha 1e-4; viscosityModel Gidaspow; conductivityModel Gidaspow;
        granularPressureModel Lun; frictionalStressModel JohnsonJackson;
        radialModel SinclairJackson;
        JohnsonJacksonCoeffs {{ Fr 0.05; eta 2; p 5; phi 28.5; alphaDeltaMin 0.05; }}
    }}
    phasePressureCoeffs {{ preAlphaExp 500; expMax 1000; alphaMax {PACKING}; g0 1000; }}
}}
""")
    dictionary("constant/fvOptions", "".join(f"""
weight.{phase} {{
    type acousticDampingSource; active yes;
    acousticDampingSourceCoeffs {{
        selectionMode all; U U.{phase}; URef URef.{phase}; w 1; frequency {RATE};
        origin (-1e3 0 0); radius1 0; radius2 1;
    }}
}}
""" for phase in ("particles", "air")))

    deep = SIZE / cells
    dictionary("system/blockMeshDict", f"""
scale 1;
vertices ( (0 0 0) ({SIZE} 0 0) ({SIZE} {SIZE} 0) (0 {SIZE} 0)
           (0 0 {deep}) ({SIZE} 0 {deep}) ({SIZE} {SIZE} {deep}) (0 {SIZE} {deep}) );
blocks ( hex (0 1 2 3 4 5 6 7) ({cells} {cells} 1) simpleGrading (1 1 1) );
edges ();
boundary (
    left {{ type cyclic; neighbourPatch right; faces ((0 4 7 3)); }}
    right {{ type cyclic; neighbourPatch left; faces ((1 2 6 5)); }}
    bottom {{ type cyclic; neighbourPatch top; faces ((0 1 5 4)); }}
    top {{ type cyclic; neighbourPatch bottom; faces ((3 7 6 2)); }}
    frontAndBack {{ type empty; faces ((0 3 2 1) (4 5 6 7)); }}
);
mergePatchPairs ();
""")
    dictionary("system/controlDict", f"""
application twoPhaseEulerFoam;
startFrom startTime; startTime 0; stopAt endTime; endTime {end};
deltaT 1e-5; adjustTimeStep yes; maxCo {settings["courant"]}; maxDeltaT 1e-3;
writeControl adjustableRunTime; writeInterval {round(end - develop, 9)}; purgeWrite 1;
writeFormat ascii; writePrecision 9; timeFormat general; timePrecision 9;
runTimeModifiable no;
functions {{ readFields1 {{ type readFields; libs (fieldFunctionObjects);
                           fields (URef.particles URef.air); }} }}
""")
    dictionary("system/fvSchemes", r"""
ddtSchemes { default Euler; }
gradSchemes { default Gauss linear; }
divSchemes {
    default none;
    "div\(phi,alpha.*\)" Gauss vanLeer;
    "div\(phir,alpha.*\)" Gauss vanLeer;
    "div\(alphaRhoPhi.*,U.*\)" Gauss limitedLinearV 1;
    "div\(phi.*,U.*\)" Gauss limitedLinearV 1;
    "div\(alphaRhoPhi.*,(h|e).*\)" Gauss limitedLinear 1;
    "div\(alphaRhoPhi.*,K.*\)" Gauss limitedLinear 1;
    "div\(alphaPhi.*,p\)" Gauss limitedLinear 1;
    div(alphaRhoPhi.particles,Theta.particles) Gauss limitedLinear 1;
    div((((alpha.air*thermo:rho.air)*nuEff.air)*dev2(T(grad(U.air))))) Gauss linear;
    div((((thermo:rho.particles*nut.particles)*dev2(T(grad(U.particles))))+(((thermo:rho.particles*lambda.particles)*div(phi.particles))*I))) Gauss linear;
}
laplacianSchemes { default Gauss linear uncorrected; bounded Gauss linear uncorrected; }
interpolationSchemes { default linear; }
snGradSchemes { default uncorrected; bounded uncorrected; }
""")
    sweep = "solver smoothSolver; smoother symGaussSeidel; relTol 0; minIter 1; maxIter"
    dictionary("system/fvSolution", f"""
solvers {{
    "alpha.*" {{ nAlphaCorr 1; nAlphaSubCycles 2; smoothLimiter 0.1; implicitPhasePressure yes;
                {sweep} 100; tolerance 1e-9; }}
    p_rgh {{ solver GAMG; smoother DIC; tolerance {settings["p"]}; relTol {settings["p_rel"]}; }}
    p_rghFinal {{ $p_rgh; }}
    "U.*" {{ {sweep} 100; tolerance {settings["u"]}; }}
    "e.*" {{ {sweep} 1; tolerance 1e-3; }}
    "Theta.*" {{ {sweep} 100; tolerance 1e-6; }}
}}
PIMPLE {{ nOuterCorrectors {settings["outer"]}; nCorrectors {settings["pressure"]};
         nNonOrthogonalCorrectors 0; pRefCell 0; pRefValue 1e5; }}
relaxationFactors {{ equations {{ ".*" 1; }} }}
""")


def run_openfoam(case, log):
    environment = dict(os.environ, WM_PROJECT_DIR="/usr/share/openfoam")
    for program in ("blockMesh", "twoPhaseEulerFoam"):
        with open(log, "w") as file:
            done = subprocess.run([program, "-case", case], stdout=file, stderr=file,
                                  env=environment)
        if done.returncode:
            tail = "\n".join(Path(log).read_text().splitlines()[-25:])
            sys.exit(f"{program} failed with status {done.returncode}; {log} ends with\n{tail}")


def timed(log, develop):
    """Core seconds per simulated second and step [s] from `develop` on, from the solver's log."""
    marks, now = [], 0.0
    for line in Path(log).read_text().splitlines():
        if match := re.match(r"Time = (\S+)", line):
            now = float(match[1])
        elif match := re.match(r"ExecutionTime = (\S+) s", line):
            marks.append((now, float(match[1])))
    counted = [mark for mark in marks if mark[0] >= develop * (1 - 1e-9)]
    (begin, before), (end, after) = counted[0], counted[-1]
    return (after - before) / (end - begin), (end - begin) / (len(counted) - 1), after


def read_field(path):
    text = path.read_text()
    start = text.index("internalField")
    body = text[text.index("(", start) + 1:text.index(";", start)]
    if "List<vector>" in text[start:start + 80]:
        return [float(v.split()[1]) for v in re.findall(r"\(([^()]*)\)", body)]
    return [float(v) for v in body.split(")")[0].split()]


def state(case):
    """Variance of the solids fraction and the slip that particles see, over u_t, at the end."""
    last = max((f for f in case.iterdir() if re.fullmatch(r"[\d.e-]+", f.name)),
               key=lambda folder: float(folder.name))
    phi = read_field(last / "alpha.particles")
    slip = [g - s for g, s in zip(read_field(last / "U.air"), read_field(last / "U.particles"))]
    mean = sum(phi) / len(phi)
    variance = sum((value - mean) ** 2 for value in phi) / len(phi)
    seen = sum(value * w for value, w in zip(phi, slip)) / sum(phi)
    return mean, variance, seen / TERMINAL


def main():
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--settings", choices=SETTINGS, default="lean")
    parser.add_argument("--develop", type=float, default=0.3, metavar="S",
                        help="simulated time before the clock counts [default: 0.3]")
    parser.add_argument("--time", type=float, default=0.3, metavar="S",
                        help="simulated time that counts [default: 0.3]")
    parser.add_argument("--cells", type=int, default=CELLS, help="along each edge [default: 128]")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--favre", default="target/release/favre", metavar="PROGRAM")
    parser.add_argument("--keep", metavar="DIR", help="keep OpenFOAM's case in this new folder")
    parser.add_argument("--install", action="store_true", help="apt-get install openfoam first")
    args = parser.parse_args()
    if args.install:
        subprocess.run(["apt-get", "install", "-y", "--no-install-recommends", "openfoam"],
                       check=True)
    for program, remedy in (("twoPhaseEulerFoam", "apt-get install openfoam, or --install"),
                            (args.favre, "cargo build --release, or --favre PROGRAM")):
        if not shutil.which(program):
            sys.exit(f"{program} is not there: {remedy}")

    with tempfile.TemporaryDirectory() as scratch:
        case = Path(args.keep or Path(scratch) / "box")
        settings = SETTINGS[args.settings]
        write_case(case, args.cells, settings, args.develop + args.time, args.develop, args.seed)
        log = case / "log"
        print(f"OpenFOAM v1912, {args.settings} settings: {args.cells} x {args.cells} cells, "
              f"{args.develop} s to develop, {args.time} s that count", flush=True)
        begin = time.time()
        run_openfoam(str(case), str(log))
        foam, step, all_of_it = timed(log, args.develop)
        mean, variance, seen = state(case)
        per_cell = 1e6 * foam * step / args.cells ** 2
        print(f"  {foam:.1f} core s per simulated s; step {step:.2e} s, {per_cell:.2f} us per cell "
              f"and step; {all_of_it:.0f} core s in all, {time.time() - begin:.0f} s on the clock")
        print(f"  at the end: mean of phi {mean:.6f}, variance of phi {variance:.4f}, slip seen by "
              f"particles {seen:.3f} u_t", flush=True)

    report = json.loads(subprocess.run([args.favre, "bench", "--quick", "--json"], check=True,
                                       stdout=subprocess.PIPE).stdout)
    print("favre, the same box, without statistics:")
    for found in report["measurements"]:
        if found["cells"] != [CELLS, CELLS] or found["threads"] != 1 or found["statistics"]:
            continue
        cost = found["per_simulated_second"]
        print(f"  {found['precision']}: {cost:.2f} core s per simulated s; step "
              f"{found['step']:.2e} s, {found['per_cell_step']:.4f} us per cell and step; "
              f"variance of phi {found['solids_fraction_variance']:.4f}, slip seen by particles "
              f"{found['particle_slip']:.3f} u_t")
        if args.cells == CELLS:
            print(f"  OpenFOAM / favre {found['precision']}: {foam / cost:.0f}")


if __name__ == "__main__":
    main()
