"""One rule per kind of primitive: from an operation and the places of its inputs to LLVM IR."""
