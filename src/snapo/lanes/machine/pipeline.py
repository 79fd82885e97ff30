"""Machine code from text: one description of the passes and the target for all who need it."""

from dataclasses import asdict, dataclass
from typing import Any

from .llvm import binding, versions
from .processor import host


@dataclass(frozen=True)
class Pipeline:
    """How code is made: LLVM's own vectorisers stay off, as the text consists of vectors.

    Code and constants may be mapped far apart: the small code model's 32-bit distances then
    overflow.
    """

    speed_level: int = 2
    code_level: int = 2
    code_model: str = "large"
    loop_vectorization: bool = False
    slp_vectorization: bool = False
    loop_unrolling: bool = False
    loop_interleaving: bool = False

    def identity(self) -> str:
        """All that decides the code beside the text: code under another identity is not used."""
        processor = host()
        settings = " ".join(f"{key}={value}" for key, value in asdict(self).items())
        parts = (settings, processor.triple, processor.name, processor.features, versions())
        return "\n".join(parts)

    def target(self) -> Any:
        """LLVM's target machine: this processor with all its features."""
        llvm, processor = binding(), host()
        return llvm.Target.from_triple(processor.triple).create_target_machine(
            cpu=processor.name,
            features=processor.features,
            opt=self.code_level,
            jit=True,
            codemodel=self.code_model,
        )

    def optimised(self, text: str, target: Any) -> Any:
        """The module after all passes."""
        llvm = binding()
        module = llvm.parse_assembly(text)
        module.verify()
        options = llvm.create_pipeline_tuning_options(speed_level=self.speed_level)
        options.loop_vectorization = self.loop_vectorization
        options.slp_vectorization = self.slp_vectorization
        options.loop_unrolling = self.loop_unrolling
        options.loop_interleaving = self.loop_interleaving
        builder = llvm.create_pass_builder(target, options)
        builder.getModulePassManager().run(module, builder)
        return module


PIPELINE = Pipeline()


def object_code(text: str) -> bytes:
    """Machine code for a module's text, ready to be linked."""
    target = PIPELINE.target()
    return target.emit_object(PIPELINE.optimised(text, target))


def assembly(text: str) -> str:
    """The instructions of `object_code`, for a reader."""
    target = PIPELINE.target()
    return target.emit_assembly(PIPELINE.optimised(text, target))
