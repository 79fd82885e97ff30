"""The user's folder of compiled code: used by the next process, the user's alone, shown and emptied."""

import json
import os
import subprocess
import sys

import pytest

from snapo.cli.main import main
from snapo.lanes.machine import code_cache, disk

PROGRAM = """
import jax, jax.numpy as jnp
from snapo.lanes.machine.code_cache import keep_programs
hits = []
jax.monitoring.register_event_listener(lambda name, **_: hits.append(name))
keep_programs()
jax.jit(lambda x: jnp.sin(x) * 2 + 1)(jnp.ones(3))
print(sum(name.endswith("cache_hits") for name in hits))
"""


@pytest.fixture
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    return tmp_path / "snapo"


def hits() -> int:
    """Programs that a new process reads instead of compiling them."""
    environment = {x: y for x, y in os.environ.items() if not x.startswith("JAX_")}
    done = subprocess.run([sys.executable, "-c", PROGRAM], env=environment, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()
    return int(done.stdout)


@pytest.mark.prove
def test_the_next_process_reads_the_programs(home):
    assert hits() == 0
    assert (home / "xla").stat().st_mode & 0o777 == 0o700
    assert hits() > 0


@pytest.mark.prove
@pytest.mark.skipif(not hasattr(os, "geteuid"), reason="folders have no owners here")
def test_a_folder_that_others_may_write_is_not_used(home):
    (home / "xla").mkdir(parents=True)
    (home / "xla").chmod(0o777)
    assert hits() == hits() == 0
    assert not list((home / "xla").iterdir())


def test_the_code_is_shown_and_removed(home, capsys):
    disk.cached("define void @f() { ret void }", code_cache.code_folder(code_cache.KERNELS))
    assert main(["cache", "--json"]) == 0
    kernels, programs = json.loads(capsys.readouterr().out)["folders"]
    assert kernels["files"] == 1 and kernels["bytes"] > 100 and programs["files"] == 0
    assert main(["cache", "--empty"]) == 0
    assert f"{home / 'kernels'}   0 files, 0.0 MB" in capsys.readouterr().out


def test_old_programs_are_removed(home, monkeypatch):
    import jax

    (home / "xla").mkdir(parents=True, mode=0o700)
    (home / "xla" / "old").write_bytes(b"x")
    os.utime(home / "xla" / "old", (0, 0))
    before = jax.config.jax_compilation_cache_dir
    seconds = jax.config.jax_persistent_cache_min_compile_time_secs
    try:
        jax.config.update("jax_compilation_cache_dir", None)
        code_cache.keep_programs()
        assert jax.config.jax_compilation_cache_dir == str(home / "xla")
    finally:
        jax.config.update("jax_compilation_cache_dir", before)
        jax.config.update("jax_persistent_cache_min_compile_time_secs", seconds)
    assert not list((home / "xla").iterdir())
