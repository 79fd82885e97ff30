"""One pipeline for code that runs, code on disk, and the instructions shown to a reader."""

from dataclasses import replace

import jax.numpy as jnp
import pytest
from tests.lanes.compiled import text

from snapo.lanes.machine import disk, pipeline
from snapo.lanes.machine.pipeline import PIPELINE, Pipeline, assembly, binding, object_code


def written() -> str:
    """Loops, a curve, a branch and a table: all kinds of sections."""
    table = jnp.linspace(0.0, 1.0, 20)
    return text(lambda x, m: jnp.sin(m @ x) + jnp.exp(table) * x[0], [(17,), (20, 17)])[0]


def sections(data: bytes) -> dict[str, bytes]:
    """The sections of an object that hold instructions and constants."""
    found = {}
    with binding().ObjectFileRef.from_data(data) as whole:
        for each in whole.sections():
            name = each.name() or b""
            name = name.decode() if isinstance(name, bytes) else name
            if name.startswith((".text", ".ltext", ".rodata", ".lrodata")):
                found[name] = each.data()
    return found


def assembled(instructions: str) -> bytes:
    """The object code of a text of instructions."""
    binding().initialize_native_asmparser()
    target = PIPELINE.target()
    escaped = instructions.replace("\\", "\\5C").replace('"', "\\22").replace("\n", "\\0A")
    module = f'target triple = "{target.triple}"\nmodule asm "{escaped}"'
    return target.emit_object(binding().parse_assembly(module))


def test_the_instructions_shown_are_those_that_run():
    """Assembled, the text gives the machine code that is loaded, byte for byte."""
    module = written()
    expected = sections(object_code(module))
    assert expected and any(len(data) > 500 for data in expected.values())
    found = sections(assembled(assembly(module)))
    assert {name: data for name, data in found.items() if data} == {
        name: data for name, data in expected.items() if data
    }


@pytest.mark.parametrize(
    "change",
    [
        {"speed_level": 1},
        {"code_level": 1},
        {"code_model": "small"},
        {"loop_unrolling": True},
        {"slp_vectorization": True},
    ],
)
def test_code_of_other_passes_is_not_found_on_disk(change, tmp_path, monkeypatch):
    module = written()
    before = disk.key(module)
    disk.cached(module, tmp_path)
    changed = replace(PIPELINE, **change)
    monkeypatch.setattr(disk, "PIPELINE", changed)
    assert disk.key(module) != before
    made = []
    monkeypatch.setattr(disk, "object_code", lambda text: made.append(text) or b"other")
    assert disk.cached(module, tmp_path) == b"other" and made == [module]
    assert disk.cached(module, tmp_path) == b"other" and len(made) == 1


def test_code_of_another_llvm_or_processor_is_not_found_on_disk(monkeypatch):
    module = written()
    keys = {disk.key(module), disk.key(module + "\n")}
    monkeypatch.setattr(pipeline, "versions", lambda: "0.51.0 (23, 1, 0)")
    keys.add(disk.key(module))
    other = pipeline.host()._replace(features="+none")
    monkeypatch.setattr(pipeline, "host", lambda: other)
    keys.add(disk.key(module))
    assert len(keys) == 4


def test_every_setting_is_part_of_the_identity():
    identity = Pipeline().identity()
    for name in ("speed_level=2", "code_model=large", "loop_vectorization=False"):
        assert name in identity
    assert pipeline.versions() in identity


def test_a_disk_that_cannot_be_written_is_no_reason_to_fail(tmp_path, monkeypatch):
    blocked = tmp_path / "file"
    blocked.write_text("no folder")
    monkeypatch.setattr(disk, "object_code", lambda text: b"code")
    assert disk.cached("module", blocked / "kernels") == b"code"
