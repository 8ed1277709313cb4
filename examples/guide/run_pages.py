"""Runs what README and guide print: every shell and Python block, in order, as a reader would paste it.

    python examples/guide/run_pages.py                      # all pages
    python examples/guide/run_pages.py README.md units.md   # these, and those that they go on from

Each page has one plain bash of its own, at the top of a new clone of the last commit (what is not committed is not
seen). README sets up its environment itself, as printed; the others run in one that is set up once and activated, as
they say. A page that says "go on from [another](other.md)" is run in the shell that the other has left. Python blocks
that follow one another are pasted into one Python. Output is shown as it comes, at the end the seconds of each block,
and the exit code is 1 where one has failed.

A block whose first line is a comment that begins with "needs" or "takes", such as `# needs a GPU`, is skipped, and
named in the output with this reason.
"""

import argparse
import os
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

ROOT = Path(__file__).resolve().parents[2]
GUIDE = ROOT / "examples" / "guide"
README = ROOT / "README.md"
PAGES = (README, *sorted((ROOT / "examples").glob("*.md")), *sorted(GUIDE.glob("*.md")))
PAGES += (ROOT / ".github" / "CONTRIBUTING.md",)

# Variables that a plain shell keeps of the one that this is started from; paths into its environment go.
KEPT = ("HOME", "LANG", "LC_ALL", "TMPDIR", "PIP_", "SSL_", "REQUESTS_CA", "HTTP", "NO_PROXY", "http", "no_proxy")

# Blocks of Python, one after another in one interpreter, as at a prompt; all names are theirs.
PYTHON = """
import sys, time, types
report = sys.argv[1]
sys.modules["__main__"] = page = types.ModuleType("__main__")
for key, path in zip(sys.argv[2::2], sys.argv[3::2]):
    source = open(path, encoding="utf-8").read()
    print(f"\\n---- {key}\\n{source}----", flush=True)
    begin, status = time.time(), 1
    try:
        exec(compile(source, key, "exec"), vars(page))
        status = 0
    finally:
        sys.stdout.flush()
        with open(report, "a") as file:
            print(key, status, time.time() - begin, file=file)
"""

# Commands of a block in the page's own shell; one that fails does not end it, but the block has failed.
SHELL = """
printf '\\n---- %s\\n' {key}; cat {path}; echo ----
begin=$EPOCHREALTIME; failed=0
trap 'failed=1' ERR; . {path} < /dev/null; trap - ERR
echo {key} $failed "$begin $EPOCHREALTIME" >> {report}
"""


class Block(NamedTuple):
    """A block of a page: its first line there, its language and text."""

    page: Path
    line: int
    language: str
    text: str

    @property
    def name(self) -> str:
        return f"{self.page.name}:{self.line}"

    @property
    def skipped(self) -> str | None:
        """Why it is not run here, as the page says it to its reader; None where it is."""
        found = re.match(r"# ((?:needs|takes) .*)", self.text)
        return found[1] if found else None


class Done(NamedTuple):
    block: Block
    seconds: float | None  # None where it did not come to its end
    failed: bool


def blocks(page: Path, *languages: str) -> list[Block]:
    """Blocks of a page in these languages, by default those that are run; the one place that reads them."""
    text = page.read_text(encoding="utf-8")
    wanted = "|".join(languages or ("sh", "python"))
    return [
        Block(page, text[: found.start()].count("\n") + 2, found[1], found[2])
        for found in re.finditer(rf"^```({wanted})\n(.*?)^```", text, re.DOTALL | re.MULTILINE)
    ]


def goes_on_from(page: Path) -> Path | None:
    """The page in whose shell a page goes on, where it says so."""
    found = re.search(r"go on\s+from\s+\[[^\]]*\]\(([^)]+)\)", page.read_text(encoding="utf-8"))
    return (page.parent / found[1]).resolve() if found else None


def together(pages: Iterable[Path]) -> list[list[Path]]:
    """Pages that share a shell, in order, those that the given ones go on from among them."""
    groups: dict[Path, list[Path]] = {}
    for page in pages:
        chain = [page.resolve()]
        while (before := goes_on_from(chain[0])) is not None:
            chain.insert(0, before)
        group = groups.setdefault(chain[0], [])
        group += [each for each in chain if each not in group]
    return list(groups.values())


def run(pages: Sequence[Path], environment: Path | None, folder: Path) -> list[Done]:
    """Run the blocks of pages that share a shell, at the top of a new clone in `folder`."""
    clone = folder / pages[0].stem
    subprocess.run(["git", "clone", "-q", str(ROOT), str(clone)], check=True)
    report, parts = folder / f"{pages[0].stem}.report", folder / f"{pages[0].stem}.blocks"
    report.touch()
    parts.mkdir()
    script = [] if environment is None else [f". {shlex.quote(str(environment / 'bin' / 'activate'))}"]
    run_here, waiting = [], []

    def paste() -> None:
        """The Python blocks that follow one another."""
        if waiting:
            script.append(shlex.join(["python", "-c", PYTHON, str(report), *waiting]) + " < /dev/null")
            waiting.clear()

    for block in (block for page in pages for block in blocks(clone / page.relative_to(ROOT))):
        path = parts / block.name.replace(":", "-")
        path.write_text(block.text, encoding="utf-8")
        if block.skipped:
            paste()
            script.append(f"printf '\\n---- %s skipped: %s\\n' {block.name} {shlex.quote(block.skipped)}")
            continue
        run_here.append(block)
        if block.language == "python":
            waiting += [block.name, str(path)]
        else:
            paste()
            script.append(SHELL.format(key=block.name, path=shlex.quote(str(path)), report=shlex.quote(str(report))))
    paste()
    subprocess.run(
        ["bash", "--noprofile", "--norc", "-c", "\n".join(script)], cwd=clone, env=plain_shell(folder), check=False
    )
    told = {}
    for line in report.read_text().splitlines():
        key, status, *times = line.split()
        told[key] = status != "0", float(times[-1]) - (float(times[0]) if len(times) > 1 else 0)
    return [Done(block, *reversed(told.get(block.name, (True, None)))) for block in run_here]


def plain_shell(folder: Path) -> dict[str, str]:
    """Variables of a new user's shell, without the environment that this Python is of; caches and libraries are new."""
    own = Path(sys.prefix) / "bin"
    path = [each for each in os.environ.get("PATH", os.defpath).split(os.pathsep) if Path(each) != own]
    kept = {name: value for name, value in os.environ.items() if name.startswith(KEPT)}
    new = {"AXIJAX_CACHE": str(folder / "cache"), "AXIJAX_LIBRARY": str(folder / "library")}
    return {**kept, **new, "PATH": os.pathsep.join(path), "TERM": "dumb", "PYTHONUNBUFFERED": "1"}


def tell(done: Sequence[Done], skipped: Sequence[Block]) -> None:
    """A table of what was run and what was not."""
    print("\nblock, seconds")
    for block, seconds, failed in done:
        print(f"{block.name:28s} {'-' if seconds is None else f'{seconds:.1f}':>7s}{'  FAILED' if failed else ''}")
    for block in skipped:
        print(f"{block.name:28s}       -  skipped: {block.skipped}")
    failures = sum(each.failed for each in done)
    print(f"{len(done)} blocks, {failures} failed, {sum(each.seconds or 0 for each in done):.0f} s", flush=True)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("page", nargs="*", help="names of pages; left out: all that have blocks")
    parser.add_argument("--environment", type=Path, help="folder of a virtual environment for the guide's pages")
    asked = parser.parse_args()
    known = {page.name: page for page in reversed(PAGES) if page.name != "README.md" or page == README}
    if unknown := set(asked.page) - set(known):
        parser.error(f"no page {', '.join(sorted(unknown))}; known are {', '.join(known)}")
    pages = [known[name] for name in asked.page] if asked.page else [page for page in PAGES if blocks(page)]
    done: list[Done] = []
    with tempfile.TemporaryDirectory(prefix="axijax-pages-") as name:
        folder = Path(name)
        if asked.environment is None and set(pages) - {README}:
            print("---- an environment for the guide's pages", flush=True)
            asked.environment, clone = folder / "environment", folder / "installed"
            subprocess.run(["git", "clone", "-q", str(ROOT), str(clone)], check=True)
            shell = plain_shell(folder)
            subprocess.run(["python3", "-m", "venv", str(asked.environment)], check=True, env=shell)
            subprocess.run([str(asked.environment / "bin" / "pip"), "install", "-q", str(clone)], check=True, env=shell)
        for group in together(pages):
            done += run(group, None if group[0] == README else asked.environment.resolve(), folder)
        tell(done, [block for group in together(pages) for page in group for block in blocks(page) if block.skipped])
    return 1 if any(each.failed for each in done) else 0


if __name__ == "__main__":
    sys.exit(main())
