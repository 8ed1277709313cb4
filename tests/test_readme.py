"""Every Python block of the README runs, one after another as a reader would paste them."""

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).parents[1]


def test_code_blocks_run_in_order(tmp_path):
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)
    assert len(blocks) >= 2
    result = subprocess.run(
        [sys.executable, "-c", "import matplotlib; matplotlib.use('Agg')\n" + "\n".join(blocks)],
        capture_output=True, text=True, cwd=tmp_path, timeout=300,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
    assert "peak stress ratio 2.46" in result.stdout
    slope = float(re.search(r"d friction ([0-9.]+)", result.stdout).group(1))
    assert 4.9 < slope < 5.7
    assert (tmp_path / "curve.png").stat().st_size > 5000


def test_ci_runs_the_readmes_test_command():
    command = re.search(r"```sh\n(.*pytest)\n```", (ROOT / "README.md").read_text()).group(1)
    assert command in (ROOT / ".ci" / "run").read_text()
