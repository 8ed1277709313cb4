"""A batch run by executors: what comes back is what this process finds, to the last bit, with a worker killed too."""

import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from cli_in_process import axijax as command

from axijax import Params, Sector, TriaxialTest, fcc_octagon
from axijax.app.executors import open_executor
from axijax.batch import Member, open_batch, parameter_grid, run_batch
from axijax.triaxial.records import records_of
from axijax.triaxial.stage_types import stage

# In a stage, which must reach the other process as a test does.
TEST = TriaxialTest(
    fcc_octagon(layers=3, half_width=3),
    Sector(4),
    params=Params(platen_speed=0.05),
    stages=(stage("compression", lateral="constant_volume", axial_strain=2e-3),),
    tolerance=1e-3,
)
FRICTIONS = [0.1, 0.2, 0.3]


@pytest.fixture(scope="module")
def here():
    return run_batch(parameter_grid(TEST, friction=FRICTIONS)).curves


def same(stored, curves):
    assert list(stored.member.values) == list(curves)
    for name, curve in curves.items():
        for field in records_of(curve):
            found = stored[field].sel(member=name).values[: curve.stress_ratio.size]
            np.testing.assert_array_equal(found, getattr(curve, field), err_msg=field)


def test_a_pool_of_processes(here, tmp_path):
    """One member fails, which is said as ever; a process that is killed breaks the pool, and the folder goes on."""
    late = Member("bad", TEST, replace(TEST.params, friction=-1.0))
    with open_executor("processes:1") as pool:
        members = parameter_grid(TEST, friction=FRICTIONS[:1])
        result = run_batch([*members, late], tmp_path, executor=pool)
        assert list(result.failures) == ["bad"] and "friction = -1" in result.failures["bad"]
        os.kill(next(iter(pool._processes)), signal.SIGKILL)
        with pytest.raises(RuntimeError, match="run it again"):
            run_batch(parameter_grid(TEST, friction=FRICTIONS), tmp_path, executor=pool)
    again = run_batch(parameter_grid(TEST, friction=FRICTIONS), tmp_path)
    assert [outcome.resumed for outcome in again.outcomes] == [True, False, False]
    same(open_batch(tmp_path), here)


def test_workers_end_with_the_process_that_is_killed(tmp_path):
    """They would wait for ever for further work, each with its memory."""
    script = tmp_path / "asks.py"
    script.write_text(
        "import os, time\nfrom axijax.app.executors import open_executor\n"
        "if __name__ == '__main__':\n    with open_executor('processes:1') as pool:\n"
        "        print(pool.submit(os.getpid).result(), flush=True)\n        time.sleep(600)\n"
    )
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as asking:
        worker = int(asking.stdout.readline())
        os.kill(worker, 0)
        asking.kill()
    for _ in range(600):
        try:
            if Path(f"/proc/{worker}/stat").read_text().rpartition(")")[2].split()[0] == "Z":
                return  # ended; whoever takes on orphans has not looked yet
            time.sleep(0.1)
        except OSError:
            return
    os.kill(worker, signal.SIGKILL)
    pytest.fail("a worker was left behind")


def test_dask_does_the_work_of_a_killed_worker_again(here, tmp_path):
    """A scheduler and two worker processes on this machine; one is killed while it computes."""
    distributed = pytest.importorskip("distributed")
    with (
        distributed.LocalCluster(
            2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1", memory_limit=0
        ) as cluster,
        open_executor(f"dask://{cluster.scheduler_address.removeprefix('tcp://')}") as executor,
    ):
        first = next(iter(cluster.workers.values()))
        done = []

        def kill_after_one(outcome):
            if not done:
                os.kill(first.pid, signal.SIGKILL)
            done.append(outcome.member.name)

        members = parameter_grid(TEST, friction=FRICTIONS)
        result = run_batch(members, tmp_path, finished=kill_after_one, executor=executor)
    assert not result.failures and sorted(done) == sorted(here)
    same(open_batch(tmp_path), here)


@pytest.mark.parametrize("asked", ["thread", "processes:0", "processes:x", "dask", "dask://here", ""])
def test_an_executor_that_is_none_is_refused(asked):
    with pytest.raises(ValueError, match=r"must be 'processes'"), open_executor(asked):
        pass


def test_the_command_line_refuses_what_does_nothing(tmp_path):
    sweep = tmp_path / "sweep.toml"
    sweep.write_text("[specimen]\nlayers = 3\nhalf_width = 3\n[sweep]\nparameters.friction = [0.1]\n")
    both = command("batch", sweep, "--workers", 2, "--executor", "processes")
    assert both.code == 1 and "processes:4" in both.err
    nobody = command("batch", sweep, "--output", tmp_path / "out", "--executor", "dask://127.0.0.1:9")
    assert nobody.code == 1 and "no Dask scheduler answers" in nobody.err and "Traceback" not in nobody.err
