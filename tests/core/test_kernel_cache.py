"""Kernels on disk: found again by equal code, and by no other."""

import os
import subprocess
import sys
from importlib import import_module, invalidate_caches
from pathlib import Path
from pkgutil import walk_packages
from threading import Barrier, Thread

import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher

import coopmap_env
from coopmap_env.core import kernel_cache
from coopmap_env.core.kernel_cache import attach_cache, fingerprint
from coopmap_env.core.kernels import kernel, unchecked_division_kernel

CALLEE = """
from typing import NamedTuple
from coopmap_env.core.kernels import kernel
class Pair(NamedTuple):
    one: float
    two: float
FACTOR = 10.0
@kernel
def scale(pair):
    return FACTOR * pair.one
"""
CALLER = """
from callee import Pair, scale
from coopmap_env.core.kernels import kernel
@kernel
def double(x):
    "Twice a number."
    return scale(Pair(2.0 * x, 1.0))
"""


@pytest.fixture
def load(tmp_path, monkeypatch):
    """Imports a caller, and its callee from another file, again as a new process would."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "caches"))
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "dont_write_bytecode", True)

    def load(callee=CALLEE, caller=CALLER):
        for name, text in (("callee", callee), ("caller", caller)):
            (tmp_path / f"{name}.py").write_text(text)
            sys.modules.pop(name, None)
        invalidate_caches()
        return import_module("caller").double

    yield load
    for name in ("callee", "caller"):
        sys.modules.pop(name, None)


def is_loaded(double):
    """Call a kernel; return whether it was found on disk."""
    double(1.0)
    return sum(double.stats.cache_hits.values()) == 1


def files(folder):
    return sorted(path.name for path in Path(folder).rglob("*") if path.is_file())


def test_a_new_process_sees_that_a_callee_in_another_file_was_edited(tmp_path):
    (tmp_path / "caller.py").write_text(CALLER)
    paths = [str(tmp_path), *filter(None, [os.environ.get("PYTHONPATH")])]
    environment = {
        **os.environ,
        "NUMBA_CACHE_DIR": str(tmp_path / "caches"),
        "PYTHONPATH": os.pathsep.join(paths),
    }
    code = "import caller; print(caller.double(3.0), sum(caller.double.stats.cache_hits.values()))"
    found = []
    for callee in (CALLEE, CALLEE, CALLEE.replace("FACTOR *", "FACTOR +")):
        (tmp_path / "callee.py").write_text(callee)
        run = subprocess.run(
            [sys.executable, "-B", "-c", code], env=environment, capture_output=True, text=True
        )
        assert run.returncode == 0, run.stderr
        found.append(run.stdout.split())
    assert found == [["60.0", "0"], ["60.0", "1"], ["16.0", "0"]]


@pytest.mark.parametrize(
    ("old", "new", "result"),
    [
        ("FACTOR *", "FACTOR +", 16.0),
        ("10.0", "100.0", 600.0),  # a constant
        ("pair.one", "pair.two", 10.0),  # the same bytecode but for a name
        ("one: float\n    two: float", "two: float\n    one: float", 10.0),
        ("pair.one\n", "_one(pair)\n@kernel\ndef _one(pair):\n    return pair.two\n", 10.0),
    ],
)
def test_a_change_of_what_a_kernel_depends_on_compiles_it_again(load, old, new, result):
    assert load()(3.0) == 60.0
    changed = load(CALLEE.replace(old, new))
    assert changed(3.0) == result
    assert not changed.stats.cache_hits
    assert is_loaded(load(CALLEE.replace(old, new)))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("@kernel", "# a comment, and all lines below move\n@kernel"),
        ("Twice a number.", "Two times a number."),
        ("@kernel", "UNUSED = 3.0\n@kernel"),
    ],
)
def test_a_change_that_changes_nothing_compiles_nothing(load, old, new):
    assert not is_loaded(load())
    assert is_loaded(load(CALLEE.replace(old, new), CALLER.replace(old, new)))


def test_a_new_code_replaces_the_files_of_the_old_one(load, tmp_path):
    load()(1.0)
    folder = tmp_path / "caches"
    names = files(folder)
    assert len(names) == 2  # caller and callee
    (parent,) = folder.iterdir()
    old = ["caller.double-7.py311.nbi", "caller.double-7.py311.1.nbc"]  # of numba's own cache
    other = ["caller.double-cpython-399-abc-def.nbc", "caller.double_other-7.py311.nbi"]
    for name in old + other:
        (parent / name).touch()
    load(CALLEE.replace("10.0", "20.0"))(1.0)
    left = set(files(folder))
    assert not left & {*names, *old}
    assert {*other} < left
    assert len(left) == 2 + len(other)


def test_another_signature_has_a_file_of_its_own(load, tmp_path):
    double = load()
    double(1.0)
    double(1)
    assert len(files(tmp_path / "caches")) == 3
    assert is_loaded(load())


def test_a_damaged_file_is_compiled_again(load, tmp_path):
    load()(1.0)
    for path in tmp_path.glob("caches/*/*.nbc"):
        path.write_bytes(path.read_bytes()[:100])
    assert load()(3.0) == 60.0
    assert is_loaded(load())


def test_without_a_folder_that_can_be_written_to_kernels_still_run(load, monkeypatch):
    def no_folder(function):
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(kernel_cache, "FunctionCache", no_folder)
    double = load()
    assert double(3.0) == 60.0
    assert double.stats.cache_path is None
    assert not is_loaded(load())


def test_a_full_disk_is_no_error(load, monkeypatch):
    def full(path, content):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(kernel_cache, "write_atomically", full)
    assert load()(3.0) == 60.0


class FilesElsewhere:
    """A cache of a numba that keeps its files in another place than we know."""

    def __init__(self, function):
        pass


@pytest.mark.parametrize(
    ("name", "value"), [("NullCache", None), ("FunctionCache", FilesElsewhere)]
)
def test_an_unknown_numba_is_a_warning_and_kernels_still_run(name, value, monkeypatch):
    monkeypatch.setattr(kernel_cache, name, value)
    kernel_cache._warn_of_unknown_numba.cache_clear()

    def one():
        return 1

    with pytest.warns(RuntimeWarning, match=r"numba .* compiled in every process"):
        assert kernel(one)() == 1
    assert kernel(one)() == 1  # it warns once
    kernel_cache._warn_of_unknown_numba.cache_clear()


def test_two_threads_that_write_at_once_leave_what_both_can_load(load, tmp_path):
    one, two = load(), load()
    together = Barrier(2)

    def call(double):
        together.wait()
        double(1.0)

    threads = [Thread(target=call, args=[double]) for double in (one, two)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(files(tmp_path / "caches")) == 2
    assert is_loaded(load())


def test_recompiling_removes_the_files_and_writes_them_again(load, tmp_path):
    double = load()
    double(1.0)
    double.recompile()
    assert not is_loaded(double)
    assert is_loaded(load())


def test_a_plain_function_has_no_cache():
    """As with the environment variable NUMBA_DISABLE_JIT."""

    def plain():
        return 1

    attach_cache(plain)
    assert plain() == 1


TABLE = np.arange(3)
MODULE = np
NAMES = {"one", "two"}


def test_a_fingerprint_depends_on_arrays_options_defaults_and_closures(monkeypatch):
    def read():
        return TABLE[0]

    def make(value, default):
        def inner(x=default):
            return value + x

        return inner

    before = fingerprint(read)
    assert fingerprint(kernel(read)) != fingerprint(unchecked_division_kernel(read))
    monkeypatch.setitem(read.__globals__, "TABLE", np.arange(1, 4))
    kernel_cache._describe_function.cache_clear()
    assert fingerprint(read) != before
    functions = [make(value, default) for value in (1, 1.0, 2) for default in (0, 0.0)]
    assert len({fingerprint(function) for function in functions}) == 6
    assert fingerprint(make(1, 0)) == fingerprint(make(1, 0))


def test_what_cannot_be_described_is_named():
    def read():
        return len(NAMES) + MODULE.pi

    with pytest.raises(TypeError, match=r"test_kernel_cache.*read: NAMES is of the type set"):
        fingerprint(read)


def test_every_kernel_of_the_package_has_a_fingerprint_of_its_own():
    kernels = set()
    for module in walk_packages(coopmap_env.__path__, "coopmap_env."):
        if not module.name.endswith("__main__"):
            found = vars(import_module(module.name)).values()
            kernels |= {value for value in found if isinstance(value, Dispatcher)}
    assert len(kernels) > 200
    assert len({fingerprint(each) for each in kernels}) == len(kernels)


@pytest.fixture
def said(capsys):
    """Lines of progress since the last call, as in a new process."""

    def lines():
        kernel_cache._say_that_kernels_are_compiled.cache_clear()
        return capsys.readouterr().err.splitlines()

    lines()
    yield lines
    lines()


def test_one_line_says_that_kernels_are_compiled_and_none_that_they_are_loaded(load, said):
    n_before = len(kernel_cache.compiled_kernels)
    load()(1.0)
    assert said() == [kernel_cache.COMPILING]
    assert kernel_cache.compiled_kernels[n_before:] == ["scale", "double"]
    load()(1.0)
    assert said() == []
    assert len(kernel_cache.compiled_kernels) == n_before + 2


def test_workers_say_nothing(load, said, monkeypatch):
    monkeypatch.setattr(kernel_cache.multiprocessing, "parent_process", lambda: "a process")
    load()(1.0)
    assert said() == []
