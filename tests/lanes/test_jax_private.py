"""Private names of JAX: in one file, and a reason where a release has not been tested."""

import ast
from pathlib import Path

import jax
import pytest

from snapo import lanes
from snapo.lanes import jax_private


def test_this_release_was_tested():
    assert jax_private.unavailable() is None


@pytest.mark.parametrize("version", ["0.9.2", "0.13.0", "1.0.0.dev3"])
def test_other_releases_give_a_reason(version):
    reason = jax_private.unavailable(version)
    assert reason is not None and version in reason and "0.10 to below 0.13" in reason


def test_a_missing_name_gives_a_reason(monkeypatch):
    monkeypatch.setattr(jax_private, "_missing", ["jax._src.source_info_util.summarize"])
    assert jax_private.unavailable() == (
        f"jax {jax.__version__} has no jax._src.source_info_util.summarize"
    )


def test_private_names_are_used_in_one_file():
    """No other file of the compiler or of the native engine imports from JAX's inside."""
    home = Path(lanes.__file__).parents[1]
    for file in [*(home / "lanes").rglob("*.py"), *(home / "engine").rglob("*.py")]:
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.ImportFrom):
                names = [node.module or ""]
            elif isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            else:
                continue
            inside = [
                n for n in names if n.startswith(("jax._src", "jax.extend", "jax.interpreters"))
            ]
            assert not inside, (file, inside)
