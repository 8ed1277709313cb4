"""How JAX compiles: fast CPU kernels, the cache of compiled programs, and a warning where a batch would be slow.

Nothing here runs unless it is called.
"""

import contextlib
import hashlib
import os
import platform
import time
import warnings
from pathlib import Path

import jax
from jax.extend.core import Primitive
from jax.interpreters import ad, batching, mlir

FUSION_OPTION = "xla_cpu_use_multi_output_fusion"
CACHE_VARIABLE = "AXIJAX_CACHE"
CACHE_BYTES = 512 * 2**20  # a test's programs take a third of a megabyte; the oldest go where there is more than this
CHECKED = ".checked"  # a file as old as the last look for damaged programs
CACHED_SECONDS = 0.05  # programs that compile faster than this are not worth a file


def fast_cpu_kernels() -> bool:
    """Let XLA's CPU compiler make all results of a contact in one loop: four to five times as many ball-steps a second.

    Call it before the first JAX computation of the process; returns whether it took effect. The command line calls it
    by itself. It acts on every program of the process, and in the XLA of jax 0.10 it has a defect: a program that adds
    into one-dimensional arrays by index (two `jax.ops.segment_sum`, or `jax.grad` through `x[index]`) may end the
    process while it is compiled. Nothing of this package does that, in reverse mode neither. A program of your own that
    does is compiled without it by `jax.jit(f, compiler_options=axijax.plain_cpu_kernels())`.
    """
    from jax._src import xla_bridge

    flags = os.environ.get("XLA_FLAGS", "")
    if FUSION_OPTION in flags:
        return True
    if xla_bridge.backends_are_initialized():
        return False
    os.environ["XLA_FLAGS"] = f"{flags} --xla_backend_extra_options={FUSION_OPTION}=true".strip()
    return True


def plain_cpu_kernels() -> dict[str, str]:
    """For `jax.jit(..., compiler_options=...)`: compiled as if the fast kernels were off.

    There is no option for a single program that switches them on: XLA refuses `xla_backend_extra_options` there, in
    jax 0.10.
    """
    return {"xla_disable_hlo_passes": "cpu_multi_output_fusion"}


def warn_where_slow() -> None:
    """Warn, once a process, that it steps a specimen on a CPU without the fast kernels."""
    global _warned_of_slowness
    if _warned_of_slowness or FUSION_OPTION in os.environ.get("XLA_FLAGS", "") or jax.default_backend() != "cpu":
        return
    _warned_of_slowness = True
    warnings.warn(
        "this process steps a specimen four to ten times slower than it could: call axijax.fast_cpu_kernels() before "
        "its first JAX computation.",
        stacklevel=2,
    )


_warned_of_slowness = False


def use_compilation_cache(path: Path | str | None = None) -> Path | None:
    """Keep compiled programs on disk, so that the next process need not compile them; the folder, or None if off.

    The command line calls it by itself. Folder: `path`, or else the environment's AXIJAX_CACHE ("off" or "0" switches
    the cache off), or else `axijax` in the user's cache folder (XDG_CACHE_HOME or ~/.cache). A cache that the process
    has already been given (JAX_COMPILATION_CACHE_DIR) is left alone. A folder that cannot be written is a warning,
    never an error. Programs compiled with other XLA flags, other versions of jax or for another processor are kept
    apart: the first two are part of JAX's key, processors have a folder each. Of several `jax.distributed` processes
    only the first writes. Import axijax before jax, or XLA prints a long false alarm for every program that it reads.
    """
    asked = os.environ.get(CACHE_VARIABLE, "") if path is None else str(path)
    if asked.lower() in ("0", "off", "no", "false"):
        return None
    given = jax.config.values["jax_compilation_cache_dir"]
    if path is None and given:
        return Path(given)
    try:
        home = Path(os.environ.get("XDG_CACHE_HOME") or Path("~").expanduser() / ".cache")
        folder = (Path(asked).expanduser() if asked else home / "axijax") / _processor()
    except RuntimeError:  # a user without a home
        warnings.warn(
            f"no compilation cache: this user has no home folder; set {CACHE_VARIABLE} to a folder, or to 'off'.",
            stacklevel=2,
        )
        return None
    try:
        folder.mkdir(parents=True, exist_ok=True)
        _prune(folder)
        _remove_damaged(folder)
        if not os.access(folder, os.W_OK | os.X_OK):
            raise PermissionError(13, "Permission denied")
    except OSError as error:
        warnings.warn(
            f"no compilation cache: folder '{folder}' cannot be written ({error.strerror}); set {CACHE_VARIABLE} to "
            "another folder, or to 'off'.",
            stacklevel=2,
        )
        return None
    jax.config.update("jax_compilation_cache_dir", str(folder))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", CACHED_SECONDS)
    return folder


def _processor() -> str:
    """A name for what this processor can run: a compiled program may use instructions that another one lacks."""
    about = platform.machine() + platform.processor()
    with contextlib.suppress(OSError, StopIteration):
        about += next(line for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("flags"))
    return f"{platform.machine()}-{hashlib.sha256(about.encode()).hexdigest()[:8]}"


def _prune(folder: Path) -> None:
    """Remove the oldest programs where there is too much, half of the room at once."""
    files = [(file.stat(), file) for file in folder.glob("*-cache")]
    total = sum(about.st_size for about, _ in files)
    if total > CACHE_BYTES:
        for about, file in sorted(files, key=lambda item: item[0].st_mtime):
            file.unlink(missing_ok=True)
            total -= about.st_size
            if total < CACHE_BYTES / 2:
                break


def _remove_damaged(folder: Path) -> None:
    """Remove programs that were cut short while they were written; JAX would warn of them for ever and replace none.

    Only what is new since the last look is read: a program is written once.
    """
    mark = folder / CHECKED
    last = mark.stat().st_mtime if mark.exists() else 0.0
    now = time.time()
    for file in folder.glob("*-cache"):
        with contextlib.suppress(OSError):  # another process has removed it
            if file.stat().st_mtime > last - 2 and not _is_whole(file.read_bytes()):
                file.unlink()
    mark.touch()
    os.utime(mark, (now, now))


def _is_whole(program: bytes) -> bool:
    from jax._src.compilation_cache import decompress_executable

    try:
        return len(decompress_executable(program)) > 0
    except Exception:  # each of the packages that JAX compresses with has its own
        return False


def require_64_bits() -> None:
    """Raise ValueError where JAX has been switched to 32 bits since axijax was imported, as other libraries do.

    Platens move by less than a float32 can tell: no test would find its balance.
    """
    if not jax.config.values["jax_enable_x64"]:
        raise ValueError(
            "JAX's 64-bit numbers are switched off (jax_enable_x64), though importing axijax switches them on: another "
            'library or line of this program did it; call jax.config.update("jax_enable_x64", True) before the test.'
        )


def warn_where_batched(tree):
    """The same tree; where `jax.vmap` puts a batch axis on one of its leaves on a CPU, a warning at trace time.

    It sees through jit, jvp and grad. Tangents pass by it: a vmap over directions alone, which is fast, is not warned
    of.
    """
    leaves, structure = jax.tree.flatten(tree)
    return jax.tree.unflatten(structure, _seen.bind(*leaves))


def _batched(values, axes):
    if jax.default_backend() == "cpu":
        warnings.warn(
            "jax.vmap over the parameters of a test is slower on a CPU than one test after another (two to ten times): "
            "use axijax.batch.simulate_many(test, params), which is differentiable too, or axijax.batch.run_batch.",
            stacklevel=2,
        )
    return _seen.bind(*values), axes


_seen = Primitive("axijax_parameters")  # the identity
_seen.multiple_results = True
_seen.def_impl(lambda *values: list(values))
_seen.def_abstract_eval(lambda *values: list(values))
ad.primitive_jvps[_seen] = lambda primals, tangents: (_seen.bind(*primals), list(tangents))
batching.primitive_batchers[_seen] = _batched
mlir.register_lowering(_seen, lambda _context, *values: list(values))


def make_room_for_programs(most: int = 20_000) -> None:
    """Forget what has been compiled where it fills a good part of the 65,000 pieces of memory that a process may map
    (Linux), since the program that finds none left ends the process. For loops over many specimens."""
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > most:
        jax.clear_caches()
