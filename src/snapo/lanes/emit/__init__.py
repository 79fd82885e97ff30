"""A writer of LLVM IR for vectors of lanes."""
