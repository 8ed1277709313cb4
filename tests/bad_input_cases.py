"""The table of `test_bad_inputs_cli`: what is given, how, and the words that the sentence must hold."""

import shutil
from pathlib import Path

import numpy as np
from bad_input_ways import (
    array,
    cut_short,
    edited,
    info,
    nothing,
    on_a_copy,
    packed,
    run,
    run_into,
    small,
    status,
    without,
)  # fmt: skip
from cli_in_process import write

SWEPT = ("friction", "damping_ratio", "local_damping")

# What is given; how; the words that the sentence must hold. Exit code 1, or 2 for the command line itself.
CASES = {
    # Case files.
    "case file that is not there": (
        lambda folder, _: ("run", folder / "no.toml"),
        ["no.toml", "cannot be read", "No such"],
    ),
    "folder for a case file": (lambda folder, _: ("run", folder), ["cannot be read", "directory"]),
    "picture for a case file": (
        lambda folder, _: ((folder / "a.png").write_bytes(b"\x89PNG\r\n\x1a\n\xff\x00"), "run", folder / "a.png")[1:],
        ["a.png", "not valid TOML"],
    ),
    "[sector without its bracket": (run("[sector\norder = 4"), ["not valid TOML", "line 1"]),
    "one field twice": (run("[sector]\norder = 4\norder = 2"), ["not valid TOML", "overwrite"]),
    "parameters.fricton": (run("[parameters]\nfricton = 0.1"), ["parameters.fricton", "did you mean 'friction'"]),
    "section [parameter]": (run("[parameter]\nfriction = 0.1"), ["'parameter'", "did you mean 'parameters'"]),
    "friction in [test]": (run("[test]\nfriction = 0.1"), ["test.friction", "[scene] or [parameters]"]),
    "parameters.gravity": (run("[parameters]\ngravity = 9.81"), ["parameters.gravity", "known are friction, "]),
    "sector = 4": (run("sector = 4"), ["sector = 4", "[sector]"]),
    "parameters.friction = -0.1": (run("[parameters]\nfriction = -0.1"), ["-0.1", "greater than or equal to 0"]),
    "parameters.friction = nan": (run("[parameters]\nfriction = nan"), ["friction = nan", "finite"]),
    "parameters.friction = 'much'": (run("[parameters]\nfriction = 'much'"), ["'much'", "number"]),
    "parameters.friction = true": (run("[parameters]\nfriction = true"), ["friction = true", "number"]),
    "parameters.friction = [0.1, 0.2]": (run("[parameters]\nfriction = [0.1, 0.2]"), ["[0.1, 0.2]", "number"]),
    "parameters.normal_stiffness = 0": (run("[parameters]\nnormal_stiffness = 0"), ["= 0", "greater than 0"]),
    "parameters.density = inf": (run("[parameters]\ndensity = inf"), ["density = inf", "finite"]),
    "parameters.platen_speed = -0.01": (run("[parameters]\nplaten_speed = -0.01"), ["-0.01", "greater than 0"]),
    "parameters.local_damping = 1": (run("[parameters]\nlocal_damping = 1"), ["local_damping", "less than 1"]),
    "local damping where dashpots damp": (
        run("[parameters]\nlocal_damping = 0.5"),
        ["parameters.local_damping = 0.5 would do nothing", "damping = 'dashpot'", "leave it out"],
    ),
    "parameters.poisson_ratio = 0.5": (run("[parameters]\npoisson_ratio = 0.5"), ["poisson_ratio", "less than 0.5"]),
    "scene.damping = 'viscous'": (run("[scene]\ndamping = 'viscous'"), ["'viscous'", "'dashpot'"]),
    "scene.rotation = 1": (run("[scene]\nrotation = 1"), ["rotation = 1", "true or false"]),
    "sector.order = 0": (run("[sector]\norder = 0"), ["order = 0", "greater than or equal to 1"]),
    "sector.order = 2.5": (run("[sector]\norder = 2.5"), ["order = 2.5", "whole number"]),
    "sector.boundary = 'periodical'": (run("[sector]\nboundary = 'periodical'"), ["did you mean 'periodic'"]),
    "specimen.kind = 'octogon'": (run("[specimen]\nkind = 'octogon'"), ["'octogon'", "did you mean 'octagon'"]),
    "half_width of a cylinder": (
        run("[specimen]\nkind = 'fcc'\nhalf_width = 9"),
        ["half_width", "'fcc'", "specimen_radius"],
    ),
    "test.axial_strain = 70": (run("[test]\naxial_strain = 70"), ["axial_strain = 70", "less than 0.5"]),
    "half_width = 99999": (run("[specimen]\nhalf_width = 99999"), ["half_width = 99999", "equal to 1001"]),
    "more balls than anybody has": (
        run("[specimen]\nhalf_width = 999\nlayers = 9999"),
        ["9999 layers", "8.3e+09 balls", "200,000"],
    ),
    "a cylinder of tiny balls": (
        run("[specimen]\nkind = 'fcc'\nradius = 0.01"),
        ["9.1e+09 balls", "200,000", "larger radius"],
    ),
    "an integer of 20 digits": (run(f"[test]\nrecord_every = {10**20}"), [f"record_every = {10**20}", "1000000"]),
    "an integer of 5000 digits": (run(f"[test]\nrecord_every = 1{'0' * 5000}"), ["case.toml", "thousands of digits"]),
    "a name of 5000 characters": (run(f"[test]\n{'x' * 5000} = 1"), ["test.xxx", "known are"]),
    "brackets 5000 deep": (run(f"x = {'[' * 5000}"), ["case.toml"]),
    "friction of 1e-300": (run("[parameters]\nfriction = 1e-300"), ["friction = 1e-300", "1e-30 and 1e+30"]),
    "platens that take a lifetime": (run("[parameters]\nplaten_speed = 1e-20"), ["steps", "raise platen_speed"]),
    "a file without an end": (lambda folder, _: ("run", "/dev/zero"), ["/dev/zero", "larger than", "no case file"]),
    "a sweep of a million million": (
        lambda folder, _: (
            "batch",
            write(folder / "s.toml", "[sweep.parameters]\n" + "\n".join(f"{n} = {[0.1] * 10**4}" for n in SWEPT)),
        ),
        ["s.toml", "1,000,000,000,000 tests", "10,000"],
    ),
    "two mistakes at once": (
        run("[sector]\norder = 0\n[test]\naxial_strain = 2"),
        ["sector.order = 0", "test.axial_strain = 2"],
    ),
    # Fields that are right alone and wrong together; physics.
    "a third of the FCC octagon": (run("[sector]\norder = 3"), ["order = 3", "not the same after a turn", "1, 2 or 4"]),
    "rigid planes of a half": (run("[sector]\norder = 2\nboundary = 'rigid'"), ["order = 2", "must be >= 3"]),
    "rigid planes that nothing fits between": (
        run("[sector]\norder = 40\nboundary = 'rigid'"),
        ["order = 40", "no ball"],
    ),
    "specimen.half_width = 4": (run("[specimen]\nhalf_width = 4"), ["half_width = 4", "odd"]),
    "cylinder thinner than its balls": (
        run("[specimen]\nkind = 'fcc'\nspecimen_radius = 30"),
        ["specimen_radius = 30", "60"],
    ),
    "time step past the critical one": (run("[test]\ntime_step = 0.06"), ["time_step = 0.06", "critical time step"]),
    "confinement in 50 steps": (
        small(("[test]", "[test]\nconfine_steps = 50")),
        ["confinement did not reach", "raise confine_steps"],
    ),
    "platens that cross the specimen in two seconds": (
        small(("platen_speed = 0.01", "platen_speed = 25.0")),
        ["membrane's balls moved past one another", "lower platen_speed"],
    ),
    # Random specimens and Hertzian contacts.
    "41 random balls in four sectors": (packed("balls = 41"), ["balls = 41", "multiple", "order 4"]),
    "20 random balls in four sectors": (packed("balls = 20"), ["balls = 20", "at least 40"]),
    "random radii the wrong way round": (
        packed("smallest_radius = 30"),
        ["specimen.smallest_radius = 30", "largest_radius = 24", "must not be above"],
    ),
    "layers of a random specimen": (packed("layers = 5"), ["layers", "'random'", "void_ratio"]),
    "specimen.compaction_friction = 2": (packed("compaction_friction = 2"), ["compaction_friction = 2", "equal to 1"]),
    "specimen.void_ratio = 0": (packed("void_ratio = 0"), ["void_ratio = 0", "greater than 0"]),
    "void ratio of foam": (
        packed("balls = 40\nvoid_ratio = 9"),
        ["void_ratio = 9", "reach 0.5000", "ask for one between"],
    ),
    "sieve curve that is not there": (packed("grading = 'sieves.csv'"), ["sieves.csv", "cannot be read"]),
    "sieve curve that stops at 90 %": (
        lambda folder, _: (
            write(folder / "sieves.csv", "opening,passing\n30,0\n50,90\n"),
            *packed("grading = 'sieves.csv'")(folder, _),
        )[1:],
        ["sieves.csv", "0 to 90 % passing"],
    ),
    "sieve curve with a word in it": (
        lambda folder, _: (
            write(folder / "sieves.csv", "opening,passing\n30,none\n50,100\n"),
            *packed("grading = 'sieves.csv'")(folder, _),
        )[1:],
        ["sieves.csv", "line 2", "30,none", "two numbers"],
    ),
    "scene.contact_law = 'hertzian'": (run("[scene]\ncontact_law = 'hertzian'"), ["did you mean 'hertz'"]),
    "parameters.shear_modulus = -1": (
        run("[parameters]\nshear_modulus = -1"),
        ["shear_modulus = -1", "greater than 0"],
    ),
    "Hertz, and a step past the critical one": (
        run("[scene]\ncontact_law = 'hertz'\n[test]\ntime_step = 1.0"),
        ["time_step = 1", "critical time step"],
    ),
    # Where a result is to go.
    "output that is a file": (
        run_into(lambda out, _: out.write_text("mine")),
        ["out'", "cannot be written", "--output"],
    ),
    "output inside a file": (
        lambda folder, _: ("run", write(folder / "case.toml"), "--output", folder / "case.toml" / "out"),
        ["cannot be written", "--output"],
    ),
    "output where nobody may write": (
        lambda folder, _: ("run", write(folder / "case.toml"), "--output", "/proc/out"),
        ["/proc/out", "cannot be written"],
    ),
    "output that holds a finished result": (
        run_into(lambda out, finished: shutil.copytree(finished, out)),
        ["holds a finished result", "--overwrite"],
    ),
    "output that holds an interrupted run": (
        run_into(lambda out, finished: status("interrupted")(Path(shutil.copytree(finished, out)))),
        ["unfinished run", "axijax resume"],
    ),
    "output that holds a curve of another program": (
        run_into(lambda out, _: (out.mkdir(), (out / "curve.csv").write_text("mine"))),
        ["holds curve.csv", "--overwrite"],
    ),
    # Going on.
    "resume what is not there": (lambda folder, _: ("resume", folder / "none"), ["no result", "run.json"]),
    "resume an empty folder": (lambda folder, _: ("resume", folder), ["no result", "run.json"]),
    "resume with half a run.json": (on_a_copy(cut_short("run.json"), "resume"), ["run.json is damaged"]),
    "resume with a list for run.json": (
        on_a_copy(lambda out: (out / "run.json").write_text("[1]"), "resume"),
        ["run.json is damaged"],
    ),
    "resume without its case": (on_a_copy(without("case.toml"), "resume"), ["case.toml", "cannot be read"]),
    "resume what is finished": (on_a_copy(nothing, "resume"), ["is finished", "--axial-strain"]),
    "resume to less than there is": (
        on_a_copy(nothing, "resume", "--axial-strain", "0.005"),
        ["is finished at axial_strain = 0.012", "larger"],
    ),
    "resume to 80 % strain": (on_a_copy(nothing, "resume", "--axial-strain", "0.8"), ["0.8", "between 0 and 0.5"]),
    "resume what failed": (on_a_copy(status("failed"), "resume"), ["failed (it went wrong)", "would again"]),
    "resume without a checkpoint": (
        on_a_copy(without("checkpoint.npz"), "resume", "--axial-strain", "0.02"),
        ["checkpoint.npz", "run the case again"],
    ),
    "resume with half a checkpoint": (
        on_a_copy(cut_short("checkpoint.npz"), "resume", "--axial-strain", "0.02"),
        ["damaged or no checkpoint"],
    ),
    "resume with friction changed": (
        on_a_copy(edited("case.toml", "\nfriction = 0.12278", "\nfriction = 0.2"), "resume", "--axial-strain", "0.02"),
        ["parameters.friction = 0.2", "0.12278"],
    ),
    "resume with tolerance changed": (
        on_a_copy(edited("case.toml", "\ntolerance = 1e-5", "\ntolerance = 1e-6"), "resume", "--axial-strain", "0.02"),
        ["tolerance", "of another test"],
    ),
    "resume with confining_friction changed": (
        on_a_copy(
            edited("case.toml", "\n# confining_friction =\n", "\nconfining_friction = 0.1\n"),
            "resume",
            "--axial-strain",
            "0.02",
        ),
        ["confining_friction", "of another test"],
    ),
    "resume with seconds in words": (on_a_copy(info(seconds="ten"), "resume"), ["'seconds' must be a number"]),
    "resume with a list for a name": (on_a_copy(info(name=[1]), "resume"), ["'name' must be a text"]),
    "resume with a strain that is true": (on_a_copy(info(axial_strain=True), "resume"), ["'axial_strain' must be"]),
    "resume with a strain that is no number": (
        on_a_copy(info(axial_strain=float("nan")), "resume"),
        ["'axial_strain' must be a strain"],
    ),
    "resume with a million million snapshots": (on_a_copy(info(snapshots=10**12), "resume"), ["'snapshots' must be"]),
    "resume with a count of 1.5": (on_a_copy(info(resumed=1.5), "resume"), ["'resumed' must be a whole number"]),
    "check with a status that is a list": (on_a_copy(info(status=["finished"]), "check"), ["'status' must be one of"]),
    "resume with shapes of another test": (
        on_a_copy(array("state.velocity.x", np.zeros(5)), "resume", "--axial-strain", "0.02"),
        ["'state.velocity.x' has shape (5,)"],
    ),
    "resume with a contact of a ball that is not": (
        on_a_copy(array("network.first", np.full(88, 26, np.int32)), "resume", "--axial-strain", "0.02"),
        ["'network.first' points to what does not exist"],
    ),
    "resume with NaN": (
        on_a_copy(array("state.platens", np.full(2, np.nan)), "resume", "--axial-strain", "0.02"),
        ["'state.platens' holds numbers that are not finite"],
    ),
    "resume with platens beyond each other": (
        on_a_copy(array("state.platens", np.array([152.0, 1.0])), "resume", "--axial-strain", "0.02"),
        ["platens are where no shear moves them"],
    ),
    "check with whole numbers for places": (
        on_a_copy(array("network.positions.x", np.arange(26)), "check"),
        ["'network.positions.x' holds int64 where the test has float64"],
    ),
    "resume with the specimen changed": (
        on_a_copy(edited("case.toml", "layers = 5", "layers = 7"), "resume", "--axial-strain", "0.02"),
        ["of another test", "specimen"],
    ),
    # Results.
    "check half a curve": (on_a_copy(cut_short("curve.nc"), "check"), ["curve.nc", "damaged"]),
    "check half a run.json": (on_a_copy(cut_short("run.json"), "check"), ["run.json", "damaged"]),
    "check another case's checkpoint": (
        on_a_copy(edited("case.toml", "layers = 5", "layers = 7"), "check"),
        ["of another test", "specimen"],
    ),
    "check what is not there": (lambda folder, _: ("check", folder / "none"), ["none", "cannot be read"]),
    # New case files, measured data, the command line.
    "new of sand": (lambda folder, _: ("new", "--kind", "sand", folder / "a.toml"), ["'sand'", "octagon, fcc"]),
    "new where a file is": (lambda folder, _: ("new", write(folder / "a.toml")), ["a.toml' exists", "--overwrite"]),
    "new in no folder": (lambda folder, _: ("new", folder / "none" / "a.toml"), ["cannot be written", "another place"]),
    "calibrate without data": (lambda folder, _: ("calibrate", folder / "no.csv"), ["no.csv"]),
    "axijax rnu": (lambda folder, _: ("rnu",), ["No such command 'rnu'", "run"]),
    "axijax run": (lambda folder, _: ("run",), ["Missing argument"]),
    "--outptu": (lambda folder, _: ("run", folder / "a.toml", "--outptu", "out"), ["--outptu", "--output"]),
    "--axial-strain much": (lambda folder, _: ("resume", folder, "--axial-strain", "much"), ["--axial-strain", "much"]),
    "--snapshots -1": (lambda folder, _: ("run", folder / "a.toml", "--snapshots", "-1"), ["--snapshots", "-1"]),
    "--full alone": (lambda folder, _: ("run", write(folder / "a.toml"), "--full"), ["--full", "add --snapshots"]),
}
USAGE = ("axijax rnu", "axijax run", "--outptu", "--axial-strain much", "--snapshots -1")
