"""Compiled kernels on disk: what runs is always the source as it is."""

import contextlib
import os
import subprocess
import sys
import textwrap
import time
import types

import pytest

from tests.processes import python
from tracked_env.physics import kernel_cache

# A project of a user's own: formula, constant, template and kernel, each in a file of its own.
PROJECT = {
    "soil_law.py": """
        from tracked_env.physics.jit import formula
        from instruction import sum_with_zero
        from soil_constants import STIFFNESS, Soil

        @formula
        def force(sinkage):
            "Force of a spring."
            soil = Soil(STIFFNESS, 0.0)
            spring = sum_with_zero(soil.stiffness * sinkage) - 2.0 * soil.damping
            return spring + (sinkage * 1 - sinkage) * 23
        """,
    "soil_constants.py": """
        from typing import NamedTuple

        STIFFNESS = 3.0

        class Soil(NamedTuple):
            stiffness: float
            damping: float
        """,
    "instruction.py": """
        from numba import types
        from numba.extending import intrinsic

        @intrinsic
        def sum_with_zero(typing_context, x):
            def code(context, builder, signature, arguments):
                zero = context.get_constant(types.float64, 0.0)
                return builder.fadd(arguments[0], zero)

            return types.float64(types.float64), code
        """,
    "sums.py": """
        from tracked_env.physics.jit import template

        @template
        def total(law, values):
            result = 0.0
            for value in values:
                result += law(value)
            return result
        """,
    "kernel.py": """
        import sys
        import warnings
        import numpy as np
        import soil_law
        from sums import total
        from tracked_env.physics.jit import loop

        @loop
        def run(values):
            return total(soil_law.force, values)

        with warnings.catch_warnings(record=True) as seen:
            warnings.simplefilter("always")
            result = run(np.ones(4))
        compiled = sum(run.stats.cache_misses.values())
        print(result, compiled, len(seen), *(str(each.message) for each in seen))
        """,
}
EXCHANGED = "stiffness: float\n    damping", "damping: float\n    stiffness"
LARGEST_FILE = 2000  # [bytes] of a disk that is full


@pytest.fixture
def project(tmp_path):
    folder = tmp_path / "project"
    folder.mkdir()
    for name, text in PROJECT.items():
        (folder / name).write_text(textwrap.dedent(text))
    return folder


def start(project, cache, before="", main="runpy.run_path('kernel.py', {}, '__main__')"):
    """Result, kernels compiled, warnings and their text, as a new process of the project prints
    them last; before, main: its lines.
    """
    code = f"import sys; sys.path.insert(0, '')\n{before}\nimport runpy; {main}"
    # -B: Python keeps bytecode by time and size
    done = python("-B", "-c", code, cwd=project, NUMBA_CACHE_DIR=str(cache))
    result, compiled, count, *text = done.stdout.splitlines()[-1].split(maxsplit=3)
    return float(result), int(compiled), int(count), "".join(text)


EDITS = (  # file, old text, new text, result
    ("soil_law.py", "stiffness * sinkage", "stiffness * sinkage + 1.0", 16.0),
    ("soil_constants.py", "3.0", "5.0", 20.0),
    ("soil_constants.py", *EXCHANGED, -24.0),
    ("soil_law.py", "* 1 - sinkage) * 23", "* 12 - sinkage) * 3", 144.0),
    ("instruction.py", "arguments[0], zero", "arguments[0], arguments[0]", 24.0),
    ("sums.py", "+= law", "-= law", -12.0),
)


@pytest.mark.slow
def test_a_kernel_follows_what_it_inlines_and_is_warm_at_once_when_that_goes_back(
    project, tmp_path
):
    cache = tmp_path / "cache"
    assert start(project, cache)[:2] == (12.0, 1)
    assert start(project, cache)[:2] == (12.0, 0)
    for file, old, new, expected in EDITS:
        path, text, status = project / file, (project / file).read_text(), (project / file).stat()
        path.write_text(text.replace(old, new))
        os.utime(path, ns=(status.st_atime_ns, status.st_mtime_ns))  # as an unpacked archive
        assert start(project, cache)[:2] == (expected, 1), (file, new)
        path.write_text(text)
    assert start(project, cache)[:2] == (12.0, 0)


def test_words_that_say_nothing_to_the_compiler_leave_a_kernel_warm(project, tmp_path):
    assert start(project, tmp_path)[:2] == (12.0, 1)
    law = project / "soil_law.py"
    law.write_text(f"# A comment.\n\n{law.read_text().replace('of a spring', 'of the ground')}")
    assert start(project, tmp_path)[:2] == (12.0, 0)


def test_source_edited_after_it_was_imported_is_not_what_is_kept(project, tmp_path):
    """A running process compiles what it imported; the next one must not find that."""
    edit = (
        "import soil_law; from pathlib import Path; law = Path('soil_law.py')\n"
        "law.write_text(law.read_text().replace('* sinkage', '* sinkage * 2.0'))"
    )
    assert start(project, tmp_path, edit)[0] == 12.0
    assert start(project, tmp_path)[:2] == (24.0, 1)


DOUBLED = "replace('* sinkage', '* sinkage * 2.0')"
CHANGES = {  # in a running process, and the result
    "a module is edited and reloaded": (
        "law = Path('soil_law.py'); text = law.read_text(); "
        f"law.write_text(text.{DOUBLED}); importlib.reload(soil_law); law.write_text(text)",
        24.0,
    ),
    "a constant is replaced": ("soil_law.STIFFNESS = 7.0", 28.0),
    "a constant comes from elsewhere": (
        "import soil_constants; soil_constants.STIFFNESS = 9.0; importlib.reload(soil_law)",
        36.0,
    ),
    "a formula is replaced": (
        "from tracked_env.physics.jit import formula; "
        "soil_law.force = formula(lambda sinkage: 5.0 * sinkage)",
        20.0,
    ),
}


FEW = ("a module is edited and reloaded", "a constant is replaced")


@pytest.mark.parametrize(
    "change", [pytest.param(c, marks=[pytest.mark.slow] * (c not in FEW)) for c in CHANGES]
)
@pytest.mark.parametrize("order", ["before", pytest.param("after", marks=pytest.mark.slow)])
def test_what_runs_is_what_the_process_holds_and_the_next_process_does_not_meet_it(
    project, tmp_path, change, order
):
    """The kernel is imported before the change and again after it, or after it only."""
    lines, expected = CHANGES[change]
    first = "import importlib, soil_law; from pathlib import Path\n"
    again = "import kernel; importlib.reload(kernel)"
    before = f"{first}import kernel\n{lines}"
    if order == "before":  # numba goes on with the constants that a function was compiled with
        compiled = 12.0 if change == "a constant is replaced" else expected
        assert start(project, tmp_path, before, again)[0] == compiled
    assert start(project, tmp_path, first + lines, again)[0] == expected
    assert start(project, tmp_path, main="import kernel")[0] == 12.0


def test_folders_relative_to_the_current_one_are_not_taken_for_the_users(tmp_path, monkeypatch):
    """XDG_CACHE_HOME is empty, or a user has no home: the name of the folder is then relative."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(kernel_cache.config, "CACHE_DIR", "")
    for value in ("", "~/none"):
        monkeypatch.setenv("XDG_CACHE_HOME", value)
        assert [path.name for path in kernel_cache._folders()] == ["__pycache__"]
    monkeypatch.setattr(kernel_cache.config, "CACHE_DIR", "own")
    assert [*kernel_cache._folders()] == [tmp_path / "own" / "tracked_env"]


def test_the_oldest_files_beyond_the_largest_size_are_deleted(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_cache, "LARGEST", 250)
    for age in range(4):
        path = tmp_path / f"run-{age}.kernel"
        path.write_bytes(bytes(100))
        os.utime(path, (path.stat().st_mtime - age,) * 2)
    kernel_cache._sweep(tmp_path)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["run-0.kernel", "run-1.kernel"]


def test_nothing_is_kept_where_nothing_can_be_written_and_one_warning_says_so(project, tmp_path):
    (tmp_path / "file").write_text("")
    result, compiled, warned, text = start(project, tmp_path / "file" / "cache")
    assert (result, compiled, warned) == (12.0, 1, 1)
    assert "NUMBA_CACHE_DIR" in text and str(tmp_path / "file") in text


@pytest.mark.slow
def test_a_full_disk_ends_nothing_and_leaves_nothing_half_written(project, tmp_path):
    full = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({LARGEST_FILE},) * 2)"
    result, compiled, warned, text = start(project, tmp_path, full)
    assert (result, compiled, warned) == (12.0, 1, 1) and "cannot be kept" in text
    assert not list((tmp_path / "tracked_env").glob("*.kernel*"))
    assert start(project, tmp_path)[:2] == (12.0, 1)
    text = (project / "soil_law.py").read_text()
    (project / "soil_law.py").write_text(text.replace("* sinkage", "* sinkage * 2.0"))
    assert start(project, tmp_path, full)[0] == 24.0
    assert start(project, tmp_path)[:2] == (24.0, 1)


@pytest.mark.slow
def test_a_damaged_file_is_compiled_anew(project, tmp_path):
    start(project, tmp_path)
    (path,) = (tmp_path / "tracked_env").glob("run-*.kernel")
    for damage in (lambda whole: whole[:-100], lambda whole: b"", lambda whole: whole[::-1]):
        content = path.read_bytes()
        path.write_bytes(damage(content))
        assert start(project, tmp_path)[:3] == (12.0, 1, 0)
        assert len(path.read_bytes()) == len(content)
    assert start(project, tmp_path)[:3] == (12.0, 0, 0)


def test_a_terminal_is_told_once_why_the_first_call_takes_long(project, tmp_path):
    code = "import sys; sys.path.insert(0, ''); sys.stderr.isatty = lambda: True; import kernel"
    for count in (1, 0):  # the second process finds the kernel on disk
        done = python("-B", "-c", code, cwd=project, NUMBA_CACHE_DIR=str(tmp_path))
        assert done.stderr.count("compiling kernels") == count


def test_kernels_that_nobody_has_loaded_for_a_month_are_deleted(project, tmp_path):
    start(project, tmp_path)
    (path,) = (tmp_path / "tracked_env").glob("run-*.kernel")
    for age, is_there in ((0.9, True), (1.1, False)):
        at = path.stat().st_mtime - age * kernel_cache.LONGEST_UNUSED
        os.utime(path, (at, at))
        kernel_cache._sweep(path.parent)
        assert path.exists() is is_there


CLAIM = """
import sys, time
from pathlib import Path
from tracked_env.physics import kernel_cache
kernel_cache.claim(Path(sys.argv[1]))
print("claimed", flush=True)
sys.stdin.read(1)  # until the other process goes on, or ends this one
"""


@contextlib.contextmanager
def claimed_by_another(path):
    """The process that claims a kernel; it goes on when it reads something."""
    command = [sys.executable, "-c", CLAIM, str(path)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE, "text": True}
    with subprocess.Popen(command, **pipes) as process:
        assert process.stdout.readline() == "claimed\n"
        yield process
    kernel_cache.release(path)


@pytest.mark.parametrize("end", ["exit", "kill"])
def test_a_kernel_that_another_process_compiles_is_waited_for(tmp_path, monkeypatch, end):
    path, other = tmp_path / "one.kernel", tmp_path / "other.kernel"
    with claimed_by_another(path) as process:
        kernel_cache.claim(other)  # nobody has that one
        waits = []

        def sleep(seconds):
            waits.append(seconds)
            if len(waits) == 3:
                process.kill() if end == "kill" else process.communicate(" ")
            time.sleep(seconds)

        clock = types.SimpleNamespace(sleep=sleep, monotonic=time.monotonic)
        monkeypatch.setattr(kernel_cache, "time", clock)
        kernel_cache.claim(path)
    assert len(waits) >= 3  # until the other process had ended
    kernel_cache.release(other)


def test_a_kernel_is_not_waited_for_longer_than_its_limit(tmp_path, monkeypatch):
    monkeypatch.setattr(kernel_cache, "LONGEST_WAIT", 0.1)
    path = tmp_path / "one.kernel"
    with claimed_by_another(path) as process:
        began = time.monotonic()
        kernel_cache.claim(path)
        assert 0.1 <= time.monotonic() - began < 10.0
        process.communicate(" ")


FAILING = """
import numpy as np
from tracked_env.physics import kernel_cache
from tracked_env.physics.jit import loop

@loop
def wrong(values):
    return values.nothing_of_the_kind

try:
    wrong(np.ones(3))
except Exception as error:
    print(type(error).__name__, len(kernel_cache._CLAIMS))
"""


def test_a_kernel_that_cannot_be_compiled_is_waited_for_by_nobody(tmp_path):
    printed = python("-c", FAILING, NUMBA_CACHE_DIR=str(tmp_path)).stdout
    assert printed.split() == ["TypingError", "0"]


DRIVE = """
import hashlib
import gymnasium, numpy as np
envs = gymnasium.make_vec("tracked_env:tracked_env/Terrain-v0", num_envs=2)
envs.reset(seed=3)
for _ in range(100):
    envs.step(np.full((2, 2), [0.4, 0.5], np.float32))
print(hashlib.sha256(envs.unwrapped.simulation.batch.floats.tobytes()).hexdigest())
"""


@pytest.mark.slow
def test_the_process_that_compiles_and_one_that_loads_compute_the_same_bits(tmp_path):
    """Machine code of a function stands once: another copy might add up in another order."""
    digests = [python("-c", DRIVE, NUMBA_CACHE_DIR=str(tmp_path)).stdout for _ in range(2)]
    assert digests[0] == digests[1] and len(digests[0]) == 65
