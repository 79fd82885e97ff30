"""The memory of a process that repeats calls of the same sizes."""

import subprocess
import sys

import pytest

REPEATED = """
import resource
import numpy as np
from snapo.study.prepare import keep_memory, return_memory
def faults():
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt
def used():
    with open("/proc/self/statm") as file:
        return int(file.read().split()[1]) * resource.getpagesize()
def call():
    before = faults()
    arrays = [np.ones(2**20) for _ in range(10)]  # 8 MB each: larger ones are mapped apart
    return faults() - before
plain = [call() for _ in range(3)][-1]
keep_memory()
kept = [call() for _ in range(3)][-1]
large = used()
return_memory()
print(plain, kept, large - used())
"""


@pytest.mark.skipif(sys.platform != "linux", reason="the C library is not glibc")
def test_memory_stays_with_the_process_until_it_is_returned():
    done = subprocess.run([sys.executable, "-c", REPEATED], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    plain, kept, returned = map(int, done.stdout.split())
    assert kept < plain / 4
    assert returned > 60e6
