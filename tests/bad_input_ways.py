"""Ways to give a command something that makes no sense.

Each returns a function that makes what it needs in a folder and returns the command's arguments.
"""

import json
import shutil

import numpy as np
from cli_in_process import SMALL, write


def run(text, *options):
    """Run a case file with this text."""

    def arguments(folder, _):
        return "run", write(folder / "case.toml", text), "--output", folder / "out", *options

    return arguments


def packed(text):
    """Run a random case with this text in its specimen."""
    return run(f"[specimen]\nkind = 'random'\n{text}\n")


def small(*changes):
    """The small case with some lines changed."""
    text = SMALL
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    return run(text)


def on_a_copy(damage, *command):
    """A command on a copy of a finished result that was damaged."""

    def arguments(folder, finished):
        shutil.copytree(finished, folder / "out")
        damage(folder / "out")
        return *command, folder / "out"

    return arguments


def run_into(make):
    """Run the small case into a folder that is not as it should be."""

    def arguments(folder, finished):
        make(folder / "out", finished)
        return "run", write(folder / "case.toml"), "--output", folder / "out"

    return arguments


def info(**changes):
    """Let run.json say something else."""

    def change(folder):
        path = folder / "run.json"
        path.write_text(json.dumps({**json.loads(path.read_text()), **changes}))

    return change


def status(value):
    return info(status=value, message="it went wrong")


def array(name, values):
    """Another array in the checkpoint, checksum and all."""

    def change(folder):
        with np.load(folder / "checkpoint.npz") as archive:
            arrays = {**archive, name: values}
        np.savez(folder / "checkpoint.npz", **arrays)

    return change


def edited(name, old, new):
    def change(folder):
        text = (folder / name).read_text()
        assert old in text
        (folder / name).write_text(text.replace(old, new))

    return change


def cut_short(name):
    return lambda folder: (folder / name).write_bytes((folder / name).read_bytes()[:300])


def without(name):
    return lambda folder: (folder / name).unlink()


def nothing(folder):
    pass
