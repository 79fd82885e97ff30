"""Machine code for this processor, its cache on disk, and memory and threads to run it with.

`pipeline` compiles text by llvmlite and `disk` keeps the result; `linked` makes it callable.
`code_cache` is the user's folder of such code, and of XLA's programs.
"""
