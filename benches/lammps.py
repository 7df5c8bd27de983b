#!/usr/bin/env python3
"""LAMMPS's gran/hooke/history and favre's spheres in touch, in turn on one core.

    benches/lammps.py                   59,000 spheres at three solids fractions; two minutes or so
    benches/lammps.py --help            other numbers, sizes, lengths

Needs Python 3.9, LAMMPS as Debian 12 ships it (`apt-get install lammps`; --install does that), and
cargo.

The box: equal spheres of 75 um at random in a periodic cube, hot, spring and dashpot and a frictional
slider with history, one fiftieth of a contact time a step. Both start from the same file of positions and
velocities and make the same steps. LAMMPS gets the fastest of three skins, tried first. Times are CPU
seconds, so that what else runs on the machine counts little; the median of the rounds, in which
the two take turns. The granular temperature and the contacts per sphere after the last step say
whether both computed the same.
"""

import argparse
import json
import re
import shutil
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
SKINS = (0.1, 0.2, 0.3)
DIAMETER, DENSITY = 75e-6, 1500.0

INPUT = """
units si
atom_style sphere
boundary p p p
newton off
comm_modify vel yes
read_data {data}
pair_style gran/hooke/history {stiffness} {tangential_stiffness} {damping} {half} {friction} 1
pair_coeff * *
neighbor {skin} bin
neigh_modify delay 0 every 1 check yes
fix move all nve/sphere
timestep {time_step}
compute contacts all contact/atom
compute touching all reduce sum c_contacts
compute kinetic all ke
thermo_style custom step c_kinetic c_touching
thermo_modify norm no format float %.10g
thermo 1000000000
run {warm}
run {steps}
"""


def favre(binary, *options):
    done = subprocess.run([binary, *map(str, options)], capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"favre failed:\n{done.stderr}")
    return json.loads(done.stdout)


def lammps(folder, facts, skin, warm, steps):
    script = folder / "in.favre"
    values = dict(facts, data=folder / "start.data", half=0.5 * facts["damping"])
    script.write_text(INPUT.format(**values, skin=skin * DIAMETER, warm=warm, steps=steps))
    command = ["lmp", "-in", str(script), "-log", "none", "-nocite"]
    environment = {"OMP_NUM_THREADS": "1", "PATH": "/usr/bin:/bin", "HOME": str(folder)}
    environment |= {"OMPI_ALLOW_RUN_AS_ROOT": "1", "OMPI_ALLOW_RUN_AS_ROOT_CONFIRM": "1"}
    done = subprocess.run(command, capture_output=True, text=True, env=environment, cwd=folder)
    loops = re.findall(r"Loop time of (\S+) on 1 procs for (\d+) steps", done.stdout)
    shares = re.findall(r"([\d.]+)% CPU use", done.stdout)
    if done.returncode or len(loops) != 2:
        sys.exit(f"LAMMPS failed:\n{done.stdout[-2000:]}{done.stderr}")
    memory = float(re.findall(r"= \S+ \| \S+ \| (\S+) Mbytes", done.stdout)[-1])
    last = re.findall(r"^ *(\d+) +(\S+) +(\S+) *$", done.stdout, re.MULTILINE)[-1]
    mass = 3.141592653589793 / 6 * DENSITY * DIAMETER**3
    number = facts["number"]
    return {
        "cpu_seconds": float(loops[1][0]) * float(shares[1]) / 100,
        "bytes_per_particle": memory * 2**20 / number,
        "temperature": float(last[1]) * 2 / (3 * mass * number),
        "touching_per_particle": float(last[2]) / 2 / number,
    }


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--fractions", type=float, nargs="+", default=[0.05, 0.30, 0.50])
    parser.add_argument("--number", type=int, default=59_000)
    parser.add_argument("--warm", type=int, default=1000, help="steps before the clock counts")
    parser.add_argument("--steps", type=int, default=2000, help="steps that are timed")
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--install", action="store_true", help="apt-get install lammps first")
    parser.add_argument("--favre", help="the bench binary, if built already")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    if args.install:
        subprocess.run(["apt-get", "install", "-y", "lammps"], check=True, stdout=sys.stderr)
    if not shutil.which("lmp"):
        sys.exit("no lmp: apt-get install lammps, or --install")
    binary = args.favre or built()
    rows = []
    for fraction in args.fractions:
        with tempfile.TemporaryDirectory() as name:
            folder = Path(name)
            size = ["--fraction", fraction, "--number", args.number]
            facts = favre(binary, *size, "--data", folder / "start.data")
            tries = {s: lammps(folder, facts, s, args.warm, 200)["cpu_seconds"] for s in SKINS}
            skin = min(tries, key=tries.get)
            ours, theirs = [], []
            for _ in range(args.rounds):
                theirs.append(lammps(folder, facts, skin, args.warm, args.steps))
                ours.append(favre(binary, *size, "--warm", args.warm, "--steps", args.steps))
        work = args.number * args.steps
        row = {"fraction": fraction, "lammps_skin": skin}
        for code, found in (("lammps", theirs), ("favre", ours)):
            seconds = statistics.median(one["cpu_seconds"] for one in found)
            row[code] = {key: found[-1][key] for key in
                         ("bytes_per_particle", "temperature", "touching_per_particle")}
            row[code]["particle_steps_per_second"] = work / seconds
        row["ratio"] = (row["favre"]["particle_steps_per_second"]
                        / row["lammps"]["particle_steps_per_second"])
        rows.append(row)
        if not args.json:
            show(row, first=len(rows) == 1)
    if args.json:
        print(json.dumps(rows, indent=2))


def built():
    command = ["cargo", "bench", "--bench", "dem", "--no-run", "--message-format=json"]
    done = subprocess.run(command, cwd=ROOT, stdout=subprocess.PIPE, text=True, check=True)
    for line in done.stdout.splitlines():
        message = json.loads(line)
        if message.get("target", {}).get("name") == "dem" and message.get("executable"):
            return message["executable"]
    sys.exit("cargo built no bench named dem")


def show(row, first):
    if first:
        print("  phi  code    million particle-steps/s  ratio  bytes/particle  T [m2/s2]  contacts/particle")
    for code in ("lammps", "favre"):
        it = row[code]
        ratio = f"{row['ratio']:5.2f}" if code == "favre" else "     "
        print(f"{row['fraction']:5.2f}  {code:6}  {it['particle_steps_per_second'] / 1e6:24.1f}  "
              f"{ratio}  {it['bytes_per_particle']:14.0f}  {it['temperature']:9.3e}  "
              f"{it['touching_per_particle']:17.4f}", flush=True)


if __name__ == "__main__":
    main()
