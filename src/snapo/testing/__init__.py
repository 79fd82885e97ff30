"""Tools for the tests of any domain: mistakes in cases, bumps, and small runs.

- `mistakes`: every key and column of a case is spoilt in turn, and a reader must refuse it.
- `derivatives`: the adjoint of a problem against differences on the same paths.
- `miniature`: a case made small, its study carried out, and one run shared by many tests.

Nothing here needs a test framework: functions return complaints, and a test asserts that there
are none.
"""
