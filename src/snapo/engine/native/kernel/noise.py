"""The noise of a phase: drawn from a counter inside the kernel, or supplied by the caller.

Normals are those of `snapo.problem.noise.counter`, bit by bit: integers of Threefry-2x32 with 20
rounds (Salmon, Moraes, Dror and Shaw, "Parallel random numbers: as easy as 1, 2, 3", SC 2011), and
Wichura's inverse normal AS241."""

import numpy as np

from snapo.lanes.curves.arithmetic import Arithmetic
from snapo.lanes.curves.logarithms import logarithm, split
from snapo.lanes.emit.code import Code
from snapo.lanes.emit.module import Module, Ref
from snapo.lanes.emit.storage import ArrayPlace, row_major
from snapo.lanes.emit.values import EmittedValues, objects
from snapo.lanes.program.program import BIG, ProgramValue
from snapo.problem.noise.counter import _PPND7, _PPND16

from .context import field
from .sweep import KernelSweep

ROTATIONS = ((13, 15, 26, 6), (17, 29, 16, 24))


def threefry(code: Code, key: tuple[Ref, Ref], counter: tuple[Ref, Ref]) -> tuple[Ref, Ref]:
    """Two random integers per lane from a key and a counter of two integers each."""
    parity = code.constant(0x1BD11BDA, "uint32")
    keys = [key[0], key[1], code.op("xor", code.op("xor", key[0], key[1]), parity)]
    x, y = code.add(counter[0], keys[0]), code.add(counter[1], keys[1])
    for group in range(5):
        for turn in ROTATIONS[group % 2]:
            x = code.add(x, y)
            y = code.op("xor", _rotate(code, y, turn), x)
        x = code.add(x, keys[(group + 1) % 3])
        y = code.add(y, code.add(keys[(group + 2) % 3], code.constant(group + 1, "uint32")))
    return x, y


def _rotate(code: Code, x: Ref, turn: int) -> Ref:
    return code.call("llvm.fshl", x, x, code.constant(turn, x.dtype, x.lanes))


ENOUGH = 32  # normals per path that are drawn at once where the steps allow it
SIDE_BY_SIDE = 4  # vector registers of counters worked on at once
SPARE = 2 * SIDE_BY_SIDE + 2  # rows that may be written beyond the last


def normal(code: Code, word: Ref, dtype: str) -> Ref:
    """The normal of a word, operation by operation as in `snapo.problem.noise.counter`."""
    a = Arithmetic(code, dtype, word.lanes)
    centre, outer = _PPND16 if dtype == "float64" else _PPND7
    mask = code.constant(0x7FFFFFFF, "uint32", word.lanes)
    m = code.op("and", word, mask)
    tail = code.op("fadd", code.convert("sitofp", m, dtype), a.real(0.5))
    tail = code.op("fmul", tail, a.real(2.0**-32))
    rest = code.convert("sitofp", code.op("sub", mask, m), dtype)
    q = code.fma(rest, a.real(2.0**-32), a.real(2.0**-33))
    inner = code.fma(code.op("fneg", q), q, a.real(0.180625))
    log_tail = logarithm(a, *split(a, tail))  # a tail is positive and never denormal
    root = code.call("llvm.sqrt", code.op("fneg", log_tail))
    far = code.op("fsub", root, a.real(1.6))
    # One division serves both branches: numerator and denominator are selected first.
    near = code.compare("ole", q, a.real(0.425))
    top = code.select(
        near,
        code.op("fmul", q, a.polynomial(inner, centre[0])),
        a.polynomial(far, outer[0]),
    )
    bottom = code.select(near, a.polynomial(inner, centre[1]), a.polynomial(far, outer[1]))
    z = code.div(top, bottom)
    sign = code.op("and", word, code.constant(0x80000000, "uint32", word.lanes))
    return _flip(code, z, sign, dtype)


def _flip(code: Code, z: Ref, sign: Ref, dtype: str) -> Ref:
    """z with its sign bit exchanged where the top bit of `sign` is set."""
    if dtype == "float64":
        sign = code.op(
            "shl", code.convert("zext", sign, "uint64"), code.constant(32, "uint64", z.lanes)
        )
    bits = code.convert("bitcast", z, sign.dtype)
    return code.convert("bitcast", code.op("xor", bits, sign), dtype)


def ahead(size: int) -> int:
    """The number of steps whose normals are drawn together, in parallel chains of arithmetic."""
    steps = 1
    while steps * size < ENOUGH:
        steps *= 2
    return steps


def draw_function(module: Module, size: int, dtype: str, antithetic: bool) -> str:
    """The function that draws `size` normals for each of `count` steps from `first` on.

    They go to `out`, [count, size, lanes] with `SPARE` further rows; `%words` has as many 32-bit
    words.
    """
    name = f"draw_{dtype}_{size}"
    if not module.first(name):
        return name
    code = Code(module.lanes, module)
    lanes = code.lanes
    registers = max(1, 4 * lanes // module.register)
    _draw_words(code, size, max(1, SIDE_BY_SIDE // registers), antithetic)
    count = code.index(f"mul nsw i64 %count, {size}")
    rounds = code.index(f"lshr i64 {code.index(f'add nsw i64 {count}, 1')}, 1")
    with code.loop(rounds) as loop:
        integers = code.pointer("%words", code.index(f"mul nsw i64 {loop.i}, {8 * lanes}"))
        unit = np.dtype(dtype).itemsize * lanes
        out = code.pointer("%out", code.index(f"mul nsw i64 {loop.i}, {2 * unit}"))
        code.store(normal(code, code.load(integers, "uint32", 2 * lanes), dtype), out, 2 * lanes)
    code.do("ret void")
    header = (
        f"define internal void @{name}(ptr %key, ptr %paths, i64 %first, i64 %count, "
        "ptr noalias %out, ptr noalias %words) noinline nounwind"
    )
    code.define(header)
    return name


def _draw_words(code: Code, size: int, together: int, antithetic: bool) -> None:
    """The random integers of all steps, some counters at a time.

    A counter gives two integers. Where a step takes an odd number, the next step's first integer is
    written over the last one; its place is therefore counted by steps.
    """
    lanes, pairs = code.lanes, (size + 1) // 2
    key = [code.load(code.pointer("%key", 4 * i), "uint32", 1) for i in range(2)]
    paths = code.load("%paths", "uint32", lanes)
    one = code.constant(1, "uint32")
    number = code.op("lshr", paths, one) if antithetic else paths
    # The top bit of a word is the sign of its normal: it is inverted for the second of a pair.
    turn = code.op("shl", paths, code.constant(31, "uint32")) if antithetic else None
    start = code.index(f"mul i64 %first, {pairs}")
    total = code.index(f"mul nsw i64 %count, {pairs}")
    rounds = code.index(
        f"udiv i64 {code.index(f'add nsw i64 {total}, {together - 1}')}, {together}"
    )
    with code.loop(rounds) as loop:
        base = code.index(f"mul nsw i64 {loop.i}, {together}")
        positions = [code.index(f"add nsw i64 {base}, {k}") for k in range(together)]
        counters = []
        for position in positions:
            counter = code.index(f"add i64 {position}, {start}")
            low = vector(code, code.raw(f"trunc i64 {counter} to i32"))
            counters.append(code.splat(low, lanes))
        x, y = threefry(
            code, (key[0], key[1]), (code.join([number] * together), code.join(counters))
        )
        for k, position in enumerate(positions):
            row = code.index(f"shl i64 {position}, 1")
            if size % 2:
                row = code.index(f"sub i64 {row}, {code.index(f'udiv i64 {position}, {pairs}')}")
            to = code.pointer("%words", code.index(f"mul nsw i64 {row}, {4 * lanes}"))
            for word, distance in ((x, 0), (y, 4 * lanes)):
                part = code.part(word, k, lanes)
                if turn is not None:
                    part = code.op("xor", part, turn)
                code.store(part, code.pointer(to, distance), lanes)


def vector(code: Code, scalar: str) -> Ref:
    """A scalar word as a vector of one lane."""
    text = f"insertelement <1 x i32> poison, i32 {scalar}, i64 0"
    return Ref(code.raw(text), "uint32", 1)


def bind(s: KernelSweep, values: EmittedValues, value: ProgramValue) -> None:
    """Binds this step's noise, drawn or supplied."""
    if not s.build.traced.setup.counter:
        _supplied(s, values, value)
    elif not value.size:
        values.set(value, np.empty(value.shape, object))
    else:
        _drawn(s, values, value)


def _drawn(s: KernelSweep, values: EmittedValues, value: ProgramValue) -> None:
    """Normals of some steps at once, into scratch memory; the step's own are a row of it."""
    before = s.build.traced.setup.before if s.initial else 0
    code, size = s.code, value.size // max(before, 1)
    steps = max(before, 1) if s.initial else ahead(size)
    rows = steps * size + SPARE
    # Pairs of normals are written: an odd number would overwrite the field after its home.
    home = values.homes.get(value) if steps == 1 and not (s.initial or size % 2) else None
    out = home or values.workspace.allocate((rows,), value.dtype, code.lanes)
    integers = values.workspace.allocate((rows,), np.uint32, code.lanes)
    antithetic = s.build.traced.setup.antithetic
    name = draw_function(code.module, size, value.dtype.name, antithetic)
    key = code.pointer(field("keys"), 8 if s.initial and not before else 0)
    lanes = code.index(f"mul nsw i64 %block, {4 * code.lanes}")
    paths = code.pointer(field("paths"), lanes)

    def write(first: str, count: str) -> None:
        code.do(
            f"call void @{name}(ptr {key}, ptr {paths}, i64 {first}, i64 {count}, "
            f"ptr {code.pointer(out.base, out.offset)}, "
            f"ptr {code.pointer(integers.base, integers.offset)})"
        )

    if s.initial:
        write("0", f"{steps}")
        base = out.base
    else:
        relative = code.index(f"sub nsw i64 {s.t}, %begin")
        slot = code.index(f"and i64 {relative}, {steps - 1}")
        with code.branch(code.index(f"icmp eq i64 {slot}, 0")):
            left = code.index(f"sub nsw i64 %end, {s.t}")
            below = code.index(f"icmp slt i64 {left}, {steps}")
            first = code.index(f"add nsw i64 {s.t}, {field('first')}")
            write(first, code.index(f"select i1 {below}, i64 {left}, i64 {steps}"))
        row = code.index(f"mul nsw i64 {slot}, {size * out.unit}")
        base = code.pointer(out.base, row)
    shape = value.shape
    array = ArrayPlace(base, out.offset, shape, row_major(shape), value.dtype, code.lanes)
    values.bind(value, home or array)
    values.finite.add(value)


def _supplied(s: KernelSweep, values: EmittedValues, value: ProgramValue) -> None:
    """Supplied numbers [steps, paths, size], gathered from where the caller has them."""
    code, size = s.code, value.size
    unit = value.dtype.itemsize
    row = code.index(f"mul nsw i64 {s.t}, {field('count')}")
    slot = field("noise_initial" if s.initial else "noise")
    base = code.pointer(slot, code.index(f"mul nsw i64 {row}, {size * unit}"))
    lanes = code.index(f"mul nsw i64 %block, {8 * code.lanes}")
    position = code.load(code.pointer(field("positions"), lanes), "int64", code.lanes, True)
    offsets = code.mul(position, code.constant(size * unit, "int64"))
    if size <= BIG:
        refs = [
            code.gather(code.pointer(base, k * unit), offsets, value.dtype) for k in range(size)
        ]
        values.set(value, objects(refs, value.shape))
        return
    location = values.target(value)
    with code.loop(size) as loop:
        here = code.pointer(base, code.index(f"mul nsw i64 {loop.i}, {unit}"))
        location.write(code, [loop.i], code.gather(here, offsets, value.dtype))
    values.bind(value, location)
