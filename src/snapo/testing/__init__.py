"""Tools for the tests of any domain: mistakes in cases, bumps, and small runs.

- `mistakes`: every key and column of a case is made wrong in turn, and a reader must refuse the
  case.
- `derivatives`: compares the adjoint of a problem with differences on the same paths.
- `miniature`: makes a small case and carries out its study, so that many tests can share one run.
  Nothing here needs a test framework: functions return a list of faults, and a test asserts that it
  is empty.
"""
