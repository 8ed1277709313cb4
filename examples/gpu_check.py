"""What a GPU makes of the simulator: the CPU's curves? ball-steps a second, bytes, tangents, compiler options, kernels.

    python examples/gpu_check.py --output gpu_check [--budget 460] [--parts device,batches,..] [--small]

Every part is a process of its own with a time limit (`peers/axijax_gpu.py`), so that one that runs out of memory, or
brings the driver down, is a sentence in the table and the rest goes on; after the budget the parts that are left are
named and left out. The tables gpu_check.md and gpu_check.json are written with every row, beside log.txt, the CPU's
curves and the compiled text of a step. Without a GPU, or with --small, sizes are small and it takes some minutes of a
CPU, to try it.

Timed are steps of a shear after compilation, the membrane's forces fixed in size, a record every 50 steps. Specimens
start from rest, where balls just touch: what a step costs does not depend on the forces. Bytes a ball-step: "compiled"
as XLA counts those of one step; "least" with every argument that a step needs read once and its results written once.
"""

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

CHILD = Path(__file__).resolve().parent / "peers" / "axijax_gpu.py"
PARTS = {  # seconds at most
    "device": 60, "batches": 140, "curves": 130, "sizes": 170, "tangents": 100, "kernels": 60, "options": 90,
    "random": 110, "whole": 90,
}  # fmt: skip
REFERENCE = "reference"  # the CPU's curves, made beside the first parts
PATIENCE = 6.0  # times the limits where a CPU does it all


class Check:
    """Runs the parts, whose rows they append to a file, and writes the tables."""

    def __init__(self, folder: Path, budget: float, small: bool):
        self.folder, self.small, self.ends = folder, small, time.monotonic() + budget
        folder.mkdir(parents=True, exist_ok=True)
        for name in ("rows.jsonl", "log.txt", "specimen.npz", "reference.npz"):
            (folder / name).unlink(missing_ok=True)
        self.log = (folder / "log.txt").open("a")

    def start(self, part: str, **environment: str) -> subprocess.Popen:
        command = [sys.executable, str(CHILD), part, str(self.folder), *(["--small"] if self.small else [])]
        return subprocess.Popen(command, env=os.environ | environment, stdout=self.log, stderr=self.log)

    def wait(self, child: subprocess.Popen, seconds: float) -> str:
        """Why a process came to a bad end; empty where it did not."""
        began = time.monotonic()
        ends = min(began + seconds * (PATIENCE if self.small else 1.0), self.ends)
        while child.poll() is None and time.monotonic() < ends:
            time.sleep(0.5)
            self.write()
        if child.poll() is None:
            child.kill()
            child.wait()
            return f"stopped after {ends - began:.0f} seconds, its limit or the end of the budget"
        return "" if child.returncode == 0 else f"ended with status {child.returncode}; see log.txt"

    def run(self, part: str) -> None:
        began, trouble = time.monotonic(), "left out: the budget is spent"
        if began < self.ends - 5:
            trouble = self.wait(self.start(part), PARTS[part])
        if trouble:
            append(self.folder, part, {"what": part, "failed": trouble})
        self.write()
        print(f"{part}: {time.monotonic() - began:.0f} s {trouble}", flush=True)

    def write(self) -> None:
        rows = read_rows(self.folder)
        (self.folder / "gpu_check.json").write_text(json.dumps(rows, indent=1))
        (self.folder / "gpu_check.md").write_text(tables(rows))


def append(folder: Path, part: str, row: dict) -> None:
    with (folder / "rows.jsonl").open("a") as file:
        file.write(json.dumps({"part": part} | row) + "\n")


def read_rows(folder: Path) -> list[dict]:
    path = folder / "rows.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def tables(rows: list[dict]) -> str:
    """A table of each part in Markdown."""
    lines = []
    for part in dict.fromkeys(row["part"] for row in rows):
        mine = [{key: value for key, value in row.items() if key != "part"} for row in rows if row["part"] == part]
        heads = list(dict.fromkeys(key for row in mine for key in row))
        lines += ["", f"**{part}**", "", "| " + " | ".join(heads) + " |", "|" + "---|" * len(heads)]
        lines += ["| " + " | ".join(shown(row.get(head, "")) for head in heads) + " |" for row in mine]
    return "\n".join(lines[1:]) + "\n"


def shown(value: Any) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value).replace("|", "/").replace("\n", " ")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--output", type=Path, default=Path("gpu_check"), help="folder")
    parser.add_argument("--budget", type=float, default=460, help="seconds for all parts")
    parser.add_argument("--parts", default=",".join(PARTS), help="which, and in what order")
    parser.add_argument("--small", action="store_true", help="small sizes; without a GPU always")
    given = parser.parse_args()
    wanted = [part for part in given.parts.split(",") if part]
    if unknown := set(wanted) - set(PARTS):
        parser.error(f"--parts {', '.join(sorted(unknown))}: known are {', '.join(PARTS)}")
    check = Check(given.output, given.budget, given.small)
    check.run("device")
    check.small |= not any(row.get("platform") in ("gpu", "cuda", "rocm") for row in read_rows(given.output))
    # Two processes at once would share the cores that a small run is timed on.
    beside = check.start(REFERENCE, JAX_PLATFORMS="cpu") if {"curves", "random"} & set(wanted) else None
    if beside is not None and check.small and (trouble := check.wait(beside, PARTS["curves"])):
        append(given.output, REFERENCE, {"what": "the CPU's curves", "failed": trouble})
    for part in wanted:
        if part == "curves" and beside is not None and (trouble := check.wait(beside, PARTS["curves"])):
            append(given.output, part, {"what": "the CPU's curves", "failed": trouble})
        if part != "device":
            check.run(part)
    if beside is not None and beside.poll() is None:
        beside.kill()
    print((given.output / "gpu_check.md").read_text())


if __name__ == "__main__":
    main()
