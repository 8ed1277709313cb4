"""Real `kill -9` at random moments of every command that writes, and what it leaves. By hand:

    python tests/kill_runs.py [KILLS] [SEED] [FOLDER] [COMMANDS]

Each trial starts a command as a process of its own, kills it after a random part of the time that it takes by itself
(with a warm compilation cache), and then asks: is every visible file whole; are files of others as they were; have the
processes that it began ended too; does a command afterwards leave no hidden file; and does it, going on, end with the
same bits as one that was never killed. COMMANDS: only these, such as "run,resume"; most start from what "run" leaves,
"library" from what "study" does. Prints a table of counts, exits with 1 where anything was not so.
"""

import contextlib
import itertools
import json
import os
import random
import shutil
import signal
import sys
import tempfile
import time
import zipfile
from collections import Counter
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import xarray

import axijax.app.cli.main
import axijax.app.report
import axijax.app.runs
import calibrate  # noqa: F401 (before the forks)

TINY = """
[specimen]
layers = 3
half_width = 5
[parameters]
platen_speed = 0.004
[test]
axial_strain = 0.012
tolerance = 1e-4
record_every = 50
"""
SWEEP = TINY + "[sweep]\nparameters.friction = [0.1, 0.15, 0.2, 0.25]\n"
# Every kind of platens and of membrane once.
STAGES = (
    'type = "isotropic"\nlateral_stress = 55000.0',
    'type = "anisotropic"\nlateral_stress = 55000.0\nk = 0.9',
    'type = "compression"\naxial_strain = 0.001',
    'type = "compression"\nlateral = "constant_p"\naxial_strain = 0.0015',
    'type = "cycles"\nfirst = 0.001\nsecond = 0.0015\ncycles = 2',
    'type = "extension"\nlateral = "k0"\naxial_strain = 0.0012',
    'type = "compression"\nlateral = "line"\ndq_dp = 2.0\naxial_strain = 0.0016',
    'type = "axial_stress"\naxial_stress = 60000.0\naxial_strain = 0.0',
    'type = "lateral_stress"\nlateral_stress = 52000.0',
    'type = "compression"\nlateral = "fluid"\nfluid_modulus = 1e7\nporosity = 0.4\naxial_strain = 0.002',
    'type = "hold"\ntime = 1.0',
    'type = "compression"\nlateral = "constant_volume"\naxial_strain = 0.004',
)
STAGED = TINY.replace("axial_strain = 0.012\n", "") + "".join(f"[[stage]]\n{each}\n" for each in STAGES)
SAND = """
[specimen]
kind = "random"
balls = 60
[sector]
order = 2
[parameters]
friction = 0.4
platen_speed = 0.2
[test]
tolerance = 2e-3
confine_steps = 100000
axial_strain = 0.012
record_every = 20
"""
STUDY = """
case = "sand.toml"
fit = ["friction"]
runs = 16
[bounds]
friction = [0.15, 0.8]
[[test]]
data = "sand.csv"
packings = "laboratory"
first_strain = 0.002
"""
FURTHER = "0.014"
MARK = "AXIJAX_KILL_RUN"  # in the environment of a command and of the processes that it begins
MINE = {"notes.txt": "mine", "snapshots/photo.txt": "mine", ".hidden-notes": "mine"}


class Bench:
    """A folder for all of it, with a compilation cache of its own, and the results of commands that nobody killed."""

    def __init__(self, root: Path):
        self.root = root
        (root / "tiny.toml").write_text(TINY)
        (root / "sweep.toml").write_text(SWEEP)
        (root / "staged.toml").write_text(STAGED)
        (root / "sand.toml").write_text(SAND)
        (root / "study.toml").write_text(STUDY)
        strain = np.linspace(0, 0.0115, 60)
        rows = (f"{e},{1 + 1.4 * np.tanh(e / 0.002)},{0.2 * e - 0.3 * e**1.2}\n" for e in strain)
        (root / "sand.csv").write_text("axial_strain,stress_ratio,volumetric_strain\n" + "".join(rows))
        self.seconds: dict[str, float] = {}
        for name, steps in COMMANDS.items():
            folder = root / "sound" / name
            self.prepare(name, folder)
            started = time.monotonic()
            code, told = self.call(steps(self, folder)[0])
            self.seconds[name] = time.monotonic() - started
            assert code == 0, (name, told)
            print(f"{name}: {self.seconds[name]:.1f} s by itself, compiling included", flush=True)

    def prepare(self, name: str, folder: Path) -> None:
        """What the command starts from: a finished result where it needs one, and somebody's own files."""
        start = {"library": "study"} | dict.fromkeys(("resume", "snapshot", "report", "overwrite"), "run")
        if name in start:
            shutil.copytree(self.root / "sound" / start[name], folder)
        for file, text in MINE.items():
            (folder / file).parent.mkdir(parents=True, exist_ok=True)
            (folder / file).write_text(text)

    def start(self, arguments) -> tuple[int, Path]:
        """A process of its own for a command, forked where everything is imported and JAX has not begun its threads;
        its number, and the file of what it prints."""
        printed = self.root / f"printed-{os.getpid()}.txt"
        number = os.fork()
        if number:
            return number, printed
        code = 70
        try:
            out = os.open(printed, os.O_WRONLY | os.O_CREAT | os.O_TRUNC)
            for stream in (1, 2):
                os.dup2(out, stream)
            os.chdir(self.root)
            os.environ["AXIJAX_CACHE"] = str(self.root / "cache")
            os.environ[MARK] = str(os.getpid())
            code = axijax.app.cli.main.main([str(argument) for argument in arguments])
        finally:
            sys.stdout.flush()
            os._exit(code)

    def call(self, arguments) -> tuple[int, str]:
        number, printed = self.start(arguments)
        code, told = os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]), printed.read_text()
        # Whole, whatever a fit thinks of itself; and a result that was finished when the kill came.
        done = ("written: " in told and "fit.json" in told) or "is finished at axial_strain" in told
        return 0 if done else code, told

    def killed(self, arguments, after: float) -> bool:
        """Whether the command was still at work."""
        number, _ = self.start(arguments)
        self.last = number
        time.sleep(after)
        os.kill(number, signal.SIGKILL)
        return os.waitstatus_to_exitcode(os.waitpid(number, 0)[1]) == -signal.SIGKILL

    def left_behind(self, number: int, seconds: float = 20.0) -> list[str]:
        """Processes that a killed command began and that do not end of themselves."""
        mark = f"{MARK}={number}\0".encode()
        until = time.monotonic() + seconds
        while True:
            found = []
            for path in Path("/proc").glob("[0-9]*/environ"):
                with contextlib.suppress(OSError):
                    if mark in path.read_bytes() and (path.parent / "cmdline").read_bytes():
                        found.append(path.parent.name)
            if not found or time.monotonic() > until:
                return found
            time.sleep(0.5)


def run(bench, folder):
    """The command, and the ways to go on after a kill, of which one must end well."""
    start = ("run", "tiny.toml", "--output", folder, "--snapshots", "3")
    return start, ("resume", folder), start, (*start, "--overwrite")


def overwrite(bench, folder):
    start = ("run", "tiny.toml", "--output", folder, "--snapshots", "3", "--overwrite")
    return start, start


def resume(bench, folder):
    start = ("resume", folder, "--axial-strain", FURTHER)
    return start, ("resume", folder), start


def batch(bench, folder):
    start = ("batch", "sweep.toml", "--output", folder)
    return start, start


def fit(bench, folder):
    curve = bench.root / "sound" / "run" / "curve.csv"
    start = ("calibrate", curve, "--case", "tiny.toml", "--output", folder, "--no-check")
    return start, start


def snapshot(bench, folder):
    start = ("snapshot", folder)
    return start, start


def report(bench, folder):
    start = ("report", folder)
    return start, start


def staged(bench, folder):
    start = ("run", "staged.toml", "--output", folder, "--snapshots", "3")
    return start, ("resume", folder), start, (*start, "--overwrite")


def pool(bench, folder):
    """A batch by processes of its own, which a kill of the one that asks leaves alone."""
    start = ("batch", "sweep.toml", "--output", folder, "--executor", "processes:2")
    return start, start


def study(bench, folder):
    start = ("calibrate", "study.toml", "--output", folder, "--library", folder / "library", "--workers", "1")
    return start, start


def library(bench, folder):
    start = ("library", "clean", "--library", folder / "library")
    return start, start


def table1(bench, folder):
    start = ("table1", "--output", folder)
    return start, start


COMMANDS = {
    each.__name__: each
    for each in (run, overwrite, resume, batch, fit, snapshot, report, staged, pool, study, library, table1)
}


def broken(path: Path) -> str | None:
    """What is not whole about a visible file."""
    try:
        content = path.read_bytes()
        if path.suffix == ".json":
            json.loads(content)
        elif path.suffix == ".nc":
            xarray.load_dataset(path, engine="scipy").close()
        elif path.suffix == ".npz":
            with zipfile.ZipFile(path) as archive:
                assert archive.testzip() is None
        elif path.suffix == ".npy":
            np.load(path)
        elif path.suffix in (".vtu", ".pvd"):
            ElementTree.fromstring(content)
        elif path.suffix == ".png":
            assert content.endswith(b"IEND\xaeB`\x82")
        elif path.suffix == ".html":
            assert content.rstrip().endswith(b"</html>")
        elif path.suffix == ".jsonl":  # a log, of which the last line may be cut short
            for line in content.splitlines()[:-1]:
                json.loads(line)
        elif path.suffix in (".csv", ".toml"):
            assert content.endswith(b"\n")
        for index in [path] if path.suffix == ".pvd" else []:
            for entry in ElementTree.fromstring(content).iter("DataSet"):
                assert (index.parent / entry.attrib["file"]).exists(), entry.attrib["file"]
    except Exception as error:
        return f"{path}: {type(error).__name__} {error}"
    return None


def numbers(folder: Path) -> dict[str, bytes]:
    """All that a command computed, without times and names."""
    found: dict[str, bytes] = {}
    for path in sorted(folder.rglob("*")):
        name = str(path.relative_to(folder))
        if path.suffix == ".nc":
            data = xarray.load_dataset(path, engine="scipy")
            for key in data.variables:
                if data[key].dtype.kind == "f" and key != "seconds":
                    found[f"{name} {key}"] = data[key].values.tobytes()
        elif path.suffix == ".npz":
            with np.load(path) as archive:
                kept = [key for key in archive.files if key not in ("header", "about")]  # texts with times
                found |= {f"{name} {key}": archive[key].tobytes() for key in kept}
        elif path.suffix in (".vtu", ".pvd", ".npy") or path.name == "curve.csv":
            found[name] = path.read_bytes()
        elif path.name == "fit.json":
            fit = json.loads(path.read_text())
            kept = ("estimate", "prediction", "standard_error", "interval_95", "status")
            found[name] = json.dumps({key: fit[key] for key in kept if key in fit}).encode()
        elif path.name == "run.json":
            found[name] = json.loads(path.read_text())["status"].encode()
    return found


def consistent(folder: Path) -> str | None:
    """What a result says that is not so."""
    if not (folder / "run.json").exists():
        return None
    status = json.loads((folder / "run.json").read_text())["status"]
    if status == "finished" and not (folder / "curve.nc").exists():
        return f"{folder}: finished without a curve"
    return None


def trial(bench: Bench, name: str, number: int, rng: random.Random, problems: list[str]) -> str:
    """One kill; a word for what came of it."""
    folder = bench.root / "killed" / f"{name}-{number}"
    bench.prepare(name, folder)
    first, *ways = COMMANDS[name](bench, folder)
    after = bench.seconds[name] * rng.uniform(0.25, 1.0)
    if not bench.killed(first, after):
        bench.seconds[name] = after
        shutil.rmtree(folder)
        return "had ended"
    visible = [path for path in folder.rglob("*") if path.is_file() and not path.name.startswith(".axijax-")]
    problems += [found for found in map(broken, visible) if found]
    problems += [found for found in [consistent(folder)] if found]
    problems += [f"{folder}: process {process} left behind" for process in bench.left_behind(bench.last)]
    left = [path for path in folder.rglob(".axijax-*")]
    how = ""
    for way in ways:
        started = time.monotonic()
        code, told = bench.call(way)
        if code == 0:
            how = ("started again" if way[0] == "run" else "went on") + (", leftovers removed" if left else "")
            if way == first:
                bench.seconds[name] = min(bench.seconds[name], time.monotonic() - started)
            break
        if "Traceback" in told:
            problems.append(f"{folder}: {told}")
    else:
        problems.append(f"{folder}: no way on: {told}")
        return "no way on"
    problems += [f"{path}: left over" for path in folder.rglob(".axijax-*")]
    problems += [f"{folder / file}: lost" for file, text in MINE.items() if (folder / file).read_text() != text]
    sound, found = numbers(bench.root / "sound" / name), numbers(folder)
    different = sorted(key for key in sound.keys() | found.keys() if sound.get(key) != found.get(key))
    if different:
        problems.append(f"{folder}: {', '.join(different[:5])} of {len(different)} differ")
    else:
        shutil.rmtree(folder)
    return how + (", same bits" if not different else ", OTHER BITS")


def main(kills: int = 64, seed: int = 0, root: str = "", only: str = "") -> int:
    for name in set(COMMANDS) - set(filter(None, only.split(","))) if only else ():
        del COMMANDS[name]
    folder = Path(root or tempfile.mkdtemp(prefix="axijax-kills-")).absolute()
    for part in ("sound", "killed"):  # the cache stays
        shutil.rmtree(folder / part, ignore_errors=True)
        (folder / part).mkdir(parents=True)
    bench, rng, problems = Bench(folder), random.Random(seed), []
    counts: dict[str, Counter] = {name: Counter() for name in COMMANDS}
    # table1 takes long: it gets three kills, the others share the rest; a command that had ended is killed once more.
    others = len(COMMANDS) - ("table1" in COMMANDS)
    share = -(-(kills - 3 * ("table1" in COMMANDS)) // max(others, 1))
    wanted = {name: 3 if name == "table1" else share for name in COMMANDS}
    for number in itertools.count():
        due = [name for name in COMMANDS if sum(counts[name].values()) - counts[name]["had ended"] < wanted[name]]
        if not due:
            break
        for name in due:
            word = trial(bench, name, number, rng, problems)
            counts[name].update([word])
            print(f"{name} {number}: {word}", flush=True)
    for name, count in counts.items():
        print(f"{name}: " + "; ".join(f"{times} {word}" for word, times in count.items()), flush=True)
    killed = sum(sum(count.values()) - count["had ended"] for count in counts.values())
    same = sum(value for count in counts.values() for word, value in count.items() if "same bits" in word)
    print(f"{killed} kills, {same} ended with the same bits, {len(problems)} problems", flush=True)
    print("\n".join(problems))
    return int(bool(problems))


if __name__ == "__main__":
    given = sys.argv[1:]
    sys.exit(main(*(convert(value) for convert, value in zip((int, int, str, str), given, strict=False))))
