"""The processor's mode for denormal numbers."""

from collections.abc import Callable

from .code import Code


def flush_denormals(code: Code, triple: str) -> Callable[[], None]:
    """Denormals count as zero from here on, as XLA has it; returns a call that restores the mode.

    Tails of logistic curves fill an adjoint with denormals, and each costs a hundred cycles.
    """
    if triple.startswith("x86_64"):
        for name in ("stmxcsr", "ldmxcsr"):
            code.module.declare(f"declare void @llvm.x86.sse.{name}(ptr)")
        code.do("%mode = alloca i32, align 4")
        code.do("%flushing = alloca i32, align 4")
        code.do("call void @llvm.x86.sse.stmxcsr(ptr %mode)")
        code.do("%before = load i32, ptr %mode, align 4")
        code.do("%with = or i32 %before, 32832")
        code.do("store i32 %with, ptr %flushing, align 4")
        code.do("call void @llvm.x86.sse.ldmxcsr(ptr %flushing)")
        return lambda: code.do("call void @llvm.x86.sse.ldmxcsr(ptr %mode)")
    if triple.startswith(("aarch64", "arm64")):
        code.module.declare("declare i64 @llvm.aarch64.get.fpcr()")
        code.module.declare("declare void @llvm.aarch64.set.fpcr(i64)")
        code.do("%before = call i64 @llvm.aarch64.get.fpcr()")
        code.do("%with = or i64 %before, 16777216")
        code.do("call void @llvm.aarch64.set.fpcr(i64 %with)")
        return lambda: code.do("call void @llvm.aarch64.set.fpcr(i64 %before)")
    return lambda: None
